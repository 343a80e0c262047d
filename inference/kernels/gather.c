/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Light that points receive along rays around the camera ray; the twin is features/final_gather.py. */

#include "exponential.h"
#include "fields.h"
#include "sampling.h"
#include "variants.h"

static inline Floats larger_of(Floats a, Floats b) { return choose(a > b, a, b); }

/* Gather along LANES rays from one point; direction: of each, in the cube's frame. */
static inline void gather_rays(const LightGather *gather, const float *position, const Floats *direction, float *out) {
    const float sigma = (float)gather->sigma, scale = (float)gather->scale, thickness = (float)gather->thickness;
    const float growth = (float)gather->growth, flux = (float)gather->flux;
    const float cells = (float)gather->density.shape[0], coarse = (float)gather->light[0].shape[0];
    Floats distance = in_all(0.0f), tau = in_all(0.0f), single = in_all(0.0f), reduced = in_all(0.0f);
    Floats scattered = in_all(0.0f), at[3], step;
    for (int axis = 0; axis < 3; axis++) at[axis] = in_all((position[axis] + 0.5f) * cells - 0.5f);
    Floats extinction = sample_grid(&gather->density, at) * sigma;
    step = least_of(in_all(1.0f / cells), thickness / larger_of(extinction, in_all(1e-6f)));
    for (int64_t n = 0; n < gather->steps; n++) {
        Floats place[3], flow = in_all(0.0f), passed, lost, dimmed, kept;
        Floats middle = distance + 0.5f * step;
        for (int axis = 0; axis < 3; axis++) {
            place[axis] = position[axis] + 0.5f + middle * direction[axis];
            at[axis] = place[axis] * cells - 0.5f;
        }
        extinction = sample_grid(&gather->density, at) * sigma;
        Floats gained = extinction * step;
        Floats sun = larger_of(sample_grid(&gather->depth, at) * sigma, in_all(0.0f));
        for (int axis = 0; axis < 3; axis++) at[axis] = place[axis] * coarse - 0.5f;
        Floats fluence = sample_grid(&gather->light[0], at);
        for (int axis = 0; axis < 3; axis++) flow += sample_grid(&gather->light[1 + axis], at) * direction[axis];
        Floats source = larger_of(fluence - flux * flow, 0.02f * fluence);
        passed = exp_minus(tau, &kept);
        exp_minus(gained, &lost);
        passed *= lost;
        single += passed * transmittance(sun);
        scattered += passed * source;
        exp_minus(scale * gained, &dimmed);
        reduced += transmittance(scale * (tau + sun)) * dimmed;
        tau += gained;
        distance += step;
        Floats thin = thickness * (1.0f + tau) / larger_of(extinction, in_all(1e-6f));
        step = least_of(step * growth, larger_of(thin, step / growth));
    }
    Floats open = transmittance(tau);
    FOR_LANES(n) {
        float *to = out + 4 * n;
        to[0] = single[n], to[1] = reduced[n], to[2] = scattered[n], to[3] = open[n];
    }
}

int64_t NAMED(gather_light, VARIANT)(const LightGather *gather) {
    for (int64_t p = 0; p < gather->points; p++) {
        const float *frame = gather->frames + 9 * p;
        for (int64_t r = 0; r < gather->rays; r += LANES) {
            Floats local[3], direction[3];
            for (int axis = 0; axis < 3; axis++) local[axis] = load(gather->directions + axis * gather->rays + r);
            for (int axis = 0; axis < 3; axis++) {
                const float *row = frame + 3 * axis;
                direction[axis] = local[0] * row[0] + local[1] * row[1] + local[2] * row[2];
            }
            gather_rays(gather, gather->positions + 3 * p, direction, gather->out + 4 * (p * gather->rays + r));
        }
    }
    return gather->points;
}
