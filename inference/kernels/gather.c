/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Light that points receive along rays around the camera ray; the twin is features/final_gather.py. */

#include "exponential.h"
#include "fields.h"
#include "sampling.h"
#include "variants.h"

static inline Floats larger_of(Floats a, Floats b) { return choose(a > b, a, b); }

/* Cells below places, counted from the first, behind the padding, and the places within them. */
static inline void cells_below(const Floats *place, int64_t size, Ints *cell, Floats *part) {
    for (int axis = 0; axis < 3; axis++) {
        Floats at = clamped_to(place[axis] + 0.5f, in_all(0.0f), in_all((float)(size - 2)));
        cell[axis] = to_ints(at);
        part[axis] = at - to_floats(cell[axis]);
    }
}

/* Fractions for both floats of each pair. */
static inline PairsOfFloats twice(Floats x) {
    return __builtin_shufflevector(x, x, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5, 6, 6, 7, 7);
}

static inline PairsOfFloats between(Pairs low, Pairs high, PairsOfFloats part) {
    PairsOfFloats from = (PairsOfFloats)low;
    return ((PairsOfFloats)high - from) * part + from;
}

/* Density and depth, trilinear; place: in cells. */
static inline Pairs sample_media_pairs(const LightGather *gather, const Floats *place) {
    int64_t n = gather->edge, first[LANES];
    Ints cell[3];
    Floats part[3];
    cells_below(place, n, cell, part);
    Longs at = to_longs((cell[0] * (int32_t)n + cell[1]) * (int32_t)n + cell[2]) * 2;
    memcpy(first, &at, sizeof first);
    Pairs corner[8];
    FOR_LANES(lane) {
        const float *from = gather->media + first[lane];
        for (int k = 0; k < 8; k++) {
            corner[k][lane] = pair_at(from + 2 * ((k >> 2) * n * n + (k >> 1 & 1) * n + (k & 1)));
        }
    }
    PairsOfFloats x = twice(part[0]), y = twice(part[1]), z = twice(part[2]);
    Pairs rows[4];
    for (int k = 0; k < 4; k++) rows[k] = (Pairs)between(corner[2 * k], corner[2 * k + 1], z);
    return (Pairs)between((Pairs)between(rows[0], rows[1], y), (Pairs)between(rows[2], rows[3], y), x);
}

/* Light scattered against directions, of the nearest cells; place: in cells. */
static inline Floats sample_source(const LightGather *gather, const Floats *place, const Floats *direction) {
    int64_t n = gather->light_edge;
    Ints cell = {0};
    Floats fluence, source;
    for (int axis = 0; axis < 3; axis++) {
        Ints along = to_ints(clamped_to(place[axis], in_all(0.0f), in_all((float)(n - 1))));
        cell = cell * (int32_t)n + along;
    }
    float flux = (float)gather->flux;
    FOR_LANES(lane) {
        const float *at = gather->light + 4 * (int64_t)cell[lane];
        fluence[lane] = at[0];
        source[lane] = at[1] * direction[0][lane] + at[2] * direction[1][lane] + at[3] * direction[2][lane];
    }
    return larger_of(fluence - flux * source, 0.02f * fluence);
}

/* Gather along LANES rays from one point; direction: of each, in the cube's frame. */
static inline void gather_rays(const LightGather *gather, const float *position, const Floats *direction,
                               const Floats *shift, float *out) {
    const float sigma = (float)gather->sigma, scale = (float)gather->scale, thickness = (float)gather->thickness;
    const float growth = (float)gather->growth;
    const float cells = (float)(gather->edge - 3), coarse = (float)gather->light_edge;
    Floats distance = in_all(0.0f), tau = in_all(0.0f), single = in_all(0.0f), reduced = in_all(0.0f);
    Floats scattered = in_all(0.0f), at[3], step;
    for (int axis = 0; axis < 3; axis++) at[axis] = in_all((position[axis] + 0.5f) * cells);
    Floats extinction = first_of(sample_media_pairs(gather, at)) * sigma;
    step = least_of(in_all(1.0f / cells), thickness / larger_of(extinction, in_all(1e-6f)));
    for (int64_t n = 0; n < gather->steps; n++) {
        Floats place[3], lost, dimmed, kept;
        Floats middle = distance + 0.5f * step;
        Ints open = tau < 16.0f;
        for (int axis = 0; axis < 3; axis++) {
            place[axis] = position[axis] + 0.5f + middle * direction[axis];
            at[axis] = place[axis] * cells;
            open &= (place[axis] > -0.1f) & (place[axis] < 1.1f);
        }
        if (!any_lane(open)) break;
        Pairs media = sample_media_pairs(gather, at);
        extinction = first_of(media) * sigma;
        Floats gained = extinction * step, sun = larger_of(second_of(media) * sigma, in_all(0.0f));
        for (int axis = 0; axis < 3; axis++) at[axis] = place[axis] * coarse + shift[axis];
        Floats passed = exp_minus(tau, &kept);
        exp_minus(gained, &lost);
        passed *= lost;
        single += passed * transmittance(sun);
        scattered += passed * sample_source(gather, at, direction);
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
            Floats local[3], direction[3], shift[3];
            for (int axis = 0; axis < 3; axis++) local[axis] = load(gather->directions + axis * gather->rays + r);
            for (int axis = 0; axis < 3; axis++) shift[axis] = load(gather->shifts + axis * gather->rays + r);
            for (int axis = 0; axis < 3; axis++) {
                const float *row = frame + 3 * axis;
                direction[axis] = local[0] * row[0] + local[1] * row[1] + local[2] * row[2];
            }
            gather_rays(gather, gather->positions + 3 * p, direction, shift,
                        gather->out + 4 * (p * gather->rays + r));
        }
    }
    return gather->points;
}
