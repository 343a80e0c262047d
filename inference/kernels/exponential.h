/* SPDX-License-Identifier: GPL-3.0-or-later */
/* exp(-x) and 1 - exp(-x) in single precision, written so that compilers vectorise loops over them.

One source for every processor: without contraction the same operations give the same bits whatever their width. */

#ifndef MRPNN_EXPONENTIAL_H
#define MRPNN_EXPONENTIAL_H

#include <stdint.h>
#include <string.h>

/* The largest argument: exp(-x) is the smallest normal number there. */
#define MAX_EXPONENT 87.0f
/* Adding and subtracting it rounds to whole numbers. */
#define ROUNDING 12582912.0f

/* Finite for every x, also for NaN: low where x is not above it. */
static inline float clamped(float x, float low, float high) {
    float raised = x > low ? x : low;
    return raised < high ? raised : high;
}

/* -x = n log 2 + r with |r| <= log(2) / 2: returns 2^n, and expm1(r) in *rest. */
static inline float power_and_rest(float x, float *rest) {
    float whole = x * -1.44269504088896341f + ROUNDING - ROUNDING;
    /* log 2 in two parts, the first of which has few enough digits for exact products. */
    float r = (-x - whole * 0.693359375f) - whole * -2.12194440e-4f;
    float p = 1.9875691500e-4f;
    p = p * r + 1.3981999507e-3f;
    p = p * r + 8.3334519073e-3f;
    p = p * r + 4.1665795894e-2f;
    p = p * r + 1.6666665459e-1f;
    p = p * r + 5.0000001201e-1f;
    *rest = p * (r * r) + r;
    int32_t bits = (int32_t)((uint32_t)((int32_t)whole + 127) << 23);
    float power;
    memcpy(&power, &bits, sizeof power);
    return power;
}

/* exp(-x) for x >= 0; 0 beyond the range of normal numbers. */
static inline float exp_minus(float x) {
    float rest, power = power_and_rest(clamped(x, 0.0f, MAX_EXPONENT), &rest);
    float value = power * rest + power;
    return x < MAX_EXPONENT ? value : 0.0f;
}

/* 1 - exp(-x) for x >= 0, accurate for small x as well. */
static inline float one_minus_exp(float x) {
    float rest, power = power_and_rest(clamped(x, 0.0f, 60.0f), &rest);
    return (1.0f - power) - power * rest;
}

/* Mean of exp(-tau) over a step along which tau varies linearly between two values >= 0. */
static inline float mean_transmittance(float start, float end) {
    float low = start < end ? start : end, x = start < end ? end - start : start - end;
    x = x > 1e-20f ? x : 1e-20f;
    return exp_minus(low) * one_minus_exp(x) / x;
}

#endif
