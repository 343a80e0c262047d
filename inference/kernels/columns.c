/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Optical depths along a sun's rays and from points. */

#include <string.h>

#include "fields.h"
#include "sampling.h"
#include "variants.h"

/* Columns that a slice reaches beyond its cells: before the first, and altogether. */
#define BEFORE 2
#define MORE 3
#define EDGE 8
/* Points whose depths are sampled together. */
#define TOGETHER 64

/* Resample a plane, 0 outside, at points a fraction beyond each cell; grows by MORE.

line: scratch for columns + 2 MORE. */
static void shift_up(const float *plane, int64_t rows, int64_t columns, const int64_t *strides, const float *weights,
                     float factor, float *line, float *out) {
    for (int64_t c = 0; c < MORE; c++) line[c] = line[MORE + columns + c] = 0.0f;
    for (int64_t i = 0; i < rows + MORE; i++) {
        float *inner = line + MORE;
        for (int64_t c = 0; c < columns; c++) inner[c] = 0.0f;
        for (int64_t t = 0; t < 4; t++) {
            int64_t row = i + t - MORE;
            if (weights[t] == 0.0f || row < 0 || row >= rows) continue;
            const float *from = plane + row * strides[0];
            if (strides[1] == 1) {
                for (int64_t c = 0; c < columns; c++) inner[c] += weights[t] * from[c];
            } else {
                for (int64_t c = 0; c < columns; c++) inner[c] += weights[t] * from[c * strides[1]];
            }
        }
        float *to = out + i * (columns + MORE);
        for (int64_t c = 0; c < columns + MORE; c++) {
            float sum = weights[4] * line[c] + weights[5] * line[c + 1] + weights[6] * line[c + 2] + weights[7] * line[c + 3];
            to[c] = sum * factor;
        }
    }
}

static void add_plane(float *columns, int64_t row, const float *plane, int64_t rows, int64_t count) {
    for (int64_t i = 0; i < rows; i++) {
        for (int64_t c = 0; c < count; c++) columns[i * row + c] += plane[i * count + c];
    }
}

/* Depths at the cells, from columns placed as by shift_up. */
static void shift_back(const ColumnSweep *sweep, const float *columns, const float *fractions, float *out) {
    float f = fractions[0], g = fractions[1];
    for (int64_t i = 0; i < sweep->shape[1]; i++) {
        const float *row = columns + (i + BEFORE) * sweep->size[1] + BEFORE, *last = row - sweep->size[1];
        float *to = out + i * sweep->depth_strides[1];
        for (int64_t c = 0; c < sweep->shape[2]; c++) {
            float current = row[c] * (1.0f - f) + last[c] * f, previous = row[c - 1] * (1.0f - f) + last[c - 1] * f;
            to[c * sweep->depth_strides[2]] = current * (1.0f - g) + previous * g;
        }
    }
}

int64_t NAMED(sweep_columns, VARIANT)(const ColumnSweep *sweep) {
    int64_t rows = sweep->shape[1] + MORE, count = sweep->shape[2] + MORE;
    float *half_slice = sweep->scratch, *line = half_slice + rows * count;
    for (int64_t n = 0; n < sweep->count; n++) {
        int64_t slice = sweep->slices[n];
        const int64_t *start = sweep->starts + 2 * n;
        float *window = sweep->columns + start[0] * sweep->size[1] + start[1];
        float *out = sweep->depths + slice * sweep->depth_strides[0];
        shift_up(sweep->density + slice * sweep->strides[0], sweep->shape[1], sweep->shape[2], sweep->strides + 1,
                 sweep->weights + 8 * n, (float)sweep->half_step, line, half_slice);
        add_plane(window, sweep->size[1], half_slice, rows, count);
        if (sweep->fractions) {
            shift_back(sweep, window, sweep->fractions + 2 * n, out);
        } else {
            for (int64_t i = 0; i < rows; i++) {
                const float *from = window + i * sweep->size[1];
                float *to = out + i * sweep->depth_strides[1];
                for (int64_t c = 0; c < count; c++) to[c] = from[c] > 0.0f ? from[c] : 0.0f;
            }
        }
        add_plane(window, sweep->size[1], half_slice, rows, count);
    }
    return sweep->count;
}

static void add_blocks(const BlockSweep *sweep, int64_t n) {
    float line[EDGE + 2 * MORE], half_slice[(EDGE + MORE) * (EDGE + MORE)];
    for (int64_t b = 0; b < sweep->blocks; b++) {
        int64_t block = sweep->block_rows[b];
        if ((uint64_t)block >= (uint64_t)sweep->rows) continue;
        const int64_t *tile = sweep->block_places + 2 * b, *start = sweep->starts + 2 * n;
        float *window = sweep->columns + (EDGE * tile[0] + start[0]) * sweep->size[1] + EDGE * tile[1] + start[1];
        shift_up(sweep->values + block * EDGE * EDGE * EDGE + sweep->slices[n] * sweep->strides[0], EDGE, EDGE,
                 sweep->strides + 1, sweep->weights + 8 * n, (float)sweep->half_step, line, half_slice);
        add_plane(window, sweep->size[1], half_slice, EDGE + MORE, EDGE + MORE);
    }
}

int64_t NAMED(sweep_blocks, VARIANT)(const BlockSweep *sweep) {
    for (int64_t n = 0; n < EDGE; n++) {
        add_blocks(sweep, n);
        for (int64_t t = 0; t < sweep->touched; t++) {
            const int64_t *tile = sweep->tiles + 2 * t;
            const float *from = sweep->columns + EDGE * tile[0] * sweep->size[1] + EDGE * tile[1];
            float *to = sweep->depths + (t * EDGE + sweep->slices[n]) * EDGE * EDGE;
            for (int64_t i = 0; i < EDGE; i++) {
                for (int64_t c = 0; c < EDGE; c++) {
                    float depth = from[i * sweep->size[1] + c];
                    to[i * EDGE + c] = depth > 0.0f ? depth : 0.0f;
                }
            }
        }
        add_blocks(sweep, n);
    }
    return sweep->blocks;
}

/* Optical depths from points in one direction. */
static Floats open_depth(const OpenDepthSamples *data, const Floats *at, const float *towards, const float *lattice) {
    Floats depth = in_all(0.0f);
    for (int64_t s = 0; s < data->samples; s++) {
        int64_t level = data->sampled[s], cells = data->cells[level];
        const int64_t *strides = data->strides + 2 * level;
        Ints inside = (Ints){0} - 1, cell[3];
        for (int axis = 0; axis < 3; axis++) {
            Floats along = (at[axis] + data->middles[s] * towards[axis] + 0.5f) * (float)cells;
            inside &= (along >= 0.0f) & (along < (float)cells);
            cell[axis] = ints_within(to_ints(clamped_to(along, in_all(0.0f), in_all((float)cells))), (int32_t)cells - 1);
        }
        Longs voxel = to_longs(cell[0]) * strides[0] + to_longs(cell[1]) * strides[1] + to_longs(cell[2]);
        Floats density;
        FOR_LANES(n) density[n] = data->levels[level][voxel[n]];
        depth += choose(inside, data->lengths[s] * density, in_all(0.0f));
    }
    int64_t n = data->edge, first[LANES];
    Ints inside = (Ints){0} - 1, cell[3];
    Floats fraction[3];
    for (int axis = 0; axis < 3; axis++) {
        Floats end = at[axis] + (float)data->reach * towards[axis];
        inside &= (end > -0.5f) & (end < 0.5f);
        Floats index = (clamped_to(end, in_all(-0.5f), in_all(0.5f)) + 0.5f) * (float)(n - 2) + 0.5f;
        cell[axis] = ints_within(to_ints(index), (int32_t)n - 2);
        fraction[axis] = index - to_floats(cell[axis]);
    }
    if (!any_lane(inside)) return depth;
    Longs voxel = (to_longs(cell[0]) * n + to_longs(cell[1])) * n + to_longs(cell[2]);
    memcpy(first, &voxel, sizeof first);
    Pairs pairs[4];
    FOR_LANES(m) {
        const float *row = lattice + first[m];
        pairs[0][m] = pair_at(row), pairs[1][m] = pair_at(row + n);
        pairs[2][m] = pair_at(row + n * n), pairs[3][m] = pair_at(row + n * n + n);
    }
    return depth + choose(inside, trilinear(pairs, fraction), in_all(0.0f));
}

int64_t NAMED(sample_open_depths, VARIANT)(const OpenDepthSamples *data) {
    int64_t n = data->edge, cube = n * n * n;
    /* Points that are close to each other read the same cells in each direction. */
    for (int64_t first = 0; first < data->points; first += TOGETHER) {
        int64_t end = first + TOGETHER < data->points ? first + TOGETHER : data->points;
        for (int64_t d = 0; d < data->directions; d++) {
            const float *towards = data->towards + 3 * d, *lattice = data->lattice + d * cube;
            for (int64_t point = first; point < end; point += LANES) {
                int used = end - point < LANES ? (int)(end - point) : LANES;
                Floats at[3], depth;
                for (int axis = 0; axis < 3; axis++) {
                    FOR_LANES(m) at[axis][m] = data->positions[3 * (point + (m < used ? m : used - 1)) + axis];
                }
                depth = open_depth(data, at, towards, lattice);
                for (int m = 0; m < used; m++) data->depths[(point + m) * data->directions + d] = depth[m];
            }
        }
    }
    return data->points;
}

int64_t NAMED(sun_depths, VARIANT)(const SunDepths *data) {
    float extinction = (float)data->sigma_t;
    for (int64_t point = 0; point < data->points; point += LANES) {
        int used = data->points - point < LANES ? (int)(data->points - point) : LANES;
        Floats index[3], depth;
        for (int axis = 0; axis < 3; axis++) {
            const float *from = data->index + axis * data->points + point;
            FOR_LANES(n) index[axis][n] = from[n < used ? n : used - 1];
        }
        depth = volume_sun_depth(&data->density, &data->columns, extinction, index, in_all(0.0f), (int)data->outside);
        for (int n = 0; n < used; n++) data->out[point + n] = depth[n];
    }
    return data->points;
}
