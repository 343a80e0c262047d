/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Optical depths around lamps, and their light in cells. */

#include <string.h>

#include "fields.h"
#include "lamp_sampling.h"
#include "variants.h"

/* Weights of four voxels at a fraction beyond the second: optical_depth_sweep.cubic. step: from one to the next. */
static void cubic_weights(double f, float *weights, int64_t step) {
    weights[0] = (float)(0.5 * f * (-1.0 + f * (2.0 - f)));
    weights[step] = (float)(1.0 + 0.5 * f * f * (3.0 * f - 5.0));
    weights[2 * step] = (float)(0.5 * f * (1.0 + f * (4.0 - 3.0 * f)));
    weights[3 * step] = (float)(0.5 * f * f * (f - 1.0));
}

/* Interpolate a row of voxels at columns. line: the row. cells: voxel below each column. weights: (4, columns). */
static void columns_of(const float *line, const int32_t *cells, const float *weights, int64_t columns, int64_t low,
                       int64_t high, float *out) {
    int64_t n = low;
    for (; n + LANES <= high; n += LANES) {
        Pairs before, after;
        FOR_LANES(k) {
            const float *at = line + cells[n + k] - 1;
            before[k] = pair_at(at), after[k] = pair_at(at + 2);
        }
        const float *weight = weights + n;
        store(out + n, load(weight) * first_of(before) + load(weight + columns) * second_of(before) +
                           load(weight + 2 * columns) * first_of(after) + load(weight + 3 * columns) * second_of(after));
    }
    for (; n < high; n++) {
        const float *at = line + cells[n] - 1, *weight = weights + n;
        out[n] = weight[0] * at[0] + weight[columns] * at[1] + weight[2 * columns] * at[2] + weight[3 * columns] * at[3];
    }
}

/* Voxels of a plane across an axis: those of a row follow each other, `stride` after those of the row before. */
typedef struct {
    const float *values;
    int64_t stride, rows, width;
} Plane;

/* A plane of a grid; others: the other axes. low, high: positions between which its rows are wanted. scratch: for
voxels that do not follow each other in the grid. */
static Plane plane_of(const Grid *grid, int64_t axis, int64_t number, const int *others, double low, double high,
                      float *scratch) {
    Plane plane = {scratch, grid->shape[others[1]], grid->shape[others[0]], grid->shape[others[1]]};
    int64_t begin = (int64_t)larger(floor(smaller(low, (double)plane.rows + 1.0)) - 1.0, 0.0);
    int64_t end = (int64_t)smaller(floor(larger(high, -3.0)) + 3.0, (double)plane.rows);
    if (!grid->table) {
        int64_t strides[3] = {grid->size[1] * grid->size[2], grid->size[2], 1};
        int64_t row = strides[others[0]], step = strides[others[1]];
        const float *first = grid->values + (number + 1) * strides[axis] + row + step;
        if (step == 1) {
            plane.values = first, plane.stride = row;
            return plane;
        }
        for (int64_t i = begin; i < end; i++) {
            for (int64_t n = 0; n < plane.width; n++) scratch[i * plane.width + n] = first[i * row + n * step];
        }
        return plane;
    }
    int64_t voxel[3];
    voxel[axis] = number + grid->first[axis];
    for (int64_t row = begin; row < end; row++) {
        voxel[others[0]] = row + grid->first[others[0]];
        for (int64_t n = 0; n < plane.width; n++) {
            voxel[others[1]] = n + grid->first[others[1]];
            int64_t block = ((voxel[0] >> 3) * grid->size[1] + (voxel[1] >> 3)) * grid->size[2] + (voxel[2] >> 3);
            int64_t inside = (voxel[0] & 7) * 64 + (voxel[1] & 7) * 8 + (voxel[2] & 7);
            scratch[row * plane.width + n] = block_values(grid, block)[inside];
        }
    }
    return plane;
}

/* Whether any value is not 0; by their bits, which are compared many at a time. */
static int any_of(const float *values, int64_t count) {
    const int32_t *bits = (const int32_t *)values;
    int32_t nonzero = 0;
    for (int64_t n = 0; n < count; n++) nonzero |= bits[n] & 0x7fffffff;
    return nonzero != 0;
}

/* Interpolate the four rows of a plane around a position. Returns whether any of their voxels is not 0. */
static int row_at(const Plane *plane, double position, float *out) {
    double below = floor(position);
    float weights[4];
    if (!(below >= -2.0 && below <= (double)plane->rows)) return 0;
    cubic_weights(position - below, weights, 1);
    for (int64_t n = 0; n < plane->width; n++) out[n] = 0.0f;
    for (int tap = 0; tap < 4; tap++) {
        int64_t row = (int64_t)below + tap - 1;
        if (row < 0 || row >= plane->rows || weights[tap] == 0.0f) continue;
        const float *from = plane->values + row * plane->stride;
        for (int64_t n = 0; n < plane->width; n++) out[n] += weights[tap] * from[n];
    }
    return any_of(out, plane->width);
}

int64_t NAMED(fill_lamp_columns, VARIANT)(const LampSlices *data) {
    const Pyramid *pyramid = &data->pyramid;
    int axis = (int)data->axis, others[2] = {axis == 0 ? 1 : 0, axis == 2 ? 1 : 2};
    int64_t width = data->density.shape[others[1]], last = data->density.shape[axis] - 1;
    int64_t b = pyramid->size[0], c = pyramid->size[1];
    float *weights = data->scratch, *density = weights + 4 * c, *line = density + c + 3, *scratch = line + width + 3;
    for (int64_t n = 0; n < 3; n++) line[-1 - n] = line[width + n] = 0.0f;
    if (data->inside && data->planes > 0) {
        Floats lamp[3];
        for (int k = 0; k < 3; k++) lamp[k] = clamped_to(in_all((float)data->lamp[k]), in_all(-FAR_AWAY), in_all(FAR_AWAY));
        float first = sample_grid(&data->density, lamp)[0] * (float)data->ways[0];
        for (int64_t n = 0; n < b * c; n++) data->running[n] += first;
    }
    for (int64_t p = 0; p < data->planes; p++) {
        double along = fabs((double)data->numbers[p] - data->lamp[axis]);
        float before = (float)data->ways[2 * p], both = before + (float)data->ways[2 * p + 1];
        float *out = data->slices[p] ? pyramid->depths + within(data->slices[p], pyramid->slices - 1) * b * c : NULL;
        double across = data->lamp[others[0]] + along * pyramid->first[0], apart = along * pyramid->spacing[0];
        Plane plane = plane_of(&data->density, axis, within(data->numbers[p], last), others, across,
                               across + apart * (double)(b - 1), scratch);
        int filled = data->numbers[p] >= 0 && data->numbers[p] <= last;
        double first = data->lamp[others[1]] + along * pyramid->first[1], step = along * pyramid->spacing[1];
        /* The columns that any of the row's voxels reaches. */
        int64_t low = (int64_t)larger(smaller(ceil((-2.0 - first) / step), (double)c), 0.0);
        int64_t high = (int64_t)larger(smaller(ceil(((double)width + 1.0 - first) / step), (double)c), 0.0);
        for (int64_t n = low; filled && n < high; n++) {
            double column = first + step * (double)n, below = floor(column);
            data->cells[n] = (int32_t)larger(smaller(below, (double)width), -2.0);
            cubic_weights(column - below, weights + n, c);
        }
        for (int64_t row = 0; row < b; row++) {
            float *running = data->running + row * c, *to = out ? out + row * c : NULL;
            /* Where columns have met nothing, depths stay the zeros that they are, and take no memory yet. */
            if (to && any_of(running, c)) memcpy(to, running, (size_t)c * sizeof *running);
            if (!filled || !row_at(&plane, across + apart * (double)row, line)) continue;
            columns_of(line, data->cells, weights, c, low, high, density);
            for (int64_t n = low; n < high && to; n++) to[n] += before * density[n];
            for (int64_t n = low; n < high; n++) running[n] += both * density[n];
        }
    }
    return data->planes;
}

int64_t NAMED(lamp_depths, VARIANT)(const LampDepths *data) {
    for (int64_t point = 0; point < data->points; point += LANES) {
        int used = data->points - point < LANES ? (int)(data->points - point) : LANES;
        Floats index[3];
        for (int axis = 0; axis < 3; axis++) {
            const float *from = data->index + axis * data->points + point;
            FOR_LANES(n) index[axis][n] = from[n < used ? n : used - 1];
        }
        Floats depth = lamp_depth(data->columns, index, (float)data->sigma_t);
        for (int n = 0; n < used; n++) data->out[point + n] = depth[n];
    }
    return data->points;
}

/* Add the fluence of emitter e at points to `light`, attenuated, and to `open`, unattenuated; index: in cells. */
static void add_light(const LampBeam *beam, int64_t e, const Floats *index, const Doubles *point, Floats *light,
                      Floats *open) {
    const Emitter *emitter = beam->emitters + e;
    Floats fluence = softened(emitter_fluences(emitter, point), beam->radius);
    *open += fluence;
    for (int n = 0; n < LANES && beam->shadow_maps[e]; n++) {
        if (!(fluence[n] > 0.0f)) continue;
        double at[3] = {point[0][n], point[1][n], point[2][n]};
        fluence[n] *= (float)lamp_visibility(beam->shadow_maps[e], at);
    }
    if (!any_lane(fluence > 0.0f)) return;
    *light += fluence * transmittance(lamp_depth(beam->columns[e], index, (float)beam->sigma));
}

int64_t NAMED(lamp_beam, VARIANT)(const LampBeam *beam) {
    int64_t edge = beam->parts, samples = edge * edge * edge, total = beam->count * samples;
    for (int64_t first = 0; first < total; first += LANES) {
        int used = total - first < LANES ? (int)(total - first) : LANES;
        Floats index[3], light = in_all(0.0f), open = in_all(0.0f);
        Doubles cells[3], point[3];
        FOR_LANES(k) {
            int64_t sample = first + (k < used ? k : used - 1), number = beam->numbers[sample / samples];
            int64_t row = number / beam->shape[2], inside = sample % samples;
            int64_t cell[3] = {row / beam->shape[1], row % beam->shape[1], number % beam->shape[2]};
            for (int axis = 2; axis >= 0; axis--) {
                cells[axis][k] = (double)cell[axis] + ((double)(inside % edge) + 0.5) / (double)edge - 0.5;
                inside /= edge;
            }
        }
        for (int i = 0; i < 3; i++) {
            const double *row = beam->world + 3 * i;
            index[i] = __builtin_convertvector(cells[i] - (double)beam->first[i], Floats);
            point[i] = row[0] * cells[0] + row[1] * cells[1] + row[2] * cells[2] + beam->offset[i];
        }
        for (int64_t e = 0; e < beam->lamp; e++) add_light(beam, e, index, point, &light, &open);
        for (int k = 0; k < used; k++) {
            int64_t cell = (first + k) / samples;
            beam->light[cell] += light[k] / (float)samples;
            beam->open[cell] += open[k] / (float)samples;
        }
    }
    return beam->count;
}

int64_t NAMED(lamp_fluence, VARIANT)(const LampFluence *data) {
    for (int64_t first = 0; first < data->points; first += LANES) {
        Doubles point[3];
        Floats fluence = in_all(0.0f), most = in_all(0.0f);
        FOR_LANES(n) {
            const double *at = data->positions + 3 * least_int(first + n, data->points - 1);
            for (int k = 0; k < 3; k++) point[k][n] = at[k];
        }
        for (int64_t e = 0; e < data->lamp; e++) {
            fluence += emitter_fluences(data->emitters + e, point);
            most += brightest_of(data->emitters + e, point);
        }
        for (int n = 0; n < LANES && first + n < data->points; n++) {
            data->fluence[first + n] = (double)fluence[n];
            data->brightest[first + n] = (double)most[n];
        }
    }
    return data->points;
}
