/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Eight numbers at a time, in the vectors that gcc and clang add to C; processors with narrower registers take several.

Each lane is computed by the operations that one number alone would take, so that widths give the same bits. */

#ifndef MRPNN_LANES_H
#define MRPNN_LANES_H

#include <stdint.h>
#include <string.h>

#define LANES 8

typedef float Floats __attribute__((vector_size(4 * LANES)));
typedef int32_t Ints __attribute__((vector_size(4 * LANES)));
typedef int64_t Longs __attribute__((vector_size(8 * LANES)));
typedef double Doubles __attribute__((vector_size(8 * LANES)));
/* Two neighbouring floats per lane, moved as if they were one double. */
typedef double Pairs __attribute__((vector_size(8 * LANES)));
typedef float PairsOfFloats __attribute__((vector_size(8 * LANES)));

#define FOR_LANES(n) for (int n = 0; n < LANES; n++)

static inline Floats in_all(float value) { return value - (Floats){0.0f}; }

static inline Floats load(const float *from) {
    Floats values;
    memcpy(&values, from, sizeof values);
    return values;
}

static inline void store(float *to, Floats values) { memcpy(to, &values, sizeof values); }

static inline Ints to_ints(Floats x) { return __builtin_convertvector(x, Ints); }

static inline Floats to_floats(Ints n) { return __builtin_convertvector(n, Floats); }

static inline Longs to_longs(Ints n) { return __builtin_convertvector(n, Longs); }

/* a where the mask is all ones, b where it is 0. */
static inline Floats choose(Ints mask, Floats a, Floats b) {
    return (Floats)((mask & (Ints)a) | (~mask & (Ints)b));
}

static inline Ints choose_int(Ints mask, Ints a, Ints b) { return (mask & a) | (~mask & b); }

static inline int any_lane(Ints mask) {
    int32_t found = 0;
    FOR_LANES(n) found |= mask[n];
    return found != 0;
}

static inline Floats least_of(Floats a, Floats b) { return choose(a < b, a, b); }

/* Finite for every x, also for NaN: low where x is not above it. */
static inline Floats clamped_to(Floats x, Floats low, Floats high) {
    Floats raised = choose(x > low, x, low);
    return choose(raised < high, raised, high);
}

static inline Ints ints_within(Ints x, int32_t last) {
    Ints raised = choose_int(x > 0, x, (Ints){0});
    return choose_int(raised < last, raised, last - (Ints){0});
}

/* The largest whole numbers that are not above x, for |x| within the range of 32 bits. */
static inline Ints floors(Floats x) {
    Ints n = to_ints(x);
    return n + (to_floats(n) > x);
}

static inline Floats lerp_lanes(Floats low, Floats high, Floats fraction) { return (high - low) * fraction + low; }

static inline Floats first_of(Pairs pairs) {
    PairsOfFloats both = (PairsOfFloats)pairs;
    return __builtin_shufflevector(both, both, 0, 2, 4, 6, 8, 10, 12, 14);
}

static inline Floats second_of(Pairs pairs) {
    PairsOfFloats both = (PairsOfFloats)pairs;
    return __builtin_shufflevector(both, both, 1, 3, 5, 7, 9, 11, 13, 15);
}

/* Interpolate between the two floats of each pair. */
static inline Floats lerp_pairs(Pairs pairs, Floats fraction) {
    return lerp_lanes(first_of(pairs), second_of(pairs), fraction);
}

static inline double pair_at(const float *values) {
    double pair;
    memcpy(&pair, values, sizeof pair);
    return pair;
}

#endif
