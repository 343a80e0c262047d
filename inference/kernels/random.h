/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Random numbers and directions of paths and photons. */

#ifndef MRPNN_RANDOM_H
#define MRPNN_RANDOM_H

#include <math.h>
#include <stdint.h>

static inline uint64_t mixed(uint64_t x) {
    x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9u;
    x = (x ^ (x >> 27)) * 0x94D049BB133111EBu;
    return x ^ (x >> 31);
}

/* State of the generator of a path, from its number. */
static inline uint64_t seeded(uint64_t number) { return mixed((number + 1) * 0x9E3779B97F4A7C15u); }

static inline uint64_t draw_bits(uint64_t *state) {
    *state += 0x9E3779B97F4A7C15u;
    return mixed(*state);
}

/* A number in [0, 1). */
static inline double draw(uint64_t *state) { return (double)(draw_bits(state) >> 11) * 0x1p-53; }

/* Cosine of an angle of Henyey and Greenstein's phase function; u: in [0, 1). */
static inline double scattering_cosine(double g, double u) {
    if (!(fabs(g) > 1e-4)) return 1.0 - 2.0 * u;
    double root = (1.0 - g * g) / (1.0 - g + 2.0 * g * u);
    return (1.0 + g * g - root * root) / (2.0 * g);
}

/* Turn a unit vector by an angle of a cosine, about itself by another angle (Duff et al., "Building an Orthonormal Basis,
Revisited", 2017). */
static inline void turn(double cosine, double angle, double *along) {
    double rest = 1.0 - cosine * cosine, sine = rest > 0.0 ? sqrt(rest) : 0.0;
    double x = along[0], y = along[1], z = along[2], sign = z >= 0.0 ? 1.0 : -1.0;
    double a = -1.0 / (sign + z), b = x * y * a, p = sine * cos(angle), q = sine * sin(angle);
    along[0] = p * (1.0 + sign * x * x * a) + q * b + cosine * x;
    along[1] = p * (sign * b) + q * (sign + y * y * a) + cosine * y;
    along[2] = p * (-sign * x) - q * y + cosine * z;
}

#endif
