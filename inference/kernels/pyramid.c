/* SPDX-License-Identifier: GPL-3.0-or-later */
/* The density pyramid and the lattices made of it. */

#include <math.h>

#include "fields.h"
#include "sampling.h"
#include "variants.h"

#define EDGE 8

/* Copy a plane of active voxels, across the first axis. */
static void fetch_plane(const CellMeans *means, int64_t number, float *plane) {
    const Grid *grid = &means->density;
    int64_t rows = means->voxels[1], columns = means->voxels[2], x = means->low[0] + number;
    if (!grid->table) {
        const float *from = grid->values + (x * grid->shape[1] + means->low[1]) * grid->shape[2] + means->low[2];
        for (int64_t i = 0; i < rows; i++) {
            memcpy(plane + i * columns, from + i * grid->shape[2], (size_t)columns * sizeof *plane);
        }
        return;
    }
    x += grid->first[0];
    int64_t first[2] = {means->low[1] + grid->first[1], means->low[2] + grid->first[2]};
    for (int64_t i = 0; i < rows; i++) {
        int64_t y = first[0] + i;
        const int32_t *table = grid->table + ((x >> 3) * grid->size[1] + (y >> 3)) * grid->size[2];
        for (int64_t c = 0; c < columns;) {
            int64_t z = first[1] + c, row = table[z >> 3], end = EDGE - (z & 7);
            if (end > columns - c) end = columns - c;
            if ((uint64_t)row >= (uint64_t)grid->rows) row = 0;
            const float *from = grid->values + ((row * EDGE + (x & 7)) * EDGE + (y & 7)) * EDGE + (z & 7);
            memcpy(plane + i * columns + c, from, (size_t)end * sizeof *plane);
            c += end;
        }
    }
}

/* Cells of a plane that voxels reach: rows from first[0] to before end[0], and columns. */
typedef struct {
    int64_t first[2], end[2];
} Reached;

static Reached reached_cells(const CellMeans *means) {
    Reached reached = {{means->cells, means->cells}, {0, 0}};
    for (int axis = 0; axis < 2; axis++) {
        int64_t width = means->widths[axis + 1];
        for (int64_t n = 0; n < means->cells * width; n++) {
            if (means->weights[axis + 1][n] == 0.0f) continue;
            if (n / width < reached.first[axis]) reached.first[axis] = n / width;
            reached.end[axis] = n / width + 1;
        }
    }
    return reached;
}

/* Means of a voxel plane over the cells of a plane (cells, cells) that it reaches. */
static void average_plane(const CellMeans *means, int64_t number, const Reached *reached, float *out) {
    int64_t cells = means->cells, rows = means->voxels[1], columns = means->voxels[2];
    int64_t begin = reached->first[1], end = reached->end[1];
    float *plane = means->scratch + means->widths[0] * cells * cells, *lines = plane + rows * columns;
    fetch_plane(means, number, plane);
    for (int64_t i = 0; i < rows; i++) {
        const float *from = plane + i * columns;
        float *line = lines + i * cells;
        for (int64_t c = begin; c < end; c++) {
            const float *at = from + means->firsts[2][c], *weights = means->weights[2] + c * means->widths[2];
            float sum = 0.0f;
            for (int64_t n = 0; n < means->widths[2]; n++) sum += weights[n] * at[n];
            line[c] = sum;
        }
    }
    for (int64_t r = reached->first[0]; r < reached->end[0]; r++) {
        const float *line = lines + means->firsts[1][r] * cells, *weights = means->weights[1] + r * means->widths[1];
        float *to = out + r * cells;
        for (int64_t c = begin; c < end; c++) to[c] = 0.0f;
        for (int64_t n = 0; n < means->widths[1]; n++) {
            if (weights[n] == 0.0f) continue;
            for (int64_t c = begin; c < end; c++) to[c] += weights[n] * line[n * cells + c];
        }
    }
}

int64_t NAMED(mean_cells, VARIANT)(const CellMeans *means) {
    int64_t cells = means->cells, width = means->widths[0];
    Reached reached = reached_cells(means);
    int64_t begin = reached.first[1], end = reached.end[1];
    for (int64_t x = means->begin; x < means->end; x++) {
        const float *weights = means->weights[0] + x * width;
        int empty = 1;
        for (int64_t n = 0; n < width; n++) {
            int64_t number = means->firsts[0][x] + n, slot = number % width;
            if (weights[n] == 0.0f) continue;
            empty = 0;
            if (means->held[slot] != number) {
                average_plane(means, number, &reached, means->scratch + slot * cells * cells);
                means->held[slot] = number;
            }
        }
        if (empty) continue;
        for (int64_t r = reached.first[0]; r < reached.end[0]; r++) {
            float *to = means->out + x * means->strides[0] + r * means->strides[1];
            for (int64_t c = begin; c < end; c++) to[c] = 0.0f;
            for (int64_t n = 0; n < width; n++) {
                const float *from = means->scratch + ((means->firsts[0][x] + n) % width * cells + r) * cells;
                if (weights[n] == 0.0f) continue;
                for (int64_t c = begin; c < end; c++) to[c] += weights[n] * from[c];
            }
            for (int64_t c = begin; c < end; c++) to[c] = to[c] > 0.0f ? to[c] : 0.0f;
        }
    }
    return means->end - means->begin;
}

int64_t NAMED(halve, VARIANT)(const Halving *levels) {
    const int64_t *fine = levels->fine_strides, *coarse = levels->coarse_strides;
    for (int64_t i = 0; i < levels->size[0]; i++) {
        for (int64_t j = 0; j < levels->size[1]; j++) {
            const float *at = levels->fine + 2 * i * fine[0] + 2 * j * fine[1], *next = at + fine[1];
            float *to = levels->coarse + i * coarse[0] + j * coarse[1];
            for (int64_t k = 0; k < levels->size[2]; k++) {
                float even = (at[2 * k] + at[fine[0] + 2 * k]) + (next[2 * k] + next[fine[0] + 2 * k]);
                float odd = (at[2 * k + 1] + at[fine[0] + 2 * k + 1]) + (next[2 * k + 1] + next[fine[0] + 2 * k + 1]);
                to[k] = (even + odd) * 0.125f;
            }
        }
    }
    return levels->size[0];
}

/* Values between those of a row and of its neighbour. */
static void mix(int64_t count, const float *near, const float *far, float *restrict to) {
    for (int64_t k = 0; k < count; k++) to[k] = 0.25f * far[k] + 0.75f * near[k];
}

/* The neighbour of a coarse cell that a fine one lies towards: itself at the faces. */
static int64_t neighbour(int64_t fine, int64_t size) {
    int64_t other = fine / 2 + (fine % 2 ? 1 : -1);
    return other < 0 ? 0 : other < size ? other : size - 1;
}

int64_t NAMED(refine, VARIANT)(const Refining *cells) {
    const int64_t *size = cells->size;
    int64_t columns = size[2], plane = size[1] * columns;
    float *slice = cells->scratch, *row = slice + plane;
    for (int64_t i = 0; i < 2 * size[0]; i++) {
        mix(plane, cells->coarse + i / 2 * plane, cells->coarse + neighbour(i, size[0]) * plane, slice);
        for (int64_t j = 0; j < 2 * size[1]; j++) {
            mix(columns, slice + j / 2 * columns, slice + neighbour(j, size[1]) * columns, row);
            float *to = cells->fine + (i * 2 * size[1] + j) * 2 * columns;
            to[0] = 0.25f * row[0] + 0.75f * row[0];
            for (int64_t k = 1; k < columns; k++) {
                to[2 * k - 1] = 0.25f * row[k] + 0.75f * row[k - 1];
                to[2 * k] = 0.25f * row[k - 1] + 0.75f * row[k];
            }
            to[2 * columns - 1] = 0.25f * row[columns - 1] + 0.75f * row[columns - 1];
        }
    }
    return size[0];
}

static inline float lerp(float low, float high, float fraction) { return (high - low) * fraction + low; }

/* exp(-scale x) in place. */
static void attenuate(float scale, int64_t count, float *values) {
    for (int64_t k = 0; k < count; k += LANES) {
        size_t bytes = (size_t)(count - k < LANES ? count - k : LANES) * sizeof *values;
        Floats lanes = in_all(0.0f);
        memcpy(&lanes, values + k, bytes);
        lanes = transmittance(scale * lanes);
        memcpy(values + k, &lanes, bytes);
    }
}

/* The natural logarithm of finite x >= 1. */
static inline float log_of(float x) {
    int32_t bits;
    memcpy(&bits, &x, sizeof bits);
    /* x = m 2^e with m from sqrt(1/2) to sqrt(2). */
    int32_t e = (bits - 0x3f3504f3) >> 23;
    bits -= e * (1 << 23);
    float m, power = (float)e;
    memcpy(&m, &bits, sizeof m);
    m -= 1.0f;
    float p = 7.0376836292e-2f;
    p = p * m - 1.1514610310e-1f;
    p = p * m + 1.1676998740e-1f;
    p = p * m - 1.2420140846e-1f;
    p = p * m + 1.4249322787e-1f;
    p = p * m - 1.6668057665e-1f;
    p = p * m + 2.0000714765e-1f;
    p = p * m - 2.4999993993e-1f;
    p = p * m + 3.3333331174e-1f;
    float square = m * m, rest = p * m * square;
    rest += power * -2.12194440e-4f;
    rest -= 0.5f * square;
    return m + rest + power * 0.693359375f;
}

/* A row of fine cells along the last axis, from the rows around it. line: scratch. */
static void refine_row(const Refinement *grid, int64_t i, int64_t j, int64_t count, float *line, float *row) {
    int64_t columns = grid->shape[2], slab = grid->shape[1] * columns;
    const float *at = grid->values + grid->below[0][i] * slab + grid->below[1][j] * columns;
    float f = grid->fraction[0][i], g = grid->fraction[1][j];
    const int32_t *below = grid->below[2];
    const float *fraction = grid->fraction[2];
    /* Of the cells that the row lies between. */
    int64_t end = below[count - 1] + 2;
    for (int64_t c = below[0]; c < end; c++) {
        float low = lerp(at[c], at[slab + c], f), high = lerp(at[columns + c], at[slab + columns + c], f);
        line[c] = lerp(low, high, g);
    }
    for (int64_t k = 0; k < count; k++) row[k] = lerp(line[below[k]], line[below[k] + 1], fraction[k]);
}

/* The whole number, up to 65535, that is nearest to x. */
static inline uint16_t quantum(float x) {
    return (uint16_t)(int32_t)(clamped(x, 0.0f, 65535.0f) + ROUNDING - ROUNDING);
}

int64_t NAMED(fill_lattice, VARIANT)(const LatticePart *part) {
    int64_t count = part->shape[2];
    float *row = part->scratch, *visible = row + count, *line = visible + count;
    float scale = (float)part->density_scale, steps = (float)(1.0 / part->density_step);
    for (int64_t i = 0; i < part->shape[0]; i++) {
        for (int64_t j = 0; j < part->shape[1]; j++) {
            uint16_t *to = part->packed + (i * part->shape[1] + j) * count;
            if (part->density.values) {
                refine_row(&part->density, i, j, count, line, row);
                for (int64_t k = 0; k < count; k++) {
                    row[k] = log_of(clamped(row[k] * scale + 1.0f, 1.0f, 3e38f)) * steps;
                }
                for (int64_t k = 0; k < count; k++) to[k] = quantum(row[k]);
            }
            if (!part->depth.values) continue;
            refine_row(&part->depth, i, j, count, line, row);
            attenuate((float)part->depth_scale, count, row);
            if (part->visibility.values) {
                float least_visible = (float)part->least_visible;
                refine_row(&part->visibility, i, j, count, line, visible);
                for (int64_t k = 0; k < count; k++) row[k] *= visible[k] * (1.0f - least_visible) + least_visible;
            }
            for (int64_t k = 0; k < count; k++) to[k] = quantum(row[k] * 65535.0f);
        }
    }
    return part->shape[0];
}

/* Cut the voxels begin to end of a row to those that points of a grid's support may lie in. */
static void cut_row(const Resampling *grid, const double *first, const double *reach, int64_t *begin, int64_t *end) {
    double from = 0.0, to = (double)grid->shape[2];
    for (int axis = 0; axis < 3; axis++) {
        double slope = grid->linear[3 * axis + 2], low = -1.0 - reach[axis] - first[axis];
        double high = (double)grid->grid.shape[axis] + reach[axis] - first[axis];
        if (slope < 0.0) {
            double swapped = low;
            low = -high, high = -swapped, slope = -slope;
        }
        if (slope > 1e-12) {
            from = low / slope > from ? low / slope : from, to = high / slope < to ? high / slope : to;
        } else if (!(low <= 0.0 && high >= 0.0)) {
            to = -1.0;
        }
    }
    /* A row may meet the grid far beyond what integers hold. */
    if (from > (double)grid->shape[2]) from = (double)grid->shape[2];
    /* What rounding may add. */
    *begin = from > 1.0 ? (int64_t)from - 1 : 0;
    *end = to < 0.0 ? 0 : to + 2.0 < (double)grid->shape[2] ? (int64_t)to + 2 : grid->shape[2];
}

int64_t NAMED(resample, VARIANT)(const Resampling *grid) {
    const double *linear = grid->linear;
    float points = (float)grid->points;
    /* Voxels of one point are filled together. */
    int64_t together = grid->points == 1 ? LANES : 1;
    double reach[3] = {0.0, 0.0, 0.0};
    for (int64_t n = 0; n < 3 * grid->points; n++) {
        double size = fabs(grid->places[n]);
        reach[n % 3] = size > reach[n % 3] ? size : reach[n % 3];
    }
    for (int64_t i = 0; i < grid->shape[0]; i++) {
        for (int64_t j = 0; j < grid->shape[1]; j++) {
            float *to = grid->out + i * grid->strides[0] + j * grid->strides[1];
            double first_of_row[3];
            int64_t begin, end;
            for (int axis = 0; axis < 3; axis++) {
                const double *row = linear + 3 * axis;
                first_of_row[axis] = row[0] * (double)i + row[1] * (double)j + grid->offset[axis];
            }
            cut_row(grid, first_of_row, reach, &begin, &end);
            for (int64_t k = begin; k < end; k += together) {
                float sums[LANES] = {0.0f};
                for (int64_t first = 0; first < grid->points; first += LANES) {
                    Floats positions[3];
                    Ints near, used;
                    FOR_LANES(n) {
                        /* The last point again where there are no more. */
                        int64_t point = first + n < grid->points ? first + n : grid->points - 1;
                        double voxel = (double)(together > 1 ? k + n : k);
                        for (int axis = 0; axis < 3; axis++) {
                            double centre = first_of_row[axis] + linear[3 * axis + 2] * voxel;
                            positions[axis][n] = (float)(centre + grid->places[3 * point + axis]);
                        }
                        used[n] = (together > 1 ? k + n < end : first + n < grid->points) ? -1 : 0;
                    }
                    Longs cells = cells_around(&grid->occupancy, positions);
                    FOR_LANES(n) near[n] = used[n] && !grid->occupancy.clearance[cells[n]] ? -1 : 0;
                    if (!any_lane(near)) continue;
                    Floats values = sample_grid(&grid->grid, positions), size = choose(values < 0.0f, -values, values);
                    Floats power = in_all(1.0f);
                    for (int64_t times = 1; times < grid->power; times++) power *= size;
                    FOR_LANES(n) {
                        if (near[n]) sums[together > 1 ? n : 0] += values[n] * power[n] / points;
                    }
                }
                for (int64_t n = 0; n < together && k + n < end; n++) to[(k + n) * grid->strides[2]] = sums[n];
            }
        }
    }
    return grid->shape[0];
}
