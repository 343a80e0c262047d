/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Photons that scatter within the forward peak: inference/source_terms/peak_photons.py explains them. */

#include <math.h>

#include "fields.h"
#include "random.h"
#include "variants.h"

#define SUMS 5

/* x^(3/2) */
static double power_of_three_halves(double x) { return x * sqrt(x); }

/* Turn a photon; returns whether by a small angle. */
static int scatter(const PeakPhotons *data, uint64_t *state, double *along) {
    double g = data->anisotropy, reduced = data->reduced;
    double u = draw(state), angle = 6.283185307179586 * draw(state);
    double cosine = scattering_cosine(g, u);
    double total = (1.0 - g * g) / power_of_three_halves(1.0 + g * g - 2.0 * g * cosine);
    double wide = data->wide * (1.0 - reduced * reduced) / power_of_three_halves(1.0 + reduced * reduced - 2.0 * reduced * cosine);
    if (draw(state) * total < wide) return 0;
    turn(cosine, angle, along);
    return 1;
}

/* Turn a direction that points out of the cone to its edge: spot_cone.SpotCone.turned. */
static void into_cone(const PeakPhotons *data, double *along) {
    double level = 0.0, square = 0.0, aside[3];
    for (int k = 0; k < 3; k++) level += along[k] * data->axis[k];
    if (!(level < data->cosine)) return;
    for (int k = 0; k < 3; k++) aside[k] = along[k] - level * data->axis[k], square += aside[k] * aside[k];
    double tilt = sqrt(square) > 1e-30 ? sqrt(square) : 1e-30, sine = sqrt(1.0 - data->cosine * data->cosine);
    for (int k = 0; k < 3; k++) along[k] = data->cosine * data->axis[k] + sine * aside[k] / tilt;
}

/* Fly to the next collision; returns whether there is one. */
static int fly(const PeakPhotons *data, double left, const double *along, double *point, int64_t *cell, double weight) {
    const int64_t *shape = data->shape, strides[3] = {shape[1] * shape[2], shape[2], 1};
    int64_t cells = shape[0] * strides[0], up[3], at = 0, axis = -1;
    double inverse[3], turned[3], x[3], distance, rate;
    for (int k = 0; k < 3; k++) {
        up[k] = along[k] > 0.0, turned[k] = along[k], x[k] = point[k], at += cell[k] * strides[k];
        inverse[k] = fabs(along[k]) > 1e-12 ? 1.0 / along[k] : 0.0;
    }
    for (;;) {
        distance = INFINITY, axis = -1, rate = data->depth[at];
        for (int k = 0; k < 3; k++) {
            double to = ((double)(cell[k] + up[k]) - x[k]) * inverse[k];
            if (inverse[k] != 0.0 && to < distance) distance = to, axis = k;
        }
        if (axis < 0) return 0;
        distance = distance > 0.0 ? distance : 0.0;
        int collides = rate * distance >= left;
        if (collides) distance = left / rate;
        double added = weight * distance;
        float *sums = data->sums + SUMS * at;
        sums[0] += (float)added;
        for (int k = 0; k < 3; k++) sums[1 + k] += (float)(added * turned[k]), x[k] += turned[k] * distance;
        sums[4] += (float)(added * added);
        if (collides) break;
        left -= rate * distance;
        int64_t lower = up[axis] ? at : at - strides[axis];
        if (data->closed && (up[axis] || cell[axis] > 0) && data->closed[axis * cells + lower]) return 0;
        cell[axis] += up[axis] ? 1 : -1, at += up[axis] ? strides[axis] : -strides[axis];
        if (cell[axis] < 0 || cell[axis] >= shape[axis]) return 0;
    }
    for (int k = 0; k < 3; k++) point[k] = x[k];
    return 1;
}

int64_t NAMED(follow_peak, VARIANT)(const PeakPhotons *data) {
    const int64_t *shape = data->shape;
    for (int64_t n = 0; n < data->photons; n++) {
        uint64_t state = seeded((uint64_t)data->numbers[n]);
        int64_t start = data->starts[n], cell[3] = {start / (shape[1] * shape[2]), start / shape[2] % shape[1], start % shape[2]};
        double point[3], along[3], square = 0.0, weight = 1.0;
        for (int k = 0; k < 3; k++) {
            point[k] = (double)cell[k] + draw(&state), along[k] = point[k] - data->lamp[k];
            square += along[k] * along[k];
        }
        double length = sqrt(square) > 1e-30 ? sqrt(square) : 1e-30;
        for (int k = 0; k < 3; k++) along[k] /= length;
        into_cone(data, along);
        for (int64_t c = 0; c < data->collisions && scatter(data, &state, along); c++) {
            double left = -log(1.0 - draw(&state));
            if (!fly(data, left, along, point, cell, weight)) break;
            weight *= data->albedo;
        }
    }
    return data->photons;
}
