/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Light swept through coarse cells, and its diffusion. */

#include <string.h>

#include "fields.h"
#include "variants.h"

/* Parts of the field that sources depend on, the last of which is the beam, and sums that a sweep adds to. */
#define PARTS 5
#define SUMS 4

static void load(const float *from, int64_t stride, int64_t n, float *to) {
    for (int64_t c = 0; c < n; c++) to[c] = from[c * stride];
}

/* Follow one direction through a row of cells: radiance tends towards the source function. gather: weights of its mean
in a cell in the sums, or NULL to store the mean in `sums`. */
static void follow(int64_t n, const float *restrict parts, const float *restrict beam, const float *restrict emit,
                   const float *restrict arriving, const float *restrict link, const float *restrict leaving,
                   const float *restrict within, const float *restrict gather, float *restrict after,
                   float *restrict sums) {
    for (int64_t c = 0; c < n; c++) {
        float source = emit[0] * parts[c];
        for (int i = 1; i < PARTS - 1; i++) source += emit[i] * parts[i * n + c];
        source += emit[PARTS - 1] * beam[c];
        float light = link ? arriving[c] * link[c] : arriving[c], rise = source - light;
        after[c] = rise * leaving[c] + light;
        float mean = rise * within[c] + light;
        if (!gather) sums[c] = mean;
        for (int i = 0; i < SUMS && gather; i++) sums[i * n + c] += gather[i] * mean;
    }
}

int64_t NAMED(sweep_ordinates, VARIANT)(const OrdinateSweep *sweep) {
    int64_t n = sweep->cells, count = sweep->directions, cube = n * n * n, border = n + 2;
    int64_t across[3] = {n * n, n, 1}, slice = across[sweep->axis];
    int64_t row = sweep->axis == 0 ? n : n * n, column = sweep->axis == 2 ? n : 1;
    float *light[2] = {sweep->scratch, sweep->scratch + count * border * border};
    int64_t own = sweep->beams ? PARTS - 1 : PARTS;
    float *parts = light[1] + count * border * border, *sums = parts + PARTS * n;
    /* The few rows whose cells are apart in memory; one kind of direction goes along them. */
    float *apart = sums + SUMS * n;
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
            const float *before = light[k & 1];
            float *after = light[~k & 1];
            for (int64_t r = first; r < first + together; r++) {
                int64_t at = number * slice + r * row;
                for (int i = 0; i < own; i++) load(sweep->field + i * cube + at, column, n, parts + i * n);
                memset(sums, 0, (size_t)(SUMS * n) * sizeof *sums);
                for (int64_t d = 0; d < count; d++) {
                    const int64_t *step = sweep->steps + 2 * d;
                    const float *beam = sweep->beams ? sweep->beams + d * cube + at : parts + (PARTS - 1) * n;
                    int64_t kind = sweep->kinds[d] * cube + at;
                    const float *leaving = sweep->leaving + kind, *within = sweep->within + kind;
                    if (column != 1) {
                        load(leaving, column, n, apart);
                        load(within, column, n, apart + n);
                        leaving = apart, within = apart + n;
                        if (sweep->beams) {
                            load(beam, column, n, apart + 2 * n);
                            beam = apart + 2 * n;
                        }
                    }
                    follow(n, parts, beam, sweep->emit + PARTS * d,
                           before + (d * border + r + 1 - step[0]) * border + 1 - step[1],
                           sweep->links ? sweep->links + ((number * count + d) * n + r) * n : NULL, leaving, within,
                           sweep->gather ? sweep->gather + SUMS * d : NULL, after + (d * border + r + 1) * border + 1,
                           sums);
                    if (sweep->gather) continue;
                    float *to = sweep->sums + d * cube + at;
                    for (int64_t c = 0; c < n; c++) to[c * column] = sums[c];
                }
                for (int i = 0; i < SUMS && sweep->gather; i++) {
                    float *to = sweep->sums + i * cube + at;
                    for (int64_t c = 0; c < n; c++) to[c * column] += sums[i * n + c];
                }
            }
        }
    }
    return count;
}

int64_t NAMED(sweep_radiance, VARIANT)(const RadianceSweep *sweep) {
    int64_t rows = sweep->shape[1], columns = sweep->shape[2], row = columns + 1;
    for (int64_t d = 0; d < sweep->directions; d++) {
        double *before = sweep->scratch, *after = before + (rows + 1) * row;
        double f = sweep->slopes[2 * d], g = sweep->slopes[2 * d + 1];
        const double *weights = sweep->weights + SUMS * d;
        int64_t kind = sweep->kinds[d] * sweep->cells + sweep->first;
        memset(before, 0, (size_t)(2 * (rows + 1) * row) * sizeof *before);
        for (int64_t k = 0; k < sweep->shape[0]; k++) {
            for (int64_t i = 0; i < rows; i++) {
                /* Light of the previous slice, with a row and a column of zeros before the first. */
                const double *own = before + (i + 1) * row + 1, *last = own - row;
                double *leaving = after + (i + 1) * row + 1;
                int64_t at = k * sweep->strides[0] + i * sweep->strides[1];
                for (int64_t c = 0; c < columns; c++) {
                    int64_t cell = at + c * sweep->strides[2];
                    double ahead = own[c] * (1.0 - f) + last[c] * f, behind = own[c - 1] * (1.0 - f) + last[c - 1] * f;
                    double moved = ahead * (1.0 - g) + behind * g;
                    leaving[c] = moved * sweep->passed[kind + cell] + sweep->given[kind + cell];
                    double mean = moved * sweep->mean[kind + cell] + sweep->added[kind + cell];
                    for (int n = 0; n < SUMS; n++) sweep->fluence[n][sweep->first + cell] += weights[n] * mean;
                }
            }
            double *swapped = before;
            before = after, after = swapped;
        }
    }
    return sweep->directions;
}

/* The operator applied to `direction`; returns the inner product of both. */
static double apply(const Diffusion *system) {
    const int64_t *shape = system->shape;
    int64_t strides[3] = {shape[1] * shape[2], shape[2], 1}, cells = shape[0] * strides[0];
    double sum = 0.0;
    for (int64_t i = 0; i < shape[0]; i++) {
        for (int64_t j = 0; j < shape[1]; j++) {
            for (int64_t k = 0; k < shape[2]; k++) {
                int64_t cell[3] = {i, j, k}, at = i * strides[0] + j * strides[1] + k;
                const double *p = system->direction + at;
                double y = system->diagonal[at] * *p;
                for (int axis = 0; axis < 3; axis++) {
                    const double *coupling = system->couplings + axis * cells + at;
                    int64_t stride = strides[axis];
                    if (cell[axis] + 1 < shape[axis]) y -= coupling[0] * p[stride];
                    if (cell[axis] > 0) y -= coupling[-stride] * p[-stride];
                }
                system->product[at] = y;
                sum += y * *p;
            }
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
            double residual = system->residual[at] - step * system->product[at];
            system->residual[at] = residual;
            rz += residual * (residual / system->diagonal[at]);
        }
        double ratio = rz / system->rz;
        for (int64_t at = 0; at < cells; at++) {
            system->direction[at] = system->residual[at] / system->diagonal[at] + ratio * system->direction[at];
        }
        system->rz = rz;
    }
    return system->iterations;
}
