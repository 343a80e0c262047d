/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Light that arrives at cells along one direction. */

#include "exponential.h"
#include "fields.h"
#include "variants.h"

/* Copy a slice into the middle of a plane with a border of zeros. */
static void bordered(const float *slice, const LightAhead *sweep, int64_t row, float *plane) {
    for (int64_t i = 0; i < sweep->shape[1]; i++) {
        const float *from = slice + i * sweep->strides[1];
        float *to = plane + (i + 1) * row + 1;
        for (int64_t c = 0; c < sweep->shape[2]; c++) to[c] = from[c * sweep->strides[2]];
    }
}

/* A plane at rays, which lie before its cells: weights of the cells before along both axes, along one, and of none. */
static inline Floats at_rays(const float *plane, int64_t row, const float *weights) {
    Floats last = load(plane) * weights[0] + load(plane + 1) * weights[1];
    return last + (load(plane + row) * weights[2] + load(plane + row + 1) * weights[3]);
}

/* Values of rays at cells, which lie behind them; weights as above, of the rays behind. */
static void at_cells(const float *rays, int64_t row, const float *weights, const LightAhead *sweep, float *slice) {
    for (int64_t i = 0; i < sweep->shape[1]; i++) {
        const float *here = rays + i * row, *behind = here + row;
        float *to = slice + i * sweep->strides[1];
        for (int64_t c = 0; c < sweep->shape[2]; c++) {
            float next = behind[c + 1] * weights[0] + behind[c] * weights[1];
            to[c * sweep->strides[2]] = next + (here[c + 1] * weights[2] + here[c] * weights[3]);
        }
    }
}

/* Follow a row of rays through half a cell, to its middle, and through the other half. */
static inline void follow(const LightAhead *sweep, const float *plane, int64_t row, const float *weights, float *ray,
                          float *middle) {
    int64_t area = (sweep->shape[1] + 2) * row, plane_of_rays = sweep->size[0] * sweep->size[1];
    for (int64_t c = 0; c + LANES <= row; c += LANES) {
        Floats half = at_rays(plane + c, row, weights) * (float)sweep->half_step;
        for (int64_t a = 0; a < sweep->scales; a++) {
            Floats passed = transmittance(half * sweep->scale[a]);
            for (int64_t k = 0; k < sweep->sources; k++) {
                Floats source = at_rays(plane + (k + 1) * area + c, row, weights);
                float *light = ray + (k * sweep->scales + a) * plane_of_rays + c;
                Floats found = (load(light) - source) * passed;
                store(middle + (k * sweep->scales + a) * area + c, found + source);
                store(light, found * passed + source);
            }
            if (a > 0) continue;
            float *clear = ray + sweep->sources * sweep->scales * plane_of_rays + c;
            Floats found = load(clear) * passed;
            store(middle + sweep->sources * sweep->scales * area + c, found);
            store(clear, found * passed);
        }
    }
}

int64_t NAMED(sweep_ahead, VARIANT)(const LightAhead *sweep) {
    int64_t row = sweep->row, area = (sweep->shape[1] + 2) * row, sums = sweep->sources * sweep->scales + 1;
    float *planes = sweep->scratch, *middles = planes + (sweep->sources + 1) * area;
    for (int64_t n = 0; n < sweep->shape[0]; n++) {
        int64_t k = sweep->sign > 0 ? sweep->shape[0] - 1 - n : n;
        float f = sweep->fractions[2 * k], g = sweep->fractions[2 * k + 1];
        float weights[4] = {f * g, f * (1.0f - g), (1.0f - f) * g, (1.0f - f) * (1.0f - g)};
        bordered(sweep->extinction + k * sweep->strides[0], sweep, row, planes);
        for (int64_t s = 0; s < sweep->sources; s++) {
            bordered(sweep->light + s * sweep->cells + k * sweep->strides[0], sweep, row, planes + (s + 1) * area);
        }
        for (int64_t i = 0; i <= sweep->shape[1]; i++) {
            float *ray = sweep->rays + (sweep->starts[2 * k] + i) * sweep->size[1] + sweep->starts[2 * k + 1];
            follow(sweep, planes + i * row, row, weights, ray, middles + i * row);
        }
        for (int64_t s = 0; s < sums; s++) {
            at_cells(middles + s * area, row, weights, sweep, sweep->ahead + s * sweep->cells + k * sweep->strides[0]);
        }
    }
    return sweep->shape[0];
}
