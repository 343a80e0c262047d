/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Light that points receive along rays around the camera ray. */

#include "exponential.h"
#include "fields.h"
#include "sampling.h"
#include "variants.h"

static inline Floats larger_of(Floats a, Floats b) { return choose(a > b, a, b); }

/* Cells below positions, counted behind the padding, and the fractions of the way to the next cells. */
static inline void cells_below(const Floats *position, int64_t size, Ints *cell, Floats *fraction) {
    for (int axis = 0; axis < 3; axis++) {
        Floats at = clamped_to(position[axis] + 0.5f, in_all(0.0f), in_all((float)(size - 2)));
        cell[axis] = to_ints(at);
        fraction[axis] = at - to_floats(cell[axis]);
    }
}

/* Four floats in a row for each of four lanes. */
typedef float Quads __attribute__((vector_size(4 * 4 * LANES / 2)));

static inline Quads quads_at(const float *from, const int64_t *first) {
    Quads quads;
    for (int lane = 0; lane < LANES / 2; lane++) {
        memcpy((char *)&quads + lane * 4 * sizeof(float), from + first[lane], 4 * sizeof(float));
    }
    return quads;
}

static inline Quads between(Quads low, Quads high, Quads fraction) { return (high - low) * fraction + low; }

/* Density and depth of four lanes, of two cells beside each other, interpolated between the rows of cells. */
static inline Quads between_rows(const LightGather *gather, const int64_t *first, Quads x, Quads y) {
    int64_t n = 2 * gather->edge;
    const float *from = gather->media;
    Quads low = between(quads_at(from, first), quads_at(from + n, first), y);
    from += n * gather->edge;
    return between(low, between(quads_at(from, first), quads_at(from + n, first), y), x);
}

/* Density and depth, trilinear; position: in cells. */
static inline Pairs sample_media_pairs(const LightGather *gather, const Floats *position) {
    int64_t n = gather->edge, first[LANES];
    Ints cell[3];
    Floats x, y, z, fraction[3];
    cells_below(position, n, cell, fraction);
    Longs at = to_longs((cell[0] * (int32_t)n + cell[1]) * (int32_t)n + cell[2]) * 2;
    memcpy(first, &at, sizeof first);
    x = fraction[0], y = fraction[1], z = fraction[2];
#define FOUR_TIMES(v, k) __builtin_shufflevector(v, v, k, k, k, k, k + 1, k + 1, k + 1, k + 1, k + 2, k + 2, k + 2, k + 2, \
                                                 k + 3, k + 3, k + 3, k + 3)
    Quads fore = between_rows(gather, first, FOUR_TIMES(x, 0), FOUR_TIMES(y, 0));
    Quads rear = between_rows(gather, first + LANES / 2, FOUR_TIMES(x, 4), FOUR_TIMES(y, 4));
#undef FOUR_TIMES
    PairsOfFloats low = __builtin_shufflevector(fore, rear, 0, 1, 4, 5, 8, 9, 12, 13, 16, 17, 20, 21, 24, 25, 28, 29);
    PairsOfFloats high = __builtin_shufflevector(fore, rear, 2, 3, 6, 7, 10, 11, 14, 15, 18, 19, 22, 23, 26, 27, 30, 31);
    PairsOfFloats both = __builtin_shufflevector(z, z, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5, 6, 6, 7, 7);
    return (Pairs)((high - low) * both + low);
}

/* Light scattered against directions, of the nearest cells; position: in cells. */
static inline Floats sample_source(const LightGather *gather, const Floats *position, const Floats *direction) {
    int64_t n = gather->light_edge, first[LANES];
    Ints cell = {0};
    Pairs fluence_and_x, y_and_z;
    for (int axis = 0; axis < 3; axis++) {
        Ints along = to_ints(clamped_to(position[axis], in_all(0.0f), in_all((float)(n - 1))));
        cell = cell * (int32_t)n + along;
    }
    Longs at = to_longs(cell) * 4;
    memcpy(first, &at, sizeof first);
    FOR_LANES(lane) {
        const float *from = gather->light + first[lane];
        fluence_and_x[lane] = pair_at(from);
        y_and_z[lane] = pair_at(from + 2);
    }
    Floats fluence = first_of(fluence_and_x);
    Floats against = second_of(fluence_and_x) * direction[0] + first_of(y_and_z) * direction[1];
    against = fluence - (against + second_of(y_and_z) * direction[2]) * (float)gather->flux;
    return larger_of(against, 0.02f * fluence);
}

/* 1 - (1 - x)^3 */
static inline Floats cubed_rest(Floats x) { return x * (3.0f - x * (3.0f - x)); }

/* Gather along LANES rays from one point; direction: of each, in the cube's frame.

Exponentials are taken of a third of optical depths, which `reduced` needs, and cubed. */
static inline void gather_rays(const LightGather *gather, const float *position, const Floats *direction,
                               const Floats *shift, float *out) {
    const float sigma = (float)gather->sigma, thickness = (float)gather->thickness;
    const float growth = (float)gather->growth, shrinkage = 1.0f / growth, third = 1.0f / 3.0f;
    const float cells = (float)(gather->edge - 3), coarse = (float)gather->light_edge;
    Floats distance = in_all(0.0f), tau = in_all(0.0f), single = in_all(0.0f), reduced = in_all(0.0f);
    Floats scattered = in_all(0.0f), open = in_all(1.0f), at[3], step;
    for (int axis = 0; axis < 3; axis++) at[axis] = in_all((position[axis] + 0.5f) * cells);
    Floats extinction = first_of(sample_media_pairs(gather, at)) * sigma;
    step = least_of(in_all(1.0f / cells), thickness / larger_of(extinction, in_all(1e-6f)));
    for (int64_t n = 0; n < gather->steps; n++) {
        Floats point[3], lost;
        Floats middle = distance + 0.5f * step;
        Ints within = tau < 48.0f;
        for (int axis = 0; axis < 3; axis++) {
            point[axis] = position[axis] + 0.5f + middle * direction[axis];
            at[axis] = point[axis] * cells;
            within &= (point[axis] > -0.1f) & (point[axis] < 1.1f);
        }
        if (!any_lane(within)) break;
        Pairs media = sample_media_pairs(gather, at);
        extinction = first_of(media) * sigma;
        Floats gained = extinction * step, lit = transmittance(second_of(media) * (sigma * third));
        for (int axis = 0; axis < 3; axis++) at[axis] = point[axis] * coarse + shift[axis];
        Floats transmitted = exp_minus(gained * third, &lost);
        Floats passed = open * open * open * cubed_rest(lost);
        single += passed * (lit * lit * lit);
        scattered += passed * sample_source(gather, at, direction);
        reduced += open * lit * lost;
        open *= transmitted;
        tau += gained;
        distance += step;
        Floats thin = thickness * (1.0f + tau) / larger_of(extinction, in_all(1e-6f));
        step = least_of(step * growth, larger_of(thin, step * shrinkage));
    }
    open = open * open * open;
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
