/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Light paths traced from camera rays until they leave all volumes: inference/marching/light_paths.py explains
them. */

#include <math.h>

#include "fields.h"
#include "random.h"
#include "variants.h"

/* Steps of a sequence of low discrepancy in two dimensions (Roberts, "The Unreasonable Effectiveness of Quasirandom
Sequences", 2018), which the first directions of a ray's paths follow. */
#define PLASTIC_X 0.7548776662466927
#define PLASTIC_Y 0.5698402909980532

/* Fate of a path. */
enum { MISSED, LEFT, GIVEN_UP };

typedef struct {
    double place[3], along[3];
} Way;

/* Random numbers of a path, and how many more steps it may take. */
typedef struct {
    uint64_t state;
    int64_t left;
} Steps;

/* A volume's voxel at indices from -1 to its shape. */
static float voxel(const Grid *grid, const int64_t *index) {
    int64_t at[3];
    for (int k = 0; k < 3; k++) {
        int64_t last = (grid->table ? 8 * grid->size[k] : grid->size[k]) - 1, n = index[k] + (grid->table ? grid->first[k] : 1);
        at[k] = n < 0 ? 0 : n > last ? last : n;
    }
    if (!grid->table) return grid->values[(at[0] * grid->size[1] + at[1]) * grid->size[2] + at[2]];
    int64_t block = ((at[0] >> 3) * grid->size[1] + (at[1] >> 3)) * grid->size[2] + (at[2] >> 3), row = grid->table[block];
    if ((uint64_t)row >= (uint64_t)grid->rows) row = 0;
    return grid->values[row * 512 + (at[0] & 7) * 64 + (at[1] & 7) * 8 + (at[2] & 7)];
}

/* One of the eight voxels around a continuous index, chosen with its weight in the interpolation. */
static void voxel_around(const double *index, uint64_t *state, int64_t *voxel) {
    uint64_t bits = draw_bits(state);
    for (int k = 0; k < 3; k++) {
        double moved = index[k] + (double)(bits & 0x1FFFFF) * 0x1p-21;
        /* Within the support, but for rounding. */
        moved = moved > -2.0 ? moved < 1e9 ? moved : 1e9 : -2.0;
        voxel[k] = (int64_t)floor(moved);
        bits >>= 21;
    }
}

/* Fly through one volume; returns the distance at which the path collides first, and sets the voxel there, or `to`. */
static double fly(const Medium *medium, const Occupancy *cells, const Way *way, double from, double to, Steps *steps, int64_t *hit) {
    double start[3], move[3], inverse[3], end = to;
    for (int k = 0; k < 3; k++) {
        const double *row = medium->linear + 3 * k;
        start[k] = row[0] * way->place[0] + row[1] * way->place[1] + row[2] * way->place[2] + medium->offset[k];
        move[k] = row[0] * way->along[0] + row[1] * way->along[1] + row[2] * way->along[2];
        inverse[k] = fabs(move[k]) > 1e-30 ? 1.0 / move[k] : 0.0;
        double low = -1.0, high = (double)medium->density.shape[k];
        if (inverse[k] == 0.0) {
            if (!(start[k] > low && start[k] < high)) return to;
            continue;
        }
        double near = ((move[k] > 0.0 ? low : high) - start[k]) * inverse[k], far = ((move[k] > 0.0 ? high : low) - start[k]) * inverse[k];
        if (near > from) from = near;
        if (far < end) end = far;
    }
    if (!(from < end)) return to;
    double fastest = fmax(fabs(move[0]), fmax(fabs(move[1]), fabs(move[2])));
    /* Past the face of a cell by a small part of a voxel. */
    double past = 1e-5 / fastest, at = from, need = -log(1.0 - draw(&steps->state));
    double in_cells[3], faces[3], last[3];
    for (int k = 0; k < 3; k++) {
        in_cells[k] = (start[k] + cells->first[k]) * cells->scale;
        faces[k] = inverse[k] / cells->scale, last[k] = (double)(cells->size[k] - 1);
    }
    while (at < end) {
        double face = end;
        int64_t number = 0;
        for (int k = 0; k < 3; k++) {
            double where = in_cells[k] + at * move[k] * cells->scale;
            int64_t cell = where > 0.0 ? (int64_t)(where < last[k] ? where : last[k]) : 0;
            double distance = ((double)(cell + (move[k] > 0.0)) - in_cells[k]) * faces[k];
            /* The outermost cells reach to the end. */
            if (distance < face && distance > at) face = distance;
            number = number * cells->size[k] + cell;
        }
        face = face + past < end ? face + past : end;
        double bound = medium->sigma_t * (double)cells->peaks[number];
        for (;;) {
            if (steps->left-- <= 0) return to;
            double supply = (face - at) * bound;
            if (!(need < supply)) {
                need -= supply, at = face;
                break;
            }
            at += need / bound;
            double index[3];
            for (int k = 0; k < 3; k++) index[k] = start[k] + at * move[k];
            voxel_around(index, &steps->state, hit);
            if (draw(&steps->state) * bound < medium->sigma_t * (double)voxel(&medium->density, hit)) return at;
            need = -log(1.0 - draw(&steps->state));
        }
    }
    return to;
}

/* Most boxes that wait to be looked at: two for each doubling of the volumes. */
#define WAITING 128

/* Whether a path meets a box between two distances. */
static int meets_box(const double *box, const Way *way, double from, double to) {
    for (int k = 0; k < 3; k++) {
        double inverse = 1.0 / way->along[k], a = (box[k] - way->place[k]) * inverse, b = (box[3 + k] - way->place[k]) * inverse;
        /* A path within the plane of a face multiplies 0 by infinity; that axis does not bound it. */
        if (a != a || b != b) continue;
        if ((a < b ? a : b) > from) from = a < b ? a : b;
        if ((a > b ? a : b) < to) to = a > b ? a : b;
    }
    return from <= to;
}

/* Fly on; returns the number of the volume in which the path collides, or -1, and moves the path there. */
static int64_t collide(const LightPaths *data, Way *way, double from, double to, Steps *steps, int64_t *hit) {
    int64_t nearest = -1, voxel[3], waiting[WAITING] = {1}, count = 1;
    while (count > 0) {
        int64_t box = waiting[--count];
        if (data->leaves > 1 && !meets_box(data->boxes + 6 * box, way, from, to)) continue;
        if (box < data->leaves) {
            waiting[count++] = 2 * box + 1, waiting[count++] = 2 * box;
            continue;
        }
        int64_t v = data->contents[box - data->leaves];
        if (v < 0) continue;
        double distance = fly(data->media + v, data->majorants + v, way, from, to, steps, voxel);
        if (!(distance < to)) continue;
        to = distance, nearest = v;
        for (int k = 0; k < 3; k++) hit[k] = voxel[k];
    }
    if (nearest >= 0) {
        for (int k = 0; k < 3; k++) way->place[k] += to * way->along[k];
    }
    return nearest;
}

/* Multiply a path's light by the albedo at a collision; returns its largest channel. */
static double attenuate(const LightPaths *data, int64_t volume, const int64_t *hit, float *light) {
    const Medium *medium = data->media + volume;
    double most = 0.0;
    for (int64_t c = 0; c < data->channels; c++) {
        double albedo = data->albedos[volume * data->channels + c];
        if (medium->varies) albedo *= (double)voxel(medium->scattering + c, hit) / (double)voxel(&medium->density, hit);
        light[c] = (float)(light[c] * albedo);
        most = light[c] > most ? light[c] : most;
    }
    return most;
}

/* Follow a path to its end, which is returned; numbers: of the first scattering. */
static int follow(const LightPaths *data, int64_t ray, Steps *steps, double *numbers, float *light, float *leaving) {
    Way way;
    for (int k = 0; k < 3; k++) way.place[k] = data->origins[3 * ray + k], way.along[k] = data->directions[3 * ray + k];
    int64_t hit[3], volume = collide(data, &way, data->near_distance[ray], data->far_distance[ray], steps, hit);
    for (int64_t c = 0; c < data->channels; c++) light[c] = volume < 0 ? 0.0f : 1.0f;
    if (volume < 0) return MISSED;
    for (int64_t n = 0; n < data->collisions; n++) {
        double most = attenuate(data, volume, hit, light);
        if (!(most > data->negligible)) {
            for (int64_t c = 0; c < data->channels; c++) light[c] = 0.0f;
            return LEFT;
        }
        if (n > 0) numbers[0] = draw(&steps->state), numbers[1] = draw(&steps->state);
        turn(scattering_cosine(data->anisotropies[volume], numbers[0]), 6.283185307179586 * numbers[1], way.along);
        for (int k = 0; k < 3; k++) leaving[k] = (float)way.along[k];
        volume = collide(data, &way, 0.0, INFINITY, steps, hit);
        if (volume < 0) return steps->left > 0 ? LEFT : GIVEN_UP;
    }
    return GIVEN_UP;
}

int64_t NAMED(trace_paths, VARIANT)(const LightPaths *data) {
    for (int64_t ray = 0; ray < data->rays; ray++) {
        uint64_t number = (uint64_t)data->numbers[ray], state = seeded(~number);
        double shift[2];
        for (int k = 0; k < 2; k++) shift[k] = draw(&state);
        for (int64_t n = 0; n < data->paths; n++) {
            int64_t path = ray * data->paths + n;
            Steps steps = {seeded(number * (uint64_t)data->paths + (uint64_t)n), data->steps};
            double numbers[2] = {shift[0] + (double)n * PLASTIC_X, shift[1] + (double)n * PLASTIC_Y};
            for (int k = 0; k < 2; k++) numbers[k] -= floor(numbers[k]);
            float *leaving = data->leaving + 3 * path;
            for (int k = 0; k < 3; k++) leaving[k] = 0.0f;
            data->ends[path] = (uint8_t)follow(data, ray, &steps, numbers, data->light + data->channels * path, leaving);
        }
        if (data->stop && *data->stop) return ray;
    }
    return data->rays;
}
