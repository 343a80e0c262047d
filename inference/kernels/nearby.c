/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Light that lamps nearby scatter towards the camera: inference/network/lamp_nearby.py explains it. */

#include <math.h>

#include "exponential.h"
#include "fields.h"
#include "lamp_sampling.h"
#include "variants.h"

/* Degrees of the transport's moments, and their harmonics. */
#define DEGREES 4
#define HARMONICS (DEGREES * DEGREES)
/* With the fluence and the flux of light that has scattered within the forward peak alone. */
#define VALUES (HARMONICS + 4)
/* Places on the way from a lamp. */
#define MOST_PLACES 8

static const float SPHERE = 12.566370614f;

/* The harmonics of unit vectors, in the order of numerics/spherical_harmonics.py. */
static void harmonics(Floats x, Floats y, Floats z, Floats *out) {
    const float root3 = 1.7320508076f, root6 = 2.4494897428f, root10 = 3.1622776602f, root15 = 3.8729833462f;
    Floats xx = x * x, yy = y * y, zz = z * z;
    out[0] = in_all(1.0f);
    out[1] = x, out[2] = y, out[3] = z;
    out[4] = root3 * (x * y), out[5] = root3 * (y * z), out[6] = root3 * (z * x);
    out[7] = 0.5f * (3.0f * zz - 1.0f);
    out[8] = 0.5f * root3 * (xx - yy);
    out[9] = 0.25f * root10 * y * (3.0f * xx - yy);
    out[10] = root15 * x * y * z;
    out[11] = 0.25f * root6 * y * (5.0f * zz - 1.0f);
    out[12] = 0.5f * z * (5.0f * zz - 3.0f);
    out[13] = 0.25f * root6 * x * (5.0f * zz - 1.0f);
    out[14] = 0.5f * root15 * z * (xx - yy);
    out[15] = 0.25f * root10 * x * (xx - 3.0f * yy);
}

/* Moments by Legendre's polynomials along unit vectors, of those by harmonics. */
static void along(const Floats *moments, const Floats *direction, Floats *out) {
    Floats of[HARMONICS];
    harmonics(direction[0], direction[1], direction[2], of);
    for (int degree = 0, n = 0; degree < DEGREES; degree++) {
        out[degree] = in_all(0.0f);
        for (; n < (degree + 1) * (degree + 1); n++) out[degree] += moments[n] * of[n];
    }
}

static void legendre(Floats cosine, Floats *out) {
    Floats square = cosine * cosine;
    out[0] = in_all(1.0f), out[1] = cosine;
    out[2] = 1.5f * square - 0.5f, out[3] = cosine * (2.5f * square - 1.5f);
}

static Floats dot(const Floats *a, const Floats *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static Floats roots(Floats x) {
    Floats root;
    FOR_LANES(n) root[n] = sqrtf(x[n]);
    return root;
}

/* Henyey and Greenstein's phase function, 1/sr. */
static Floats henyey_greenstein(Floats cosine, Floats anisotropy) {
    Ints backwards = anisotropy < 0.0f;
    Floats g = choose(backwards, -anisotropy, anisotropy), turn = 1.0f - choose(backwards, -cosine, cosine);
    Floats square = (1.0f - g) * (1.0f - g) + 2.0f * g * choose(turn > 0.0f, turn, in_all(0.0f));
    return (1.0f - g * g) / (SPHERE * square * roots(square));
}

/* Numbers from `first` on; the last one is repeated behind the end. */
static Floats lanes_from(const float *from, int64_t first, int64_t points) {
    if (points - first >= LANES) return load(from + first);
    Floats lanes;
    FOR_LANES(n) lanes[n] = from[least_int(first + n, points - 1)];
    return lanes;
}

/* The transport's values, interpolated. */
static void values_at(const NearbyLight *data, int64_t first, Floats *out) {
    Floats most = in_all((float)data->edge - 1.0f - 1e-3f), index[3], inside[3];
    Ints cell[3];
    for (int k = 0; k < 3; k++) {
        index[k] = clamped_to(lanes_from(data->index + k * data->points, first, data->points), in_all(0.0f), most);
        cell[k] = to_ints(index[k]);
        inside[k] = index[k] - to_floats(cell[k]);
    }
    FOR_LANES(n) {
        const float *at = data->cells + VALUES * (((int64_t)cell[0][n] * data->edge + cell[1][n]) * data->edge + cell[2][n]);
        int64_t x = VALUES * data->edge * data->edge, y = VALUES * data->edge, z = VALUES;
        float fx = inside[0][n], fy = inside[1][n], fz = inside[2][n], values[VALUES];
        for (int k = 0; k < VALUES; k++) {
            float a = at[k] + fz * (at[k + z] - at[k]), b = at[k + y] + fz * (at[k + y + z] - at[k + y]);
            float c = at[k + x] + fz * (at[k + x + z] - at[k + x]);
            float d = at[k + x + y] + fz * (at[k + x + y + z] - at[k + x + y]);
            a += fy * (b - a), c += fy * (d - c);
            values[k] = (a + fx * (c - a)) * (float)data->scale;
        }
        for (int k = 0; k < VALUES; k++) out[k][n] = values[k];
    }
}

/* Means over the matter on the way of moments whose powers are taken: of one order after the other. */
typedef struct {
    Floats left[MOST_PLACES], step[MOST_PLACES];
    int64_t places;
} Means;

static Means means_of(const NearbyLight *data, double anisotropy, int64_t first) {
    Means means = {.places = least_int(data->places, MOST_PLACES)};
    Floats sum = in_all(0.0f);
    float rate = anisotropy > 0.0 ? (float)-log(anisotropy) : 0.0f;
    for (int64_t p = 0; p < means.places; p++) {
        means.left[p] = lanes_from(data->matter + p * data->points, first, data->points);
        sum += means.left[p];
        means.step[p] = in_all((float)anisotropy);
        if (anisotropy <= 0.0) continue;
        means.step[p] = transmittance(lanes_from(data->parts + p * data->points, first, data->points) * rate);
    }
    /* Where light scatters backwards it is the phase function's own powers. */
    for (int64_t p = 0; p < means.places && anisotropy <= 0.0; p++) means.left[p] /= sum;
    return means;
}

static Floats next_mean(Means *means) {
    Floats sum = in_all(0.0f);
    for (int64_t p = 0; p < means->places; p++) {
        sum += means->left[p];
        means->left[p] *= means->step[p];
    }
    return sum;
}

/* Unscattered light at points, and how much of it has turned by small angles since. */
typedef struct {
    Floats irradiance, depth, scattering, unscattered;
} Beam;

static Floats turned(const Beam *beam, Floats moment) {
    return beam->irradiance * (transmittance(beam->depth - moment * beam->scattering) - beam->unscattered);
}

static Floats positive(Floats x) { return choose(x > 0.0f, x, in_all(0.0f)); }

static Floats at_least(Floats x, float least) { return choose(x > least, x, in_all(least)); }

/* Radiance that light around the direction of its flux scatters towards the camera. */
static Floats lobe(const NearbyLight *data, Floats fluence, const Floats *flux, const Floats *back) {
    Floats whole = positive(fluence), size = roots(dot(flux, flux));
    Floats straightness = least_of(size / at_least(whole, 1e-30f), in_all((float)data->straightest_peak));
    return whole * henyey_greenstein(dot(flux, back) / at_least(size, 1e-30f), (float)data->anisotropy * straightness);
}

/* Radiance from light that has scattered within the peak alone. */
static Floats scattered_narrow(const NearbyLight *data, int64_t first, const Floats *light, const Floats *towards,
                               const Floats *omega, const Floats *back) {
    float g = (float)data->anisotropy, wide = 1.0f - g * g;
    Floats cosine = dot(omega, towards), ahead = positive(cosine), flux[3];
    Floats radiance = (1.0f - ahead) * lobe(data, light[0], light + 1, back);
    if (!any_lane(ahead > 0.0f)) return radiance;
    Beam beam = {lanes_from(data->irradiance, first, data->points), lanes_from(data->depth, first, data->points),
                 (float)data->albedo * lanes_from(data->scattering, first, data->points), in_all(0.0f)};
    beam.unscattered = transmittance(beam.depth);
    Means means = means_of(data, data->anisotropy, first), reduced = means_of(data, data->reduced, first);
    Floats straight[2], mean;
    for (int l = 0; l < 2; l++) mean = next_mean(&means), straight[l] = turned(&beam, mean - wide * next_mean(&reduced));
    Floats size = choose(straight[1] < 0.0f, -straight[1], straight[1]), along = -dot(light + 1, towards);
    Floats fraction = choose(size > 1e-30f, along / choose(size > 1e-30f, straight[1], in_all(1.0f)), in_all(1.0f));
    fraction = clamped_to(fraction, in_all(0.0f), in_all(1.0f));
    for (int k = 0; k < 3; k++) flux[k] = light[1 + k] + fraction * straight[1] * towards[k];
    radiance += ahead * lobe(data, light[0] - fraction * straight[0], flux, back);
    /* Legendre's polynomials by their recurrence. */
    Floats before = in_all(0.0f), polynomial = in_all(1.0f);
    float weight = 1.0f / SPHERE;
    for (int64_t order = 0; order < data->terms; order++) {
        Floats moment = order < 2 ? straight[order] : in_all(0.0f);
        if (order >= 2) mean = next_mean(&means), moment = turned(&beam, mean - wide * next_mean(&reduced));
        radiance += (float)(2 * order + 1) * weight * (ahead * fraction * moment * polynomial);
        Floats after = ((float)(2 * order + 1) * (cosine * polynomial) - (float)order * before) / (float)(order + 1);
        before = polynomial, polynomial = after, weight *= g;
    }
    return radiance;
}

/* Radiance from all other light, given by the transport's moments. */
static Floats scattered_wide(const NearbyLight *data, const Floats *moments, const Floats *back) {
    float g = (float)data->anisotropy;
    Floats middle[3], inside[DEGREES], seen[DEGREES], polynomial[DEGREES], length = roots(dot(moments + 1, moments + 1));
    for (int k = 0; k < 3; k++) middle[k] = moments[1 + k] / at_least(length, 1e-30f);
    along(moments, middle, inside);
    Floats fluence = positive(inside[0]), flux = positive(inside[1]);
    Floats r = clamped_to(inside[2] / at_least(flux, 1e-30f), in_all(0.0f), in_all((float)data->straightest));
    Floats amount = least_of(flux / at_least(r, 1e-6f), fluence), turn = dot(middle, back);
    along(moments, back, seen);
    legendre(turn, polynomial);
    Floats radiance = amount * henyey_greenstein(turn, g * r), power = amount;
    float weight = 1.0f;
    for (int l = 0; l < DEGREES; l++) {
        radiance += (float)data->weights[l] * weight * (seen[l] - power * polynomial[l]);
        power *= r, weight *= g;
    }
    return radiance;
}

static Floats scattered(const NearbyLight *data, int64_t first) {
    int64_t points = data->points;
    Floats values[VALUES], omega[3], towards[3], back[3];
    values_at(data, first, values);
    for (int k = 0; k < 3; k++) {
        omega[k] = lanes_from(data->omega + k * points, first, points), back[k] = -omega[k];
        towards[k] = lanes_from(data->towards + k * points, first, points);
    }
    Floats radiance = scattered_wide(data, values, back);
    /* Light that scatters backwards has no peak. */
    if (data->anisotropy > 0.0) radiance += scattered_narrow(data, first, values + HARMONICS, towards, omega, back);
    /* A series of few degrees may be negative. */
    Floats least = (float)data->least / SPHERE * values[0];
    return choose(radiance > least, radiance, least);
}

int64_t NAMED(scatter_nearby, VARIANT)(const NearbyLight *data) {
    for (int64_t first = 0; first < data->points; first += LANES) {
        Floats radiance = scattered(data, first);
        for (int n = 0; n < LANES && first + n < data->points; n++) data->out[first + n] = radiance[n];
    }
    return data->points;
}
