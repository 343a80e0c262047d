/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Light of lamps at points. */

#ifndef MRPNN_LAMP_SAMPLING_H
#define MRPNN_LAMP_SAMPLING_H

#include "sampling.h"

#define PI 3.14159265358979323846

/* Part of a place between columns beyond the outermost of them that counts as rounding. */
#define COLUMN_ROUNDING 1e-3f

/* Part of the light that a lamp would give to a point that it faced, and that stands for its light where that is less. */
#define LEAST_FACING 0.25f

/* Of parts of a sphere that shines into a cone: scene/emitters.py and scene/spot_cone.py. */
#define DRAWN_IN 0.8660254037844386
#define NODES_APART 0.5

/* Radius, over the sphere's, of a sphere that holds the disks that represent it: light of none leaves its cone. */
#define DISKS_REACH 2.0

/* The nodes of Gauss and Legendre in [0, 1]. */
static const double GAUSS_NODES[2] = {0.21132486540518713, 0.78867513459481287};

static inline double larger(double a, double b) { return a > b ? a : b; }
static inline double smaller(double a, double b) { return a < b ? a : b; }

/* Number of the slice in front of a distance. */
static inline int64_t slice_before(const Pyramid *pyramid, double along) {
    const double *starts = pyramid->starts;
    int64_t last = pyramid->slices - 2, low = 0, high = last;
    /* Slices are evenly spaced, but for the first and the last. */
    if (last > 1) {
        double guess = (along - starts[1]) / (starts[2] - starts[1]);
        int64_t number = guess > 0.0 ? (guess < (double)last ? (int64_t)guess + 1 : last) : 0;
        number = within(number, last);
        if (along >= starts[number] && (number == last || along < starts[number + 1])) return number;
    }
    while (low < high) {
        int64_t middle = (low + high + 1) / 2;
        if (along >= starts[middle]) low = middle; else high = middle - 1;
    }
    return low;
}

/* One over the square roots of numbers within 1e-30 and 1e30: Newton's method from a guess of the bits. */
static inline Floats inverse_roots(Floats x) {
    Floats y = (Floats)(0x5f375a86 - ((Ints)x >> 1)), half = 0.5f * x;
    for (int n = 0; n < 3; n++) y = y * (1.5f - half * y * y);
    return y;
}

/* Nodes of LampColumns.excess: grids/sphere_depth.NODES. */
#define EXCESS_NODES 64

/* sphere_depth.FIRST_PART, EXCESS_MOST. */
#define FIRST_PART 3.0f
#define EXCESS_MOST 1.5f

/* Mean density on the first fraction of rays from the sphere's centre, of components `steps`, over that around it. */
static inline Floats relative_density(const LampColumns *lamp, const Floats *steps, Floats fraction) {
    Floats total = in_all(0.0f);
    for (int node = 0; node < 2; node++) {
        Floats position[3];
        for (int axis = 0; axis < 3; axis++)
            position[axis] = (float)lamp->centre[axis] + steps[axis] * ((float)GAUSS_NODES[node] * fraction);
        total += sample_grid(&lamp->density, position);
    }
    return clamped_to(0.5f * total / (float)larger(lamp->around, 1e-30), in_all(0.0f), in_all(EXCESS_MOST));
}

/* Optical depth of a sphere's light less that from the lamp's position: sphere_depth.excess_depths. */
static inline Floats depth_beyond(const LampColumns *lamp, const Floats *index, float sigma_t) {
    Floats steps[3], square = in_all(1e-30f), along = in_all(0.0f), total = in_all(0.0f), below, above;
    float apart = 0.0f, radius = (float)lamp->radius;
    for (int axis = 0; axis < 3; axis++) {
        steps[axis] = clamped_to(index[axis] - (float)lamp->centre[axis], in_all(-FAR_AWAY), in_all(FAR_AWAY));
        apart += (float)(lamp->offset[axis] * lamp->offset[axis]);
    }
    for (int i = 0; i < 3; i++) {
        const double *row = lamp->world_from_index + 3 * i;
        Floats away = steps[0] * (float)row[0] + steps[1] * (float)row[1] + steps[2] * (float)row[2];
        square += away * away, along += away * (float)lamp->offset[i];
    }
    Floats inverse = inverse_roots(clamped_to(square, in_all(1e-30f), in_all(1e30f))), distance = square * inverse;
    along *= inverse;
    Floats missing = along;
    if (!lamp->soft_falloff) {
        Floats across = clamped_to(apart - along * along, in_all(0.0f), in_all(radius * radius));
        Floats start = clamped_to(radius * radius - across, in_all(1e-30f), in_all(1e30f));
        missing -= start * inverse_roots(start);
    }
    for (int node = 0; node < 2; node++) {
        Floats position[3], back = (float)GAUSS_NODES[node] * missing * inverse;
        for (int axis = 0; axis < 3; axis++) position[axis] = (float)lamp->lamp[axis] - steps[axis] * back;
        total += sample_grid(&lamp->density, position);
    }
    /* Near the sphere, light comes from all around it, through matter of known mean density. */
    Floats far = clamped_to(1.0f - radius * radius * (inverse * inverse), in_all(0.0f), in_all(1.0f));
    Floats density = far * (0.5f * total) + (1.0f - far) * (float)lamp->around;
    Floats position = distance / (distance + radius) * (float)(EXCESS_NODES - 1);
    position = clamped_to(position, in_all(0.0f), in_all((float)(EXCESS_NODES - 1)));
    FOR_LANES(n) {
        int cell = position[n] < (float)(EXCESS_NODES - 2) ? (int)position[n] : EXCESS_NODES - 2;
        below[n] = lamp->excess[cell], above[n] = lamp->excess[cell + 1];
        position[n] -= (float)cell;
    }
    Floats more = lerp_lanes(below, above, position);
    Floats first = clamped_to(FIRST_PART * radius * inverse, in_all(0.0f), in_all(1.0f));
    if (lamp->uneven) more *= relative_density(lamp, steps, first);
    return more + sigma_t * missing * density;
}

/* Optical depths towards a lamp at continuous indices. */
static inline Floats lamp_depth(const LampColumns *lamp, const Floats *index, float sigma_t) {
    static const float zeros[2] = {0.0f, 0.0f};
    Floats away[3], size[3], fraction[2], begin, passed_fraction, span, length = in_all(0.0f);
    Pairs near[2], far[2];
    for (int axis = 0; axis < 3; axis++) {
        away[axis] = clamped_to(index[axis] - (float)lamp->lamp[axis], in_all(-FAR_AWAY), in_all(FAR_AWAY));
        size[axis] = choose(away[axis] < 0.0f, -away[axis], away[axis]);
    }
    /* The axis along which each point is farthest from the lamp, and slopes along the others, in order. */
    Ints second = size[1] > size[0], third = size[2] > choose(second, size[1], size[0]);
    Floats along = choose(third, size[2], choose(second, size[1], size[0]));
    Ints inside = along > 0.0f;
    Floats once = 1.0f / choose(inside, along, in_all(1.0f));
    Floats slope[2] = {choose(second | third, away[0], away[1]) * once, choose(third, away[1], away[2]) * once};
    Floats main = choose(third, away[2], choose(second, away[1], away[0]));
    Ints number = choose_int(third, (Ints){0} + 4, choose_int(second, (Ints){0} + 2, (Ints){0})) - (main < 0.0f);
    for (int i = 0; i < 3; i++) {
        const double *row = lamp->world_from_index + 3 * i;
        Floats sum = (float)row[0] * (away[0] * once) + (float)row[1] * (away[1] * once) + (float)row[2] * (away[2] * once);
        length += sum * sum;
    }
    length = length * inverse_roots(clamped_to(length, in_all(1e-30f), in_all(1e30f)));
    Ints cell[2];
    for (int k = 0; k < 2; k++) {
        Floats first, spacing, last;
        FOR_LANES(n) {
            const Pyramid *pyramid = lamp->pyramids + number[n];
            first[n] = (float)pyramid->first[k], spacing[n] = (float)pyramid->spacing[k];
            last[n] = (float)(pyramid->size[k] - 1);
        }
        Floats position = (slope[k] - first) / spacing;
        inside &= (position >= -COLUMN_ROUNDING) & (position <= last + COLUMN_ROUNDING);
        position = clamped_to(position, in_all(0.0f), choose(last > 0.0f, last, in_all(0.0f)));
        cell[k] = to_ints(position);
        cell[k] += to_floats(cell[k]) > last - 1.0f;
        fraction[k] = position - to_floats(cell[k]);
    }
    FOR_LANES(n) {
        const Pyramid *pyramid = lamp->pyramids + number[n];
        near[0][n] = near[1][n] = far[0][n] = far[1][n] = pair_at(zeros);
        begin[n] = passed_fraction[n] = span[n] = 0.0f;
        if (pyramid->slices < 2) inside[n] = 0;
        if (!inside[n]) continue;
        int64_t slice = slice_before(pyramid, along[n]), width = pyramid->size[1], step = pyramid->size[0] * width;
        double start = pyramid->starts[slice], gap = pyramid->starts[slice + 1] - start;
        double passed = larger(smaller((double)along[n] - start, gap), 0.0);
        begin[n] = (float)start;
        passed_fraction[n] = (float)(passed / gap);
        span[n] = (float)passed;
        const float *at = pyramid->depths + slice * step + cell[0][n] * width + cell[1][n];
        near[0][n] = pair_at(at), near[1][n] = pair_at(at + width);
        far[0][n] = pair_at(at + step), far[1][n] = pair_at(at + step + width);
    }
    if (!any_lane(inside)) return in_all(0.0f);
    Floats depth = lerp_lanes(lerp_pairs(near[0], fraction[1]), lerp_pairs(near[1], fraction[1]), fraction[0]);
    if (lamp->integrated) {
        Floats total = in_all(0.0f);
        for (int node = 0; node < 2; node++) {
            Floats position[3], scale = (begin + (float)GAUSS_NODES[node] * span) / choose(inside, along, in_all(1.0f));
            for (int axis = 0; axis < 3; axis++) position[axis] = (float)lamp->lamp[axis] + away[axis] * scale;
            total = total + sample_grid(&lamp->density, position);
        }
        depth = depth + 0.5f * total * span;
    } else {
        Floats after = lerp_lanes(lerp_pairs(far[0], fraction[1]), lerp_pairs(far[1], fraction[1]), fraction[0]);
        depth = lerp_lanes(depth, after, passed_fraction);
    }
    /* Cubic interpolation may fall below 0 beside sharp edges. */
    depth = choose(inside & (depth > 0.0f), depth * length, in_all(0.0f)) * sigma_t;
    if (!lamp->excess) return depth;
    depth += depth_beyond(lamp, index, sigma_t);
    return choose(inside & (depth > 0.0f), depth, in_all(0.0f));
}

/* Visibility of a lamp from 0 to 1 at a world point, by percentage-closer filtering. */
static inline double lamp_visibility(const LampShadowMap *map, const double *point) {
    double away[3], local[3];
    int axis = 0;
    for (int k = 0; k < 3; k++) away[k] = point[k] - map->position[k];
    if (fabs(away[1]) > fabs(away[0])) axis = 1;
    if (fabs(away[2]) > fabs(away[axis])) axis = 2;
    int64_t face = 2 * axis + (away[axis] < 0.0);
    const double *frame = map->frames + 9 * face;
    for (int j = 0; j < 3; j++) local[j] = frame[j] * away[0] + frame[3 + j] * away[1] + frame[6 + j] * away[2];
    float distance = (float)sqrt(dot_of(away, away));
    double depth = larger(-local[2], 1e-30), half = 0.5 * (double)map->cells;
    double column = (local[0] / depth + 1.0) * half - 0.5, row = (1.0 - local[1] / depth) * half - 0.5, lit = 0.0;
    column = column > -1.0 ? smaller(column, 2.0 * half) : -1.0;
    row = row > -1.0 ? smaller(row, 2.0 * half) : -1.0;
    double left = floor(column), top = floor(row), u = column - left, v = row - top;
    /* Nearly everywhere the map around tells, which is far smaller than the caches of processors. */
    int64_t across = within((int64_t)left, map->cells - 1) / MRPNN_SHADOW_BLOCK;
    int64_t down = within((int64_t)top, map->cells - 1) / MRPNN_SHADOW_BLOCK;
    const float *extremes = map->extremes + 2 * ((face * map->blocks + down) * map->blocks + across);
    if (distance <= extremes[0]) return 1.0;
    if (distance > extremes[1]) return 0.0;
    for (int n = 0; n < 4; n++) {
        int64_t i = within((int64_t)left + (n >> 1), map->cells - 1), j = within((int64_t)top + (n & 1), map->cells - 1);
        double weight = (n >> 1 ? u : 1.0 - u) * (n & 1 ? v : 1.0 - v);
        if (distance <= map->distances[(face * map->cells + j) * map->cells + i]) lit += weight;
    }
    return lit;
}

/* Solid angle of a triangle seen from the origin, as a half. */
static inline double half_solid_angle(const double *a, const double *b, const double *c, double x, double y, double z) {
    double volume = (a[1] * b[2] - a[2] * b[1]) * c[0] + (a[2] * b[0] - a[0] * b[2]) * c[1] +
                    (a[0] * b[1] - a[1] * b[0]) * c[2];
    return atan2(fabs(volume), x * y * z + dot_of(a, b) * z + dot_of(a, c) * y + dot_of(b, c) * x);
}

static inline double spread_factor(const Emitter *emitter, double cosine) {
    if (!(cosine > 0.0)) return 0.0;
    double tangent = sqrt(larger(1.0 - cosine * cosine, 0.0)) / larger(cosine, 1e-9);
    return larger(emitter->tangent - tangent, 0.0) / emitter->focused;
}

static inline double quad_fluence(const Emitter *emitter, const double *point, const double *away) {
    double rise = dot_of(away, emitter->normal), angle = 0.0;
    if (!(rise > 0.0)) return 0.0;
    if (!(dot_of(away, away) < emitter->far)) {
        for (int n = 0; n < 4; n++) {
            double from[3];
            for (int j = 0; j < 3; j++) from[j] = point[j] - emitter->nodes[3 * n + j];
            double square = larger(dot_of(from, from), 1e-60);
            angle += emitter->areas[n] * rise / (square * sqrt(square));
        }
    } else {
        double corners[4][3], length[4];
        for (int k = 0; k < 4; k++) {
            for (int j = 0; j < 3; j++) corners[k][j] = emitter->corners[3 * k + j] - point[j];
            length[k] = sqrt(dot_of(corners[k], corners[k]));
        }
        angle = 2.0 * (half_solid_angle(corners[0], corners[1], corners[2], length[0], length[1], length[2]) +
                       half_solid_angle(corners[0], corners[2], corners[3], length[0], length[2], length[3]));
    }
    if (emitter->tangent > 0.0) {
        double total = 0.0;
        for (int n = 0; n < 9; n++) {
            double u = (1 + 2 * (n / 3)) / 6.0, v = (1 + 2 * (n % 3)) / 6.0, from[3];
            const double *c = emitter->corners;
            for (int j = 0; j < 3; j++) {
                from[j] = point[j] - ((1.0 - v) * ((1.0 - u) * c[j] + u * c[3 + j]) + v * ((1.0 - u) * c[9 + j] + u * c[6 + j]));
            }
            total += spread_factor(emitter, dot_of(from, emitter->normal) / larger(sqrt(dot_of(from, from)), 1e-30));
        }
        angle *= total / 9.0;
    }
    return emitter->radiance * angle;
}

/* Fluence of an emitter, of a lamp of power 1, if it faced a world point. */
static inline double brightest(const Emitter *emitter, const double *point) {
    double away[3];
    const double *from = emitter->flat ? emitter->position : emitter->centre;
    for (int k = 0; k < 3; k++) away[k] = point[k] - from[k];
    double square = dot_of(away, away);
    if (emitter->flat) {
        return emitter->radiance * emitter->focus * emitter->area / (square + emitter->extent * emitter->extent);
    }
    double area = emitter->radius * emitter->radius;
    square = larger(square, emitter->closest);
    if (emitter->soft_falloff) {
        double slant = square + area;
        return 2.0 * emitter->intensity / (slant + sqrt(square * slant));
    }
    if (!(square > area)) return 4.0 * emitter->intensity / larger(area, 1e-60);
    return 2.0 * emitter->intensity / (square * (1.0 + sqrt(1.0 - smaller(area / square, 1.0))));
}

/* Fraction of a spot emitter's light at a world point that the cone lets pass: SphereEmitter._within_cone and
SpotCone.passed. */
static inline double within_cone(const Emitter *emitter, const double *point) {
    static const double turns[3] = {0.8660254037844387, 0.0, -0.8660254037844387};
    double away[3], offset[3], radius = emitter->radius, area = radius * radius;
    /* Most points lie far outside of the cone. */
    double bound = emitter->bound * emitter->bound, rise = 0.0, length = 0.0;
    double before = DISKS_REACH * radius / larger(sqrt(1.0 - bound), 1e-9);
    for (int k = 0; k < 3; k++) {
        double from = point[k] - (emitter->centre[k] - emitter->axis[k] * before);
        rise += from * emitter->axis[k], length += from * from;
    }
    if (rise < 0.0 || rise * rise < bound * length) return 0.0;
    for (int k = 0; k < 3; k++) {
        away[k] = point[k] - emitter->centre[k];
        offset[k] = DRAWN_IN * (emitter->position[k] - emitter->centre[k]);
    }
    double square = larger(dot_of(away, away), 1e-60), distance = sqrt(square), apart = dot_of(offset, offset);
    if (square <= (emitter->soft_falloff ? 0.0 : area)) return 1.0;
    if (apart > 0.0) {
        double near = square / (square + area), along = near * dot_of(away, offset) / distance, start = 0.0;
        if (!emitter->soft_falloff) start = sqrt(larger(area - larger(near * near * apart - along * along, 0.0), 0.0));
        for (int k = 0; k < 3; k++) away[k] = away[k] * (1.0 - (start - along) / distance) - near * offset[k];
        radius *= sqrt(1.0 - DRAWN_IN * DRAWN_IN * near * near);
        distance = larger(sqrt(dot_of(away, away)), 1e-30);
    }
    double level = dot_of(away, emitter->axis) / distance;
    if (emitter->elliptic) {
        double seen[3];
        for (int k = 0; k < 3; k++) seen[k] = dot_of(emitter->frame + 3 * k, away) / distance;
        length = sqrt(dot_of(seen, seen));
        level = seen[2] / length, radius *= sqrt(emitter->stretch / (length * length * length));
    }
    level = larger(smaller(level, 1.0), -1.0);
    double tilt = sqrt(1.0 - level * level);
    double seen = sqrt(distance * distance + radius * radius), cap = distance / seen, sine = radius / seen;
    if ((level < cap ? level * cap + tilt * sine : 1.0) <= emitter->cosine) return 0.0;
    if ((level > -cap ? level * cap - tilt * sine : -1.0) >= emitter->cosine + emitter->width) return 1.0;
    double cone = larger(1.0 - emitter->cosine - 0.5 * emitter->width, 0.0);
    int narrow = cone < 1.0 - cap;
    double height = narrow ? cone : 1.0 - cap, edge = narrow ? cap : emitter->cosine + 0.5 * emitter->width;
    double extent = narrow ? sqrt(cone * (2.0 - cone)) : sine, passed = 0.0;
    double width = larger(narrow ? 1e-9 : emitter->width, NODES_APART * larger(extent * tilt, height * level));
    for (int ring = 0; ring < 2; ring++) {
        double top = 1.0 - GAUSS_NODES[ring] * height, aside = sqrt(larger(1.0 - top * top, 0.0)) * tilt;
        for (int n = 0; n < 3; n++) {
            double inside = larger(smaller((top * level + aside * turns[n] - edge) / width + 0.5, 1.0), 0.0);
            passed += inside * inside * (3.0 - 2.0 * inside);
        }
    }
    return passed * (narrow ? cone / larger(1.0 - cap, 1e-30) : 1.0) / 6.0;
}

/* Distances along a ray between which an emitter of `reach` times its radius may light it: SpotCone.between. */
static inline void lit_interval(const Emitter *emitter, double reach, const double *origin, const double *direction, double *lit) {
    lit[0] = -INFINITY, lit[1] = INFINITY;
    if (!emitter->cone) return;
    double square = emitter->bound * emitter->bound, away[3];
    double before = reach * emitter->radius / larger(sqrt(1.0 - square), 1e-9);
    for (int k = 0; k < 3; k++) away[k] = origin[k] - (emitter->centre[k] - emitter->axis[k] * before);
    double level = dot_of(away, emitter->axis), rise = dot_of(direction, emitter->axis), along = dot_of(away, direction);
    double a = rise * rise - square;
    if (fabs(a) < 1e-12) a = 1e-12;
    double b = level * rise - square * along, c = level * level - square * dot_of(away, away);
    double root = sqrt(larger(b * b - a * c, 0.0));
    double first = smaller((-b - root) / a, (-b + root) / a), last = larger((-b - root) / a, (-b + root) / a);
    if (a > 0.0 && rise > 0.0) {
        lit[0] = last;
    } else if (a > 0.0) {
        lit[1] = first;
    } else if (b * b < a * c || level + 0.5 * (first + last) * rise < 0.0) {
        lit[0] = INFINITY, lit[1] = -INFINITY;
    } else {
        lit[0] = first, lit[1] = last;
    }
}

/* Fluence of an emitter, of a lamp of power 1, at a world point. */
static inline double emitter_fluence(const Emitter *emitter, const double *point) {
    double away[3];
    for (int k = 0; k < 3; k++) away[k] = point[k] - emitter->position[k];
    if (emitter->flat) return quad_fluence(emitter, point, away);
    double fluence = brightest(emitter, point);
    return emitter->cone ? fluence * within_cone(emitter, point) : fluence;
}

/* Lengths of vectors squared, within the range of inverse_roots. */
static inline Floats squares_of(const Floats *vector) {
    Floats square = vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2];
    return clamped_to(square, in_all(1e-30f), in_all(1e30f));
}

/* Vectors from an origin to points, whose difference may have far fewer digits than they. */
static inline void vectors_from(const double *origin, const Doubles *point, Floats *away) {
    for (int k = 0; k < 3; k++) away[k] = __builtin_convertvector(point[k] - origin[k], Floats);
}

static inline Floats quad_fluences(const Emitter *emitter, const Doubles *point) {
    Floats away[3], angle = in_all(0.0f);
    vectors_from(emitter->position, point, away);
    Floats rise = away[0] * (float)emitter->normal[0] + away[1] * (float)emitter->normal[1] + away[2] * (float)emitter->normal[2];
    Ints lit = rise > 0.0f, near = lit & (squares_of(away) < (float)emitter->far);
    for (int n = 0; n < 4; n++) {
        Floats from[3];
        vectors_from(emitter->nodes + 3 * n, point, from);
        Floats inverse = inverse_roots(squares_of(from));
        angle += (float)emitter->areas[n] * inverse * (rise * inverse) * inverse;
    }
    if (emitter->tangent > 0.0) {
        Floats total = in_all(0.0f);
        const double *c = emitter->corners;
        for (int n = 0; n < 9; n++) {
            double u = (1 + 2 * (n / 3)) / 6.0, v = (1 + 2 * (n % 3)) / 6.0, node[3];
            for (int j = 0; j < 3; j++) {
                node[j] = (1.0 - v) * ((1.0 - u) * c[j] + u * c[3 + j]) + v * ((1.0 - u) * c[9 + j] + u * c[6 + j]);
            }
            Floats from[3];
            vectors_from(node, point, from);
            Floats inverse = inverse_roots(squares_of(from)), cosine = clamped_to(rise * inverse, in_all(1e-9f), in_all(1.0f));
            Floats sine = clamped_to(1.0f - cosine * cosine, in_all(1e-30f), in_all(1.0f));
            Floats left = (float)emitter->tangent - sine * inverse_roots(sine) / cosine;
            total += choose(left > 0.0f, left, in_all(0.0f));
        }
        angle *= total * (float)(1.0 / (9.0 * emitter->focused));
    }
    Floats fluence = choose(lit, angle * (float)emitter->radiance, in_all(0.0f));
    if (any_lane(near)) {
        FOR_LANES(n) {
            double at[3] = {point[0][n], point[1][n], point[2][n]}, from[3];
            for (int k = 0; k < 3; k++) from[k] = at[k] - emitter->position[k];
            if (near[n]) fluence[n] = (float)quad_fluence(emitter, at, from);
        }
    }
    return fluence;
}

/* As `brightest`, of several points. */
static inline Floats brightest_of(const Emitter *emitter, const Doubles *point) {
    Floats away[3];
    vectors_from(emitter->flat ? emitter->position : emitter->centre, point, away);
    Floats square = squares_of(away);
    if (emitter->flat) {
        double strength = emitter->radiance * emitter->focus * emitter->area;
        return (float)strength / (square + (float)(emitter->extent * emitter->extent));
    }
    float area = (float)(emitter->radius * emitter->radius), twice = (float)(2.0 * emitter->intensity);
    square = clamped_to(square, in_all((float)emitter->closest), in_all(1e30f));
    if (emitter->soft_falloff) {
        Floats slant = square + area;
        return twice / (slant + square * inverse_roots(square) * (slant * inverse_roots(slant)));
    }
    Floats gap = clamped_to(1.0f - area / square, in_all(1e-30f), in_all(1.0f));
    Floats outside = twice / (square * (1.0f + gap * inverse_roots(gap)));
    return choose(square > area, outside, in_all((float)(2.0 * twice / larger(area, 1e-30))));
}

/* As emitter_fluence, of several points. */
static inline Floats emitter_fluences(const Emitter *emitter, const Doubles *point) {
    if (emitter->flat) return quad_fluences(emitter, point);
    Floats fluence = brightest_of(emitter, point);
    if (!emitter->cone) return fluence;
    FOR_LANES(n) {
        /* In double precision, as a cone's edge may be sharp. */
        double at[3] = {point[0][n], point[1][n], point[2][n]};
        fluence[n] *= (float)within_cone(emitter, at);
    }
    return fluence;
}

/* Fluence of a lamp of power 1, limited as if the lamp were no nearer than `radius`. */
static inline Floats softened(Floats fluence, double radius) {
    return fluence / (1.0f + fluence * (float)(4.0 * PI * radius * radius));
}

#endif
