/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Optical depths around lamps, and their light in cells; the twins are grids/lamp_optical_depth.py and
transport/lamp_beam.py. */

#include "fields.h"
#include "lamp_sampling.h"
#include "variants.h"

int64_t NAMED(fill_lamp_columns, VARIANT)(const LampSlices *data) {
    const LampColumns *lamp = data->columns;
    const Pyramid *pyramid = lamp->pyramids + data->pyramid;
    int axis = (int)(data->pyramid / 2), others[2] = {axis == 0 ? 1 : 0, axis == 2 ? 1 : 2};
    float sign = data->pyramid % 2 ? -1.0f : 1.0f;
    int64_t rows = pyramid->size[0], width = pyramid->size[1];
    for (int64_t slice = data->begin; slice < data->end; slice++) {
        const float *before = pyramid->depths + (slice - 1) * rows * width;
        float *out = pyramid->depths + slice * rows * width;
        double start = pyramid->starts[slice - 1];
        double step = (pyramid->starts[slice] - start) / (double)data->parts;
        for (int64_t row = 0; row < rows; row++) {
            float across = (float)(pyramid->first[0] + pyramid->spacing[0] * (double)row);
            for (int64_t column = 0; column < width; column += LANES) {
                Floats slope, total = in_all(0.0f);
                int used = width - column < LANES ? (int)(width - column) : LANES;
                FOR_LANES(n) slope[n] = (float)(pyramid->first[1] + pyramid->spacing[1] * (double)(column + n));
                for (int64_t part = 0; part < data->parts; part++) {
                    for (int node = 0; node < 2; node++) {
                        float along = (float)(start + step * ((double)part + (double)GAUSS_NODES[node]));
                        Floats place[3];
                        place[axis] = in_all((float)lamp->lamp[axis] + along * sign);
                        place[others[0]] = in_all((float)lamp->lamp[others[0]] + along * across);
                        place[others[1]] = (float)lamp->lamp[others[1]] + along * slope;
                        total = total + sample_grid(&lamp->density, place);
                    }
                }
                total = total * (float)(0.5 * step);
                for (int n = 0; n < used; n++) {
                    out[row * width + column + n] = before[row * width + column + n] + total[n];
                }
            }
        }
    }
    return data->end - data->begin;
}

int64_t NAMED(lamp_depths, VARIANT)(const LampDepths *data) {
    for (int64_t point = 0; point < data->points; point += LANES) {
        int used = data->points - point < LANES ? (int)(data->points - point) : LANES;
        Floats index[3];
        for (int axis = 0; axis < 3; axis++) {
            const float *from = data->index + axis * data->points + point;
            FOR_LANES(n) index[axis][n] = from[n < used ? n : used - 1];
        }
        Floats found = lamp_depth(data->columns, index, (float)data->sigma_t);
        for (int n = 0; n < used; n++) data->out[point + n] = found[n];
    }
    return data->points;
}

/* Light at a place among the cells, without what lies in between, and the mean length of its paths over the distance. */
static double light_at(const LampBeam *beam, const double *place, float *slant) {
    double point[3];
    for (int i = 0; i < 3; i++) point[i] = dot_of(beam->world + 3 * i, place) + beam->offset[i];
    *slant = (float)emitter_slant(beam->emitter, point);
    double found = softened(emitter_fluence(beam->emitter, point), beam->radius);
    return beam->shadow_map ? found * lamp_visibility(beam->shadow_map, point) : found;
}

int64_t NAMED(lamp_beam, VARIANT)(const LampBeam *beam) {
    int64_t parts = beam->parts, samples = parts * parts * parts, n = beam->cells, all = beam->count * samples;
    for (int64_t first = 0; first < all; first += LANES) {
        int used = all - first < LANES ? (int)(all - first) : LANES;
        Floats index[3], slant;
        double light[LANES];
        FOR_LANES(k) {
            int64_t sample = first + (k < used ? k : used - 1), number = beam->numbers[sample / samples];
            int64_t cell[3] = {number / (n * n), number / n % n, number % n}, part = sample % samples;
            double place[3];
            for (int axis = 2; axis >= 0; axis--) {
                place[axis] = (double)cell[axis] + ((double)(part % parts) + 0.5) / (double)parts - 0.5;
                index[axis][k] = (float)place[axis];
                part /= parts;
            }
            float factor;
            light[k] = light_at(beam, place, &factor);
            slant[k] = factor;
        }
        Floats passed = transmittance(lamp_depth(beam->columns, index, (float)beam->sigma) * slant);
        for (int k = 0; k < used; k++) {
            beam->light[beam->numbers[(first + k) / samples]] += light[k] * (double)passed[k] / (double)samples;
        }
    }
    return beam->count;
}
