/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Samples of grids and of optical depths towards suns; the twins are DenseGrid, SparseGrid and SunOpticalDepth. */

#ifndef MRPNN_SAMPLING_H
#define MRPNN_SAMPLING_H

#include "exponential.h"
#include "kernels.h"

/* Further from 0 than any index, and still a whole number in both types. */
#define FAR_AWAY 1073741824.0f

static inline float lerp(float low, float high, float fraction) {
    return (high - low) * fraction + low;
}

static inline float least(float a, float b) { return a < b ? a : b; }

static inline int64_t within(int64_t n, int64_t last) {
    return n < 0 ? 0 : n > last ? last : n;
}

/* The largest whole number that is not above x, for |x| <= FAR_AWAY. */
static inline int32_t floor_of(float x) {
    int32_t n = (int32_t)x;
    return n - ((float)n > x);
}

static inline float sample_dense(const Grid *grid, float x, float y, float z) {
    x = clamped(x + 1.0f, 0.0f, (float)(grid->size[0] - 2));
    y = clamped(y + 1.0f, 0.0f, (float)(grid->size[1] - 2));
    z = clamped(z + 1.0f, 0.0f, (float)(grid->size[2] - 2));
    int32_t i = (int32_t)x, j = (int32_t)y, k = (int32_t)z;
    float fx = x - (float)i, fy = y - (float)j, fz = z - (float)k;
    int64_t row = grid->size[2], slab = row * grid->size[1];
    const float *at = grid->values + (i * slab + j * row + k);
    float y0 = lerp(lerp(at[0], at[1], fz), lerp(at[row], at[row + 1], fz), fy);
    at += slab;
    float y1 = lerp(lerp(at[0], at[1], fz), lerp(at[row], at[row + 1], fz), fy);
    return lerp(y0, y1, fx);
}

/* Row of `values` that holds a block; 0 for what no row can be. */
static inline int64_t block_row(const Grid *grid, int64_t block) {
    int32_t row = grid->table[block];
    return (uint64_t)(int64_t)row < (uint64_t)grid->rows ? row : 0;
}

static inline float sample_sparse(const Grid *grid, const float *position) {
    int32_t cell[3];
    float part[3];
    for (int axis = 0; axis < 3; axis++) {
        float at = clamped(position[axis], -1.0f, (float)grid->shape[axis]) + (float)grid->first[axis];
        cell[axis] = (int32_t)at;
        part[axis] = at - (float)cell[axis];
    }
    int64_t block = ((int64_t)(cell[0] >> 3) * grid->size[1] + (cell[1] >> 3)) * grid->size[2] + (cell[2] >> 3);
    int32_t inner[3] = {cell[0] & 7, cell[1] & 7, cell[2] & 7};
    float corner[8];
    if (inner[0] < 7 && inner[1] < 7 && inner[2] < 7) {
        int64_t row = block_row(grid, block);
        if (row == 0) return 0.0f;
        const float *at = grid->values + row * 512 + (inner[0] * 64 + inner[1] * 8 + inner[2]);
        corner[0] = at[0], corner[1] = at[1], corner[2] = at[8], corner[3] = at[9];
        corner[4] = at[64], corner[5] = at[65], corner[6] = at[72], corner[7] = at[73];
    } else {
        for (int n = 0; n < 8; n++) {
            int32_t x = inner[0] + (n >> 2), y = inner[1] + ((n >> 1) & 1), z = inner[2] + (n & 1);
            int64_t next = block + ((x >> 3) * grid->size[1] + (y >> 3)) * grid->size[2] + (z >> 3);
            corner[n] = grid->values[block_row(grid, next) * 512 + ((x & 7) * 64 + (y & 7) * 8 + (z & 7))];
        }
    }
    float y0 = lerp(lerp(corner[0], corner[1], part[2]), lerp(corner[2], corner[3], part[2]), part[1]);
    float y1 = lerp(lerp(corner[4], corner[5], part[2]), lerp(corner[6], corner[7], part[2]), part[1]);
    return lerp(y0, y1, part[0]);
}

/* Value at a continuous index. */
static inline float sample_grid(const Grid *grid, const float *position) {
    return grid->table ? sample_sparse(grid, position) : sample_dense(grid, position[0], position[1], position[2]);
}

static inline int may_hold(const Occupancy *cells, const float *position) {
    int64_t base = 0;
    for (int axis = 0; axis < 3; axis++) {
        float cell = (position[axis] + (float)cells->first[axis]) * (float)cells->scale;
        base = base * cells->size[axis] + (int32_t)clamped(cell, 0.0f, (float)(cells->size[axis] - 1));
    }
    return cells->filled[base];
}

/* Depths of the four columns around a point where its ray towards the sun meets a slice, and the point among them.

place: in the padded grid. ahead: slices from there to the slice. number: of the slice. */
static inline void columns_around(const SunColumns *sun, const float *place, float ahead, int32_t number,
                                  float *corner, float *part) {
    int64_t slice = within(number + sun->first, sun->slices - 1);
    int32_t cell[2];
    for (int n = 0; n < 2; n++) {
        int64_t axis = sun->others[n];
        float at = ahead * (float)sun->move[axis] + place[axis] + sun->offsets[2 * slice + n];
        at = clamped(at, 0.0f, (float)(sun->size[n] - 1));
        cell[n] = (int32_t)at;
        if (cell[n] > sun->size[n] - 2) cell[n] = (int32_t)(sun->size[n] - 2);
        part[n] = at - (float)cell[n];
    }
    if (!sun->table) {
        const float *at = sun->depths + ((slice * sun->size[0] + cell[0]) * sun->size[1] + cell[1]);
        corner[0] = at[0], corner[1] = at[1], corner[2] = at[sun->size[1]], corner[3] = at[sun->size[1] + 1];
        return;
    }
    int64_t row = (slice >> 3) * (sun->size[0] >> 3);
    for (int n = 0; n < 4; n++) {
        int32_t b = cell[0] + (n >> 1), c = cell[1] + (n & 1);
        int32_t entry = sun->table[(row + (b >> 3)) * (sun->size[1] >> 3) + (c >> 3)];
        int64_t tile = (int64_t)(entry >> 1) + (entry & 1 ? slice & 7 : 0);
        if ((uint64_t)tile >= (uint64_t)sun->tiles) tile = 0;
        corner[n] = sun->depths[tile * 64 + (b & 7) * 8 + (c & 7)];
    }
}

static inline float depth_on_slice(const SunColumns *sun, const float *place, float ahead, int32_t number) {
    float corner[4], part[2];
    columns_around(sun, place, ahead, number, corner, part);
    return lerp(lerp(corner[0], corner[1], part[1]), lerp(corner[2], corner[3], part[1]), part[0]);
}

static inline float lowest_on_slice(const SunColumns *sun, const float *place, float ahead, int32_t number) {
    float corner[4], part[2];
    columns_around(sun, place, ahead, number, corner, part);
    return least(least(corner[0], corner[1]), least(corner[2], corner[3]));
}

/* Integral of the density along the sun's ray from a position to the next slice, `way` slices on. */
static inline float integral_to_slice(const Grid *grid, const SunColumns *sun, const float *start, float way) {
    float cuts[4] = {0.0f, way, way, way};
    for (int n = 0; n < 2 && sun->steep; n++) {
        int64_t axis = sun->others[n];
        float slope = (float)sun->move[axis];
        if (slope != 0.0f) {
            float at = clamped(start[axis], -FAR_AWAY, FAR_AWAY);
            float plane = slope > 0.0f ? (float)floor_of(at) + 1.0f : -(float)floor_of(-at) - 1.0f;
            cuts[1 + n] = least((plane - start[axis]) / slope, way);
        }
    }
    if (cuts[1] > cuts[2]) {
        float swapped = cuts[1];
        cuts[1] = cuts[2], cuts[2] = swapped;
    }
    float total = 0.0f;
    for (int n = 0; n < 3; n++) {
        float length = cuts[n + 1] - cuts[n];
        if (!(length > 0.0f)) continue;
        for (int node = 0; node < 2; node++) {
            /* The nodes of Gauss and Legendre in [0, 1]. */
            float share = node ? 0.78867513459481287f : 0.21132486540518713f, place[3];
            for (int axis = 0; axis < 3; axis++) {
                place[axis] = start[axis] + (cuts[n] + share * length) * (float)sun->move[axis] - 1.0f;
            }
            total += sample_grid(grid, place) * length;
        }
    }
    return total * (0.5f * (float)sun->length);
}

/* Depth that integrates the first slices and takes the columns from there on. */
static inline float integrated_depth(const Grid *grid, const SunColumns *sun, const float *place, float way,
                                     int32_t following, float extinction, float max_depth) {
    float depth = 0.0f, start[3] = {place[0], place[1], place[2]};
    for (int64_t n = 0; n < sun->integrated; n++) {
        depth += integral_to_slice(grid, sun, start, way) * extinction;
        int past = 0;
        for (int axis = 0; axis < 3; axis++) {
            float move = (float)sun->move[axis];
            start[axis] = start[axis] + way * move;
            /* A ray that starts on a face by which the sun's rays enter has not left the grid. */
            past |= move > 0.0f ? start[axis] >= (float)(grid->shape[axis] + 1) : start[axis] <= 0.0f;
        }
        if (past || !(depth < max_depth)) return depth;
        way = 1.0f;
    }
    int32_t last = following + (int32_t)(sun->step * (sun->integrated - 1));
    return depth + depth_on_slice(sun, start, 0.0f, last) * extinction;
}

/* Optical depth towards the sun at a continuous index.

camera_depth: optical depth between the point and the camera. */
static inline float sun_depth(const Scene *scene, const Medium *medium, const SunColumns *sun, const float *position,
                              float camera_depth) {
    float extinction = (float)medium->sigma_t;
    float place[3] = {position[0] + 1.0f, position[1] + 1.0f, position[2] + 1.0f};
    float along = clamped(place[sun->main], -FAR_AWAY, FAR_AWAY);
    int32_t below = floor_of(along), following = below + (sun->step > 0);
    float ahead = sun->step > 0 ? (float)below + 1.0f - along : along - (float)below;
    if (!sun->everywhere) {
        float after = depth_on_slice(sun, place, ahead, following);
        float before = depth_on_slice(sun, place, ahead - 1.0f, following - (int32_t)sun->step);
        float depth = lerp(after, before, ahead) * extinction;
        if (!sun->integrated || !(depth > 0.0f && depth + camera_depth < (float)scene->visible)) return depth;
    } else {
        int32_t last = (int32_t)sun->integrated - 1;
        float depth = lowest_on_slice(sun, place, ahead + (float)last, following + (int32_t)sun->step * last);
        depth *= extinction;
        if (!(depth < (float)scene->max_sun_depth)) return depth;
    }
    return integrated_depth(&medium->density, sun, place, ahead, following, extinction, (float)scene->max_sun_depth);
}

/* As sun_depth, for points that may lie outside the support: moved towards the sun onto it, 0 where the ray misses. */
static inline float sun_depth_outside(const Scene *scene, const Medium *medium, const SunColumns *sun,
                                      const float *position, float camera_depth) {
    double near = 0.0, far = INFINITY;
    for (int axis = 0; axis < 3; axis++) {
        double inverse = 1.0 / sun->direction[axis];
        double a = (-1.0 - position[axis]) * inverse, b = (medium->density.shape[axis] - (double)position[axis]) * inverse;
        /* A ray within the plane of a face divides 0 by 0; that axis does not bound it. */
        if (a != a || b != b) continue;
        near = a < b ? (a > near ? a : near) : (b > near ? b : near);
        far = a < b ? (b < far ? b : far) : (a < far ? a : far);
    }
    if (!(far > near)) return 0.0f;
    float moved[3];
    for (int axis = 0; axis < 3; axis++) moved[axis] = (float)(position[axis] + near * sun->direction[axis]);
    return sun_depth(scene, medium, sun, moved, camera_depth);
}

/* Visibility of a sun from 0 to 1 by percentage-closer filtering; position: column, row, height. */
static inline float visibility_of(const ShadowMap *map, const float *position) {
    float column = clamped(position[0], -FAR_AWAY, FAR_AWAY), row = clamped(position[1], -FAR_AWAY, FAR_AWAY);
    int32_t left = floor_of(column), low = floor_of(row);
    float right_part = column - (float)left, up_part = row - (float)low, share = 0.0f;
    for (int n = 0; n < 4; n++) {
        int64_t i = within((int64_t)left + (n >> 1), map->columns - 1), j = within((int64_t)low + (n & 1), map->rows - 1);
        float weight = (n >> 1 ? right_part : 1.0f - right_part) * (n & 1 ? up_part : 1.0f - up_part);
        if (position[2] >= map->heights[j * map->columns + i]) share += weight;
    }
    return share;
}

/* A number of half precision. */
static inline float half_value(uint16_t bits) {
    uint32_t magnitude = bits & 0x7fffu, sign = (uint32_t)(bits & 0x8000u) << 16;
    uint32_t shifted = magnitude << 13;
    float value;
    memcpy(&value, &shifted, sizeof value);
    value *= 0x1p112f;
    uint32_t found;
    memcpy(&found, &value, sizeof found);
    if (magnitude >= 0x7c00u) found = shifted | 0x7f800000u;
    found |= sign;
    memcpy(&value, &found, sizeof value);
    return value;
}

#endif
