/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Samples of grids and of optical depths towards suns, eight at a time. */

#ifndef MRPNN_SAMPLING_H
#define MRPNN_SAMPLING_H

#include <math.h>

#include "exponential.h"
#include "kernels.h"
#include "lanes.h"

/* Further from 0 than any index, and still a whole number in both types. */
#define FAR_AWAY 1073741824.0f

/* Finite for every x, also for NaN: low where x is not above it. */
static inline float clamped(float x, float low, float high) {
    float raised = x > low ? x : low;
    return raised < high ? raised : high;
}

static inline float least(float a, float b) { return a < b ? a : b; }

static inline int64_t least_int(int64_t a, int64_t b) { return a < b ? a : b; }

static inline double dot_of(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static inline int64_t within(int64_t n, int64_t last) {
    return n < 0 ? 0 : n > last ? last : n;
}

/* The largest whole number that is not above x, for |x| <= FAR_AWAY. */
static inline int32_t floor_of(float x) {
    int32_t n = (int32_t)x;
    return n - ((float)n > x);
}

/* pairs: along z, for (x, y), (x, y + 1), (x + 1, y) and (x + 1, y + 1). */
static inline Floats trilinear(const Pairs *pairs, const Floats *fraction) {
    Floats y0 = lerp_lanes(lerp_pairs(pairs[0], fraction[2]), lerp_pairs(pairs[1], fraction[2]), fraction[1]);
    Floats y1 = lerp_lanes(lerp_pairs(pairs[2], fraction[2]), lerp_pairs(pairs[3], fraction[2]), fraction[1]);
    return lerp_lanes(y0, y1, fraction[0]);
}

/* The voxels below positions in a dense grid, counted in its padding, and fractions of the way to the next voxels. */
static inline void voxels_below(const Grid *grid, const Floats *position, Ints *cell, Floats *fraction) {
    for (int axis = 0; axis < 3; axis++) {
        Floats at = clamped_to(position[axis] + 1.0f, in_all(0.0f), in_all((float)(grid->size[axis] - 2)));
        cell[axis] = to_ints(at);
        fraction[axis] = at - to_floats(cell[axis]);
    }
}

static inline Floats sample_dense(const Grid *grid, const Floats *position) {
    Ints cell[3];
    Floats fraction[3];
    voxels_below(grid, position, cell, fraction);
    /* Whole rows: their number fits into 32 bits, which that of voxels may not. */
    Ints row = cell[0] * (int32_t)grid->size[1] + cell[1];
    int64_t length = grid->size[2], slab = length * grid->size[1], first[LANES];
    Longs voxel = to_longs(row) * length + to_longs(cell[2]);
    memcpy(first, &voxel, sizeof first);
    Pairs pairs[4];
    FOR_LANES(n) {
        const float *at = grid->values + first[n];
        pairs[0][n] = pair_at(at), pairs[1][n] = pair_at(at + length);
        pairs[2][n] = pair_at(at + slab), pairs[3][n] = pair_at(at + slab + length);
    }
    return trilinear(pairs, fraction);
}

/* Values of a block; those of the empty block 0 where the table holds no valid row. */
static inline const float *block_values(const Grid *grid, int64_t block) {
    int32_t row = grid->table[block];
    return grid->values + ((uint64_t)(int64_t)row < (uint64_t)grid->rows ? (int64_t)row * 512 : 0);
}

/* The four pairs around a voxel, which is the lowest of its cell. */
static inline void pairs_in_blocks(const Grid *grid, int32_t x, int32_t y, int32_t z, double *pairs) {
    int64_t block = ((int64_t)(x >> 3) * grid->size[1] + (y >> 3)) * grid->size[2] + (z >> 3);
    int32_t i = x & 7, j = y & 7, k = z & 7;
    if (i < 7 && j < 7 && k < 7) {
        const float *at = block_values(grid, block) + (i * 64 + j * 8 + k);
        pairs[0] = pair_at(at), pairs[1] = pair_at(at + 8);
        pairs[2] = pair_at(at + 64), pairs[3] = pair_at(at + 72);
        return;
    }
    for (int n = 0; n < 4; n++) {
        float two[2];
        for (int m = 0; m < 2; m++) {
            int32_t a = i + (n >> 1), b = j + (n & 1), c = k + m;
            int64_t next = block + ((a >> 3) * grid->size[1] + (b >> 3)) * grid->size[2] + (c >> 3);
            two[m] = block_values(grid, next)[(a & 7) * 64 + (b & 7) * 8 + (c & 7)];
        }
        pairs[n] = pair_at(two);
    }
}

static inline Floats sample_sparse(const Grid *grid, const Floats *position) {
    Ints cell[3];
    Floats fraction[3];
    for (int axis = 0; axis < 3; axis++) {
        Floats at = clamped_to(position[axis], in_all(-1.0f), in_all((float)grid->shape[axis]));
        at = at + (float)grid->first[axis];
        cell[axis] = to_ints(at);
        fraction[axis] = at - to_floats(cell[axis]);
    }
    double lanes[LANES][4];
    FOR_LANES(n) pairs_in_blocks(grid, cell[0][n], cell[1][n], cell[2][n], lanes[n]);
    Pairs pairs[4];
    FOR_LANES(n) {
        for (int k = 0; k < 4; k++) pairs[k][n] = lanes[n][k];
    }
    return trilinear(pairs, fraction);
}

/* Values at continuous indices. */
static inline Floats sample_grid(const Grid *grid, const Floats *position) {
    return grid->table ? sample_sparse(grid, position) : sample_dense(grid, position);
}

/* Velocities that carry what is seen at places to them within times since the frame. Looked up twice, as in Cycles: first
where it is seen, then where that velocity takes it from. */
static inline void velocities_at(const Flow *flow, const Doubles *place, Doubles time, Doubles *velocity) {
    Doubles from[3] = {place[0], place[1], place[2]};
    for (int lookup = 0; lookup < 2; lookup++) {
        Floats index[3], values[3];
        for (int i = 0; i < 3; i++) {
            const double *row = flow->linear + 3 * i;
            index[i] = __builtin_convertvector(row[0] * from[0] + row[1] * from[1] + row[2] * from[2] + flow->offset[i], Floats);
        }
        for (int i = 0; i < 3; i++) values[i] = sample_grid(flow->components + i, index);
        for (int i = 0; i < 3; i++) {
            const double *row = flow->turn + 3 * i;
            velocity[i] = row[0] * __builtin_convertvector(values[0], Doubles);
            for (int j = 1; j < 3; j++) velocity[i] += row[j] * __builtin_convertvector(values[j], Doubles);
            from[i] = place[i] - time * velocity[i];
        }
    }
}

/* Number of the cell around a position. */
static inline int64_t cell_around(const Occupancy *cells, const float *position) {
    int64_t base = 0;
    for (int axis = 0; axis < 3; axis++) {
        float cell = (position[axis] + (float)cells->first[axis]) * (float)cells->scale;
        base = base * cells->size[axis] + (int32_t)clamped(cell, 0.0f, (float)(cells->size[axis] - 1));
    }
    return base;
}

/* As cell_around, of several positions. */
static inline Longs cells_around(const Occupancy *cells, const Floats *position) {
    Longs base = {0};
    for (int axis = 0; axis < 3; axis++) {
        Floats cell = (position[axis] + (float)cells->first[axis]) * (float)cells->scale;
        Ints nearest = to_ints(clamped_to(cell, in_all(0.0f), in_all((float)(cells->size[axis] - 1))));
        base = base * cells->size[axis] + to_longs(nearest);
    }
    return base;
}

/* Whether the density may differ from 0 at any of the positions. */
static inline int any_held(const Medium *medium, const Floats *position) {
    const Grid *grid = &medium->density;
    if (!medium->held) return 1;
    Ints cell[3];
    Floats fraction[3];
    voxels_below(grid, position, cell, fraction);
    int64_t bytes = (grid->size[2] + 7) >> 3, first[LANES];
    Longs byte = to_longs(cell[0] * (int32_t)grid->size[1] + cell[1]) * bytes + to_longs(cell[2] >> 3);
    Ints bit = cell[2] & 7;
    memcpy(first, &byte, sizeof first);
    int bits = 0;
    FOR_LANES(n) bits |= medium->held[first[n]] >> bit[n];
    return bits & 1;
}

/* Depths of the four columns around points where their rays towards the sun meet slices, and fractions between them.

position: in the padded grid. ahead: slices from there to the slice. number: of the slice. corners: pairs of columns. */
static inline void columns_around(const SunColumns *sun, const Floats *position, Floats ahead, Ints number,
                                  Pairs *corners, Floats *fraction) {
    Ints slice = ints_within(number + (int32_t)sun->first, (int32_t)(sun->slices - 1)), cell[2];
    Pairs offsets;
    FOR_LANES(n) offsets[n] = pair_at(sun->offsets + 2 * (int64_t)slice[n]);
    for (int k = 0; k < 2; k++) {
        int64_t axis = sun->others[k];
        Floats at = ahead * (float)sun->move[axis] + position[axis] + (k ? second_of(offsets) : first_of(offsets));
        at = clamped_to(at, in_all(0.0f), in_all((float)(sun->size[k] - 1)));
        cell[k] = ints_within(to_ints(at), (int32_t)(sun->size[k] - 2));
        fraction[k] = at - to_floats(cell[k]);
    }
    int64_t width = sun->size[1];
    if (!sun->table) {
        Longs column = (to_longs(slice) * sun->size[0] + to_longs(cell[0])) * width + to_longs(cell[1]);
        int64_t first[LANES];
        memcpy(first, &column, sizeof first);
        FOR_LANES(n) {
            const float *at = sun->depths + first[n];
            corners[0][n] = pair_at(at), corners[1][n] = pair_at(at + width);
        }
        return;
    }
    FOR_LANES(n) {
        int64_t layer = (slice[n] >> 3) * (sun->size[0] >> 3);
        float depths[4];
        for (int k = 0; k < 4; k++) {
            int32_t b = cell[0][n] + (k >> 1), c = cell[1][n] + (k & 1);
            int32_t entry = sun->table[(layer + (b >> 3)) * (width >> 3) + (c >> 3)];
            int64_t tile = (int64_t)(entry >> 1) + (entry & 1 ? slice[n] & 7 : 0);
            if ((uint64_t)tile >= (uint64_t)sun->tiles) tile = 0;
            depths[k] = sun->depths[tile * 64 + (b & 7) * 8 + (c & 7)];
        }
        corners[0][n] = pair_at(depths), corners[1][n] = pair_at(depths + 2);
    }
}

static inline Floats depth_on_slice(const SunColumns *sun, const Floats *position, Floats ahead, Ints number) {
    Pairs corners[2];
    Floats fraction[2];
    columns_around(sun, position, ahead, number, corners, fraction);
    return lerp_lanes(lerp_pairs(corners[0], fraction[1]), lerp_pairs(corners[1], fraction[1]), fraction[0]);
}

static inline Floats lowest_on_slice(const SunColumns *sun, const Floats *position, Floats ahead, Ints number) {
    Pairs corners[2];
    Floats fraction[2];
    columns_around(sun, position, ahead, number, corners, fraction);
    return least_of(least_of(first_of(corners[0]), second_of(corners[0])),
                    least_of(first_of(corners[1]), second_of(corners[1])));
}

/* Integrals of the density along the sun's rays from positions to the next slice, `way` slices on. */
static inline Floats integral_to_slice(const Grid *grid, const SunColumns *sun, const Floats *start, Floats way) {
    Floats cuts[4] = {in_all(0.0f), way, way, way}, total = in_all(0.0f);
    for (int k = 0; k < 2 && sun->steep; k++) {
        int64_t axis = sun->others[k];
        float slope = (float)sun->move[axis];
        if (slope != 0.0f) {
            Floats at = clamped_to(start[axis], in_all(-FAR_AWAY), in_all(FAR_AWAY));
            Floats plane = slope > 0.0f ? to_floats(floors(at)) + 1.0f : -to_floats(floors(-at)) - 1.0f;
            cuts[1 + k] = least_of((plane - start[axis]) / slope, way);
        }
    }
    Floats swapped = cuts[1];
    Ints wrong = cuts[1] > cuts[2];
    cuts[1] = choose(wrong, cuts[2], cuts[1]), cuts[2] = choose(wrong, swapped, cuts[2]);
    for (int piece = 0; piece < (sun->steep ? 3 : 1); piece++) {
        Floats length = cuts[piece + 1] - cuts[piece];
        for (int node = 0; node < 2; node++) {
            /* The nodes of Gauss and Legendre in [0, 1]. */
            float node_position = node ? 0.78867513459481287f : 0.21132486540518713f;
            Floats position[3];
            for (int axis = 0; axis < 3; axis++) {
                position[axis] = start[axis] + (cuts[piece] + node_position * length) * (float)sun->move[axis] - 1.0f;
            }
            total = total + choose(length > 0.0f, sample_grid(grid, position) * length, in_all(0.0f));
        }
    }
    return total * (0.5f * (float)sun->length);
}

/* Depths that integrate the first slices and take the columns from there on, where `wanted`. */
static inline Floats integrated_depth(const Grid *grid, const SunColumns *sun, const Floats *position, Floats way,
                                      Ints following, float extinction, Ints wanted) {
    float deepest = (float)sun->deepest;
    Floats depth = in_all(0.0f), start[3] = {position[0], position[1], position[2]};
    for (int64_t k = 0; k < sun->integrated; k++) {
        Floats gained = integral_to_slice(grid, sun, start, way) * extinction;
        depth = depth + choose(wanted, gained, in_all(0.0f));
        Ints past = {0};
        for (int axis = 0; axis < 3; axis++) {
            float move = (float)sun->move[axis];
            start[axis] = start[axis] + way * move;
            /* A ray that starts on a face by which the sun's rays enter has not left the grid. */
            past |= move > 0.0f ? start[axis] >= (float)(grid->shape[axis] + 1) : start[axis] <= 0.0f;
        }
        wanted &= ~past & (depth < deepest);
        if (!any_lane(wanted)) return depth;
        way = in_all(1.0f);
    }
    Ints last = following + (int32_t)(sun->step * (sun->integrated - 1));
    return depth + choose(wanted, depth_on_slice(sun, start, in_all(0.0f), last) * extinction, in_all(0.0f));
}

/* Optical depths towards the sun at continuous indices.

camera_depth: optical depth between the points and the camera. */
static inline Floats sun_depth(const Grid *density, const SunColumns *sun, float extinction, const Floats *position,
                               Floats camera_depth) {
    float deepest = (float)sun->deepest;
    Floats padded[3] = {position[0] + 1.0f, position[1] + 1.0f, position[2] + 1.0f}, depth;
    Floats along = clamped_to(padded[sun->main], in_all(-FAR_AWAY), in_all(FAR_AWAY));
    Ints below = floors(along), following = below + (sun->step > 0), wanted;
    Floats ahead = sun->step > 0 ? to_floats(below) + 1.0f - along : along - to_floats(below);
    if (!sun->everywhere) {
        Floats after = depth_on_slice(sun, padded, ahead, following);
        Floats before = depth_on_slice(sun, padded, ahead - 1.0f, following - (int32_t)sun->step);
        depth = lerp_lanes(after, before, ahead) * extinction;
        wanted = (depth > 0.0f) & (depth + camera_depth < (float)sun->visible);
    } else {
        int32_t last = (int32_t)sun->integrated - 1;
        depth = lowest_on_slice(sun, padded, ahead + (float)last, following + (int32_t)sun->step * last) * extinction;
        wanted = depth < deepest;
    }
    if (!sun->integrated || !any_lane(wanted)) return depth;
    return choose(wanted, integrated_depth(density, sun, padded, ahead, following, extinction, wanted), depth);
}

/* As sun_depth, for points that may lie outside the support: moved towards the sun onto it, 0 where the ray misses. */
static inline Floats sun_depth_outside(const Grid *density, const SunColumns *sun, float extinction,
                                       const Floats *position, Floats camera_depth) {
    Floats moved[3];
    Ints met;
    FOR_LANES(n) {
        double near = 0.0, far = INFINITY;
        for (int axis = 0; axis < 3; axis++) {
            double at = position[axis][n], inverse = 1.0 / sun->direction[axis];
            double a = (-1.0 - at) * inverse, b = ((double)density->shape[axis] - at) * inverse;
            /* A ray within the plane of a face divides 0 by 0; that axis does not bound it. */
            if (a != a || b != b) continue;
            near = a < b ? (a > near ? a : near) : (b > near ? b : near);
            far = a < b ? (b < far ? b : far) : (a < far ? a : far);
        }
        met[n] = far > near ? -1 : 0;
        for (int axis = 0; axis < 3; axis++) moved[axis][n] = (float)(position[axis][n] + near * sun->direction[axis]);
    }
    return choose(met, sun_depth(density, sun, extinction, moved, camera_depth), in_all(0.0f));
}

/* As one of the above, at indices of the volume's grid; outside: whether points may lie outside the support. */
static inline Floats volume_sun_depth(const Grid *density, const SunColumns *sun, float extinction,
                                      const Floats *position, Floats camera_depth, int outside) {
    Floats larger[3];
    if (sun->octaves) {
        float edge = (float)((int64_t)1 << (sun->octaves & 31)), middle = 0.5f * (edge - 1.0f);
        for (int axis = 0; axis < 3; axis++) larger[axis] = (position[axis] - middle) / edge;
        density = &sun->density, position = larger;
    }
    return outside ? sun_depth_outside(density, sun, extinction, position, camera_depth)
                   : sun_depth(density, sun, extinction, position, camera_depth);
}

/* Visibility of a sun from 0 to 1 by percentage-closer filtering; position: column, row, height. */
static inline float visibility_of(const ShadowMap *map, const float *position) {
    float column = clamped(position[0], -FAR_AWAY, FAR_AWAY), row = clamped(position[1], -FAR_AWAY, FAR_AWAY);
    int32_t left = floor_of(column), low = floor_of(row);
    float right_part = column - (float)left, up_part = row - (float)low, visibility = 0.0f;
    for (int n = 0; n < 4; n++) {
        int64_t i = within((int64_t)left + (n >> 1), map->columns - 1), j = within((int64_t)low + (n & 1), map->rows - 1);
        float weight = (n >> 1 ? right_part : 1.0f - right_part) * (n & 1 ? up_part : 1.0f - up_part);
        if (position[2] >= map->heights[j * map->columns + i]) visibility += weight;
    }
    return visibility;
}

#endif
