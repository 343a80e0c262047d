/* SPDX-License-Identifier: GPL-3.0-or-later */
/* exp(-x) and 1 - exp(-x) in single precision.

Written in operations that every processor rounds alike, so that the same numbers give the same bits everywhere. */

#ifndef MRPNN_EXPONENTIAL_H
#define MRPNN_EXPONENTIAL_H

#include "lanes.h"

/* The largest argument: exp(-x) is the smallest normal number there. */
#define MAX_EXPONENT 87.0f
/* Adding and subtracting it rounds to whole numbers. */
#define ROUNDING 12582912.0f

/* exp(-x) for x >= 0, 0 beyond the range of normal numbers; and 1 - exp(-x), accurate for small x as well. */
static inline Floats exp_minus(Floats x, Floats *one_minus) {
    Floats least = clamped_to(x, in_all(0.0f), in_all(MAX_EXPONENT));
    /* -x = n log 2 + r with |r| <= log(2) / 2. */
    Floats whole = least * -1.44269504088896341f + ROUNDING - ROUNDING;
    /* log 2 in two parts, the first of which has few enough digits for exact products. */
    Floats r = (-least - whole * 0.693359375f) - whole * -2.12194440e-4f;
    Floats p = in_all(1.9875691500e-4f);
    p = p * r + 1.3981999507e-3f;
    p = p * r + 8.3334519073e-3f;
    p = p * r + 4.1665795894e-2f;
    p = p * r + 1.6666665459e-1f;
    p = p * r + 5.0000001201e-1f;
    /* expm1(r) and 2^n. */
    Floats rest = p * (r * r) + r, power = (Floats)((to_ints(whole) + 127) << 23);
    *one_minus = (1.0f - power) - power * rest;
    return choose(x < MAX_EXPONENT, power * rest + power, in_all(0.0f));
}

/* exp(-x) for x >= 0. */
static inline Floats transmittance(Floats x) {
    Floats one_minus;
    return exp_minus(x, &one_minus);
}

/* Means of exp(-tau) over steps along which tau varies linearly between two values >= 0. */
static inline Floats mean_transmittance(Floats start, Floats end) {
    Ints rising = start < end;
    Floats low = choose(rising, start, end), x = choose(rising, end - start, start - end), lost;
    x = choose(x > 1e-20f, x, in_all(1e-20f));
    exp_minus(x, &lost);
    return transmittance(low) * lost / x;
}

#endif
