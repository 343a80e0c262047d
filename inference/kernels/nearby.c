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
/* Fluence and flux. */
#define FLOW 4
/* Places on the way from a lamp at which matter is read. */
#define PLACES 4

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

static Floats positive(Floats x) { return choose(x > 0.0f, x, in_all(0.0f)); }

static Floats at_least(Floats x, float least) { return choose(x > least, x, in_all(least)); }

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

/* `count` values of cells, interpolated at places that lie in them. strides: of the cells, in values. */
static void interpolated(const float *cells, const int64_t *strides, int count, const Floats *place, Floats *out) {
    Ints cell[3];
    Floats inside[3];
    for (int k = 0; k < 3; k++) cell[k] = to_ints(place[k]), inside[k] = place[k] - to_floats(cell[k]);
    int64_t x = strides[0], y = strides[1], z = strides[2];
    FOR_LANES(n) {
        const float *at = cells + x * cell[0][n] + y * cell[1][n] + z * cell[2][n];
        float fx = inside[0][n], fy = inside[1][n], fz = inside[2][n], values[VALUES];
        for (int k = 0; k < count; k++) {
            float a = at[k] + fz * (at[k + z] - at[k]), b = at[k + y] + fz * (at[k + y + z] - at[k + y]);
            float c = at[k + x] + fz * (at[k + x + z] - at[k + x]);
            float d = at[k + x + y] + fz * (at[k + x + y + z] - at[k + x + y]);
            a += fy * (b - a), c += fy * (d - c);
            values[k] = a + fx * (c - a);
        }
        for (int k = 0; k < count; k++) out[k][n] = values[k];
    }
}

/* Points as a lamp sees them. */
typedef struct {
    Doubles world[3];
    Floats cell[3], position[3], omega[3], back[3];  /* cell: in all cells */
    int64_t first;
} Points;

static Points points_from(const NearbyLight *data, int64_t first) {
    Points points = {.first = first};
    Floats most = in_all((float)data->edge - 1.0f - 1e-3f);
    for (int k = 0; k < 3; k++) {
        FOR_LANES(n) points.world[k][n] = data->positions[3 * least_int(first + n, data->points - 1) + k];
        Floats index = lanes_from(data->index + k * data->points, first, data->points);
        points.cell[k] = clamped_to(index, in_all(0.0f), most);
        points.position[k] = (index - 0.5f) / (float)(data->edge - 2) - 0.5f;
        points.omega[k] = lanes_from(data->omega + k * data->points, first, data->points);
        points.back[k] = -points.omega[k];
    }
    return points;
}

/* Density at positions in the cube's frame. */
static Floats density_at(const NearbyLight *data, const Floats *position) {
    Floats place[3], density, most = in_all((float)data->edge - 1.0f - 1e-3f);
    const int64_t strides[3] = {data->edge * data->edge, data->edge, 1};
    for (int k = 0; k < 3; k++) {
        place[k] = clamped_to((position[k] + 0.5f) * (float)(data->edge - 2) + 0.5f, in_all(0.0f), most);
    }
    interpolated(data->density, strides, 1, place, &density);
    return density;
}

/* The straight ways from a lamp to points: parts of each up to some places, and the share of its matter that is there. */
typedef struct {
    Floats parts[PLACES], matter[PLACES];
} Ways;

static Ways ways_of(const NearbyLight *data, const NearbyLamp *lamp, const Floats *position) {
    Ways ways;
    Floats start = in_all(0.0f), sum = in_all(0.0f), way[3];
    for (int k = 0; k < 3; k++) {
        float from = (float)lamp->place[k];
        way[k] = position[k] - from;
        Floats slope = choose((way[k] > 1e-12f) | (way[k] < -1e-12f), way[k], in_all(1e-12f));
        Floats low = ((float)data->low[k] - from) / slope, high = ((float)data->high[k] - from) / slope;
        Floats nearer = choose(low < high, low, high);
        start = choose(nearer > start, nearer, start);
    }
    start = clamped_to(start, in_all(0.0f), in_all(1.0f));
    for (int p = 0; p < PLACES; p++) {
        Floats at[3];
        ways.parts[p] = start + (1.0f - start) * (((float)p + 0.5f) / PLACES);
        for (int k = 0; k < 3; k++) at[k] = (float)lamp->place[k] + ways.parts[p] * way[k];
        /* Evenly spread where the cells hold none. */
        ways.matter[p] = density_at(data, at) + 1e-9f;
        sum += ways.matter[p];
    }
    for (int p = 0; p < PLACES; p++) ways.matter[p] /= sum;
    return ways;
}

/* Optical depth from a lamp at which light of its soft falloff starts to be scattered. */
static Floats soft_start(const NearbyLight *data, const NearbyLamp *lamp, const Floats *position) {
    Floats way[3], mean = in_all(0.0f), start, distance = in_all(0.0f);
    for (int k = 0; k < 3; k++) way[k] = position[k] - (float)lamp->place[k], distance += way[k] * way[k];
    distance = at_least(roots(distance), 1e-30f);
    Floats part = least_of(FIRST_PART * (float)lamp->radius / distance, in_all(1.0f));
    for (int node = 0; node < 2; node++) {
        Floats at[3];
        for (int k = 0; k < 3; k++) at[k] = (float)lamp->place[k] + (float)GAUSS_NODES[node] * part * way[k];
        mean += 0.5f * density_at(data, at);
    }
    Floats node = distance / (distance + (float)lamp->radius) * (float)(EXCESS_NODES - 1);
    node = clamped_to(node, in_all(0.0f), in_all((float)(EXCESS_NODES - 1)));
    FOR_LANES(n) {
        int cell = node[n] < (float)(EXCESS_NODES - 2) ? (int)node[n] : EXCESS_NODES - 2;
        start[n] = lamp->start[cell] + (node[n] - (float)cell) * (lamp->start[cell + 1] - lamp->start[cell]);
    }
    return start * clamped_to(mean / (float)larger(lamp->around, 1e-30), in_all(0.0f), in_all(EXCESS_MOST));
}

/* Means over the matter on the way of moments whose powers are taken: of one order after the other. */
typedef struct {
    Floats left[PLACES], step[PLACES];
} Means;

static Means means_of(const Ways *ways, double anisotropy) {
    Means means;
    float rate = (float)-log(larger(anisotropy, 1e-30));
    for (int p = 0; p < PLACES; p++) means.left[p] = ways->matter[p], means.step[p] = transmittance(ways->parts[p] * rate);
    return means;
}

static Floats next_mean(Means *means) {
    Floats sum = in_all(0.0f);
    for (int p = 0; p < PLACES; p++) {
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

/* Radiance that light around the direction of its flux scatters towards the camera. */
static Floats lobe(const NearbyLight *data, Floats fluence, const Floats *flux, const Floats *back) {
    Floats whole = positive(fluence), size = roots(dot(flux, flux));
    Floats straightness = least_of(size / at_least(whole, 1e-30f), in_all((float)data->straightest_peak));
    return whole * henyey_greenstein(dot(flux, back) / at_least(size, 1e-30f), (float)data->anisotropy * straightness);
}

/* A lamp's unscattered light at points. */
static Beam beam_of(const NearbyLight *data, int64_t number, const Points *points) {
    const NearbyLamp *lamp = data->lamp_list + number;
    Beam beam = {.irradiance = in_all(0.0f)};
    Floats most = in_all(0.0f);
    for (int64_t e = 0; e < lamp->emitters; e++) {
        beam.irradiance += emitter_fluences(lamp->parts + e, points->world);
        most += brightest_of(lamp->parts + e, points->world);
    }
    beam.depth = lanes_from(data->depths + number * data->points, points->first, data->points);
    /* What a spot's cone or an area light's side withholds is no optical depth: nothing scatters forwards there. */
    Floats given = beam.irradiance / at_least(LEAST_FACING * most, 1e-30f);
    if (any_lane(given < 1.0f)) {
        FOR_LANES(n) beam.depth[n] += given[n] < 1.0f ? logf(given[n] > 1e-30f ? given[n] : 1e-30f) : 0.0f;
    }
    beam.depth = positive(beam.depth);
    beam.scattering = beam.depth;
    if (lamp->start) beam.scattering = positive(beam.depth - soft_start(data, lamp, points->position));
    beam.scattering *= (float)data->albedo;
    beam.irradiance = (float)lamp->power * softened(beam.irradiance, data->radius);
    beam.unscattered = transmittance(beam.depth);
    return beam;
}

/* Radiance from a lamp's light that has scattered within the peak alone. light: its fluence and flux. */
static Floats scattered_narrow(const NearbyLight *data, int64_t number, const Points *points, const Floats *light) {
    const NearbyLamp *lamp = data->lamp_list + number;
    float g = (float)data->anisotropy, wide = 1.0f - g * g;
    const Floats *back = points->back;
    Floats towards[3], flux[3], radiance = lobe(data, light[0], light + 1, back), mean;
    for (int k = 0; k < 3; k++) towards[k] = (float)lamp->place[k] - points->position[k];
    Floats away = at_least(roots(dot(towards, towards)), 1e-30f);
    for (int k = 0; k < 3; k++) towards[k] /= away;
    Floats cosine = dot(points->omega, towards), ahead = positive(cosine);
    if (!any_lane(ahead > 0.0f)) return radiance;
    radiance *= 1.0f - ahead;
    const Ways ways = ways_of(data, lamp, points->position);
    const Beam beam = beam_of(data, number, points);
    Means means = means_of(&ways, data->anisotropy), reduced = means_of(&ways, data->reduced);
    Floats straight[2];
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

/* Radiance of a lamp, of its light at points. */
static Floats scattered_of(const NearbyLight *data, int64_t number, const Points *points, const Floats *light) {
    Floats radiance = scattered_wide(data, light, points->back), least = (float)data->least / SPHERE * light[0];
    /* Light that scatters backwards has no peak. */
    if (data->anisotropy > 0.0) radiance += scattered_narrow(data, number, points, light + HARMONICS);
    /* A series of few degrees may be negative. */
    return choose(radiance > least, radiance, least);
}

static Floats scattered(const NearbyLight *data, int64_t first) {
    const Points points = points_from(data, first);
    const int64_t flow[3] = {FLOW * data->edge * data->edge, FLOW * data->edge, FLOW};
    const int64_t strides[3] = {VALUES * data->edge * data->edge, VALUES * data->edge, VALUES};
    Floats radiance = in_all(0.0f), rest[HARMONICS], light[VALUES];
    for (int n = 0; n < HARMONICS; n++) rest[n] = in_all(0.0f);
    if (data->together) interpolated(data->together, flow, FLOW, points.cell, rest);
    Floats slight = (float)data->joined * positive(rest[0]);
    for (int64_t k = 0; k < data->lamps; k++) {
        const NearbyLamp *lamp = data->lamp_list + k;
        float factor = (float)(lamp->power * lamp->scale);
        interpolated(lamp->cells, strides, data->together ? 1 : VALUES, points.cell, light);
        if (data->together && !any_lane(light[0] * factor > slight)) continue;
        if (data->together) interpolated(lamp->cells, strides, VALUES, points.cell, light);
        for (int n = 0; n < VALUES; n++) light[n] *= factor;
        for (int n = 0; n < FLOW; n++) rest[n] -= light[n];
        radiance += scattered_of(data, k, &points, light);
    }
    return data->together ? radiance + positive(scattered_wide(data, rest, points.back)) : radiance;
}

int64_t NAMED(scatter_nearby, VARIANT)(const NearbyLight *data) {
    for (int64_t first = 0; first < data->points; first += LANES) {
        Floats radiance = scattered(data, first);
        for (int n = 0; n < LANES && first + n < data->points; n++) data->out[first + n] = radiance[n];
    }
    return data->points;
}
