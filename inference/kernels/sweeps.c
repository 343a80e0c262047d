/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Light swept through coarse cells, and its diffusion. */

#include <math.h>
#include <string.h>

#include "fields.h"
#include "lanes.h"
#include "variants.h"

/* Parts of the field that sources depend on, the last of which is the beam, and sums that a sweep adds to. */
#define PARTS 5
#define SUMS 4

static inline Floats load_some(const float *from, int64_t width) {
    Floats values = {0.0f};
    memcpy(&values, from, (size_t)width * sizeof(float));
    return values;
}

static inline void store_some(float *to, Floats values, int64_t width) {
    memcpy(to, &values, (size_t)width * sizeof(float));
}

/* The source function of one direction, of the parts of the field. */
static inline Floats source_of(const float *emit, const Floats *parts, Floats beam) {
    Floats source = emit[0] * parts[0];
    for (int i = 1; i < PARTS - 1; i++) source += emit[i] * parts[i];
    return source + emit[PARTS - 1] * beam;
}

/* Follow all directions through some neighbouring cells of a row, at most LANES: radiance tends towards the source
function. number: of the slice. r, c: row, and first cell in it. at: of this cell in the cube. */
static inline __attribute__((always_inline)) void follow(const OrdinateSweep *sweep, const float *before, float *after,
                                                          int64_t number, int64_t r, int64_t c, int64_t at,
                                                          int64_t width) {
    int64_t n = sweep->cells, cube = n * n * n, border = n + 2, count = sweep->directions;
    Floats parts[PARTS] = {{0.0f}}, sums[SUMS] = {{0.0f}};
    for (int i = 0; i < (sweep->beams ? PARTS - 1 : PARTS); i++) {
        parts[i] = load_some(sweep->field + i * cube + at, width);
    }
    for (int64_t d = 0; d < count; d++) {
        const int64_t *step = sweep->steps + 2 * d;
        int64_t kind = sweep->kinds[d] * cube + at;
        Floats beam = sweep->beams ? load_some(sweep->beams + d * cube + at, width) : parts[PARTS - 1];
        Floats light = load_some(before + (d * border + r + 1 - step[0]) * border + 1 - step[1] + c, width);
        if (sweep->links) light *= load_some(sweep->links + ((number * count + d) * n + r) * n + c, width);
        Floats rise = source_of(sweep->emit + PARTS * d, parts, beam) - light;
        Floats leaving = rise * load_some(sweep->leaving + kind, width) + light;
        store_some(after + (d * border + r + 1) * border + 1 + c, leaving, width);
        Floats mean = rise * load_some(sweep->within + kind, width) + light;
        if (sweep->gather) {
            for (int i = 0; i < SUMS; i++) sums[i] += sweep->gather[SUMS * d + i] * mean;
        } else {
            store_some(sweep->sums + d * cube + at, mean, width);
        }
    }
    for (int i = 0; i < SUMS && sweep->gather; i++) {
        float *to = sweep->sums + i * cube + at;
        store_some(to, load_some(to, width) + sums[i], width);
    }
}

/* Follow one direction straight along some neighbouring rows of a slice, at most LANES. at: of the first cell. */
static inline __attribute__((always_inline)) void follow_straight(const OrdinateSweep *sweep, int64_t d, int64_t r,
                                                                   int64_t first, int64_t rows) {
    int64_t n = sweep->cells, cube = n * n * n, count = sweep->directions, at = (r * n + first) * n;
    const float *emit = sweep->emit + PARTS * d, *leaving = sweep->leaving + sweep->kinds[d] * cube + at;
    const float *within = sweep->within + sweep->kinds[d] * cube + at;
    const float *beam = sweep->beams ? sweep->beams + d * cube : sweep->field + (PARTS - 1) * cube;
    float *means = sweep->scratch, light[LANES];
    for (int64_t c = 0; c < rows * n; c++) {
        float source = emit[0] * sweep->field[at + c];
        for (int i = 1; i < PARTS - 1; i++) source += emit[i] * sweep->field[i * cube + at + c];
        means[c] = source + emit[PARTS - 1] * beam[at + c];
    }
    for (int64_t row = 0; row < rows; row++) light[row] = sweep->entering ? sweep->entering[d] : 0.0f;
    for (int64_t k = 0; k < n; k++) {
        int64_t number = sweep->sign > 0 ? k : n - 1 - k;
        const float *links = sweep->links ? sweep->links + ((number * count + d) * n + r) * n + first : NULL;
        for (int64_t row = 0; row < rows; row++) {
            int64_t c = row * n + number;
            float arriving = links ? light[row] * links[row] : light[row], rise = means[c] - arriving;
            light[row] = rise * leaving[c] + arriving;
            means[c] = rise * within[c] + arriving;
        }
    }
    for (int i = 0; i < SUMS && sweep->gather; i++) {
        float *to = sweep->sums + i * cube + at;
        for (int64_t c = 0; c < rows * n; c++) to[c] += sweep->gather[SUMS * d + i] * means[c];
    }
    if (!sweep->gather) memcpy(sweep->sums + d * cube + at, means, (size_t)(rows * n) * sizeof(float));
}

int64_t NAMED(sweep_ordinates, VARIANT)(const OrdinateSweep *sweep) {
    int64_t n = sweep->cells, count = sweep->directions, border = n + 2;
    if (sweep->axis == 2) {
        /* Cells along this axis are neighbours in memory. */
        for (int64_t r = 0; r < n; r++) {
            for (int64_t d = 0; d < count; d++) {
                int64_t c = 0;
                for (; c + LANES <= n; c += LANES) follow_straight(sweep, d, r, c, LANES);
                if (c < n) follow_straight(sweep, d, r, c, n - c);
            }
        }
        return count;
    }
    int64_t slice = sweep->axis == 0 ? n * n : n, row = sweep->axis == 0 ? n : n * n;
    float *light[2] = {sweep->scratch, sweep->scratch + count * border * border};
    /* Rows that no direction leaves are followed one after another, which keeps them in the cache. */
    int lateral = 0;
    for (int64_t d = 0; d < count; d++) lateral |= sweep->steps[2 * d] != 0;
    int64_t together = lateral ? n : 1;
    for (int64_t d = 0; d < count; d++) {
        float entering = sweep->entering ? sweep->entering[d] : 0.0f;
        for (int64_t c = d * border * border; c < (d + 1) * border * border; c++) light[0][c] = light[1][c] = entering;
    }
    for (int64_t first = 0; first < n; first += together) {
        for (int64_t k = 0; k < n; k++) {
            int64_t number = sweep->sign > 0 ? k : n - 1 - k;
            for (int64_t r = first; r < first + together; r++) {
                int64_t at = number * slice + r * row, c = 0;
                for (; c + LANES <= n; c += LANES) {
                    follow(sweep, light[k & 1], light[~k & 1], number, r, c, at + c, LANES);
                }
                if (c < n) follow(sweep, light[k & 1], light[~k & 1], number, r, c, at + c, n - c);
            }
        }
    }
    return count;
}

/* Follow one direction through some neighbouring cells of a row, at most LANES. before, after: its radiance in the slice
passed last and in this one, each with a border of zeros. ray, cell: where the first of them is in these and in the
volume. */
static inline __attribute__((always_inline)) void follow_some(const RadianceSweep *sweep, int64_t d,
                                                               const float *before, float *after, int64_t ray,
                                                               int64_t cell, int64_t width) {
    int64_t here = sweep->kinds[d] * sweep->cells + cell;
    float f = sweep->slopes[2 * d], g = sweep->slopes[2 * d + 1];
    const float *weights = sweep->weights + SUMS * d;
    const float *last = before - sweep->signs[1] * (sweep->shape[2] + 2);
    Floats own = load_some(before + ray, width) * (1.0f - f) + load_some(last + ray, width) * f;
    ray -= sweep->signs[2];
    Floats beside = load_some(before + ray, width) * (1.0f - f) + load_some(last + ray, width) * f;
    ray += sweep->signs[2];
    Floats moved = own * (1.0f - g) + beside * g;
    Floats leaving = moved * load_some(sweep->passed + here, width) + load_some(sweep->given + here, width);
    Floats mean = moved * load_some(sweep->mean + here, width) + load_some(sweep->added + here, width);
    store_some(after + ray, leaving, width);
    for (int n = 0; n < SUMS; n++) {
        float *sum = sweep->fluence + n * sweep->cells + cell;
        store_some(sum, load_some(sum, width) + weights[n] * mean, width);
    }
}

/* Follow one direction through a slice of cells; at: of its first cell in the volume. */
static void follow_slice(const RadianceSweep *sweep, int64_t d, const float *before, float *after, int64_t at) {
    int64_t columns = sweep->shape[2], whole = columns - columns % LANES;
    for (int64_t i = 0; i < sweep->shape[1]; i++) {
        int64_t ray = (i + 1) * (columns + 2) + 1, cell = at + i * sweep->strides[1];
        for (int64_t c = 0; c < whole; c += LANES) follow_some(sweep, d, before, after, ray + c, cell + c, LANES);
        if (whole < columns) follow_some(sweep, d, before, after, ray + whole, cell + whole, columns - whole);
    }
}

int64_t NAMED(sweep_radiance, VARIANT)(const RadianceSweep *sweep) {
    int64_t slice = (sweep->shape[1] + 2) * (sweep->shape[2] + 2), all = sweep->directions * slice;
    memset(sweep->scratch, 0, (size_t)(2 * all) * sizeof *sweep->scratch);
    for (int64_t k = 0; k < sweep->shape[0]; k++) {
        int64_t number = sweep->signs[0] > 0 ? k : sweep->shape[0] - 1 - k;
        for (int64_t d = 0; d < sweep->directions; d++) {
            float *before = sweep->scratch + d * slice + (k & 1 ? all : 0);
            float *after = sweep->scratch + d * slice + (k & 1 ? 0 : all);
            follow_slice(sweep, d, before, after, number * sweep->strides[0]);
        }
    }
    return sweep->directions;
}

/* Subtract the light that couplings bring from other cells. */
static void subtract(int64_t count, const double *couplings, const double *from, double *restrict to) {
    for (int64_t k = 0; k < count; k++) to[k] -= couplings[k] * from[k];
}

/* The sum of products, in their order. */
static double inner_product(int64_t count, const double *a, const double *b, double sum) {
    for (int64_t k = 0; k < count; k++) sum += a[k] * b[k];
    return sum;
}

/* The operator applied to `direction`; returns the inner product of both. */
static double apply(const Diffusion *system) {
    const int64_t *shape = system->shape;
    int64_t n = shape[2], strides[2] = {shape[1] * n, n}, cells = shape[0] * strides[0];
    double sum = 0.0;
    for (int64_t i = 0; i < shape[0]; i++) {
        for (int64_t j = 0; j < shape[1]; j++) {
            int64_t row[2] = {i, j}, at = i * strides[0] + j * strides[1];
            const double *p = system->direction + at, *along = system->couplings + 2 * cells + at;
            double *y = system->product + at;
            for (int64_t k = 0; k < n; k++) y[k] = system->diagonal[at + k] * p[k];
            for (int axis = 0; axis < 2; axis++) {
                const double *coupling = system->couplings + axis * cells + at;
                int64_t stride = strides[axis];
                if (row[axis] + 1 < shape[axis]) subtract(n, coupling, p + stride, y);
                if (row[axis] > 0) subtract(n, coupling - stride, p - stride, y);
            }
            subtract(n - 1, along, p + 1, y);
            subtract(n - 1, along, p, y + 1);
            sum = inner_product(n, y, p, sum);
        }
    }
    return sum;
}

/* Returns the number of iterations, fewer than given once the residual is small enough. */
int64_t NAMED(conjugate_gradients, VARIANT)(Diffusion *system) {
    int64_t cells = system->shape[0] * system->shape[1] * system->shape[2];
    for (int64_t n = 0; n < system->iterations; n++) {
        /* Not a number ends it, too. */
        if (!(system->rz > system->limit)) return n;
        double step = system->rz / apply(system), rz = 0.0;
        for (int64_t at = 0; at < cells; at++) {
            system->x[at] += step * system->direction[at];
            system->residual[at] -= step * system->product[at];
            system->product[at] = system->residual[at] / system->diagonal[at];
        }
        rz = inner_product(cells, system->residual, system->product, rz);
        double ratio = rz / system->rz;
        for (int64_t at = 0; at < cells; at++) {
            system->direction[at] = system->product[at] + ratio * system->direction[at];
        }
        system->rz = rz;
    }
    return system->iterations;
}

/* Limit the flux of cells such that no source is negative. */
static void limit_flux(float most, int64_t count, float *fluence, float *restrict x, float *restrict y,
                       float *restrict z) {
    for (int64_t c = 0; c < count; c++) {
        float size = sqrtf(x[c] * x[c] + y[c] * y[c] + z[c] * z[c]) * most;
        float share = fluence[c] / (size < 1e-30f ? 1e-30f : size);
        share = share > 1.0f ? 1.0f : share;
        x[c] *= share;
        y[c] *= share;
        z[c] *= share;
    }
}

/* Add to flux the diffusion of the fluence, whose cells before and after along an axis are `below` and `above`. */
static void diffuse(int64_t count, const float *diffusion, const float *below, const float *above, float distance,
                    float *restrict flux) {
    for (int64_t c = 0; c < count; c++) flux[c] -= diffusion[c] * ((above[c] - below[c]) / distance);
}

int64_t NAMED(correct_light, VARIANT)(const LightCorrection *light) {
    int64_t n = light->cells, cube = n * n * n, strides[3] = {n * n, n, 1};
    float width = 1.0f / (float)n, *field = light->field;
    for (int64_t row = 0; row < n * n; row++) {
        int64_t at = row * n, place[2] = {row / n, row % n};
        float *flux[3] = {field + cube + at, field + 2 * cube + at, field + 3 * cube + at};
        if (light->fluence) {
            const float *added = light->fluence + at, *diffusion = light->diffusion + at;
            for (int64_t c = 0; c < n; c++) field[at + c] += added[c];
            for (int axis = 0; axis < 2; axis++) {
                int64_t before = place[axis] > 0 ? strides[axis] : 0, after = place[axis] < n - 1 ? strides[axis] : 0;
                float distance = before && after ? 2.0f * width : width;
                diffuse(n, diffusion, added - before, added + after, distance, flux[axis]);
            }
            diffuse(1, diffusion, added, added + 1, width, flux[2]);
            diffuse(n - 2, diffusion + 1, added, added + 2, 2.0f * width, flux[2] + 1);
            diffuse(1, diffusion + n - 1, added + n - 2, added + n - 1, width, flux[2] + n - 1);
        }
        if (light->limited) {
            for (int64_t c = 0; c < n; c++) field[at + c] = field[at + c] < 0.0f ? 0.0f : field[at + c];
            limit_flux((float)light->most_flux, n, field + at, flux[0], flux[1], flux[2]);
        }
    }
    return n;
}
