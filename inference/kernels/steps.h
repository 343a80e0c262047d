/* SPDX-License-Identifier: GPL-3.0-or-later */
/* A camera ray cut into steps, which come in blocks of equal steps: blocks without density are skipped, dense blocks
are cut into smaller blocks. The result are arrays over the steps of a ray. A place on a ray is a number of its coarse
steps. */

#ifndef MRPNN_STEPS_H
#define MRPNN_STEPS_H

#include <math.h>

#include "kernels.h"
#include "sampling.h"

/* Steps per block, points per step at which density is sampled, and columns of the ray features. */
#define STEPS 4
#define SAMPLES 2
#define INTEGRALS 5
#define COLUMNS (2 + INTEGRALS)

/* How often a block may be cut, and into how many at a time. */
#define LEVELS 7
#define MOST_PARTS 8

/* Volumes up to which scratch memory is for all of them, whether a ray meets them or not. */
#define FEW 8

/* Coarse blocks that are sampled together, for instruction-level parallelism, even if the ray ends in front of some. An
even number. */
#define AHEAD 8

/* One number per step of a block. */
typedef float Steps __attribute__((vector_size(4 * STEPS)));

/* A ray as continuous indices into some frame: first + place * slope. */
typedef struct {
    double first[3], slope[3];
    double blocks_per_cell;  /* coarse blocks, by the axis along which cells of density follow each other fastest */
    const double *linear;    /* of the frame */
    const float *shifts;     /* (last + 1, 3), in the world at whole places, linear in between; NULL: it is straight */
    int64_t last;
    double reach;            /* cells that shifts are long at most along an axis */
} Line;

/* One ray between two distances. */
typedef struct {
    const double *origin, *direction;
    double near;
    int64_t count;  /* coarse steps, and their length */
    double dt;
    int64_t eye;    /* or -1 */
    double moved[6];  /* what origin and direction of a ray in a volume's own frame are kept in */
} Ray;

/* Scratch memory for one ray of up to `most_blocks` blocks; those of coarse blocks that are looked at ahead follow them. */
typedef struct {
    int64_t most_blocks, most_met;
    int64_t stride;              /* steps of all of these */
    int64_t blocks;
    int64_t looked_at;           /* blocks, also those that are not kept */
    double *place, *size;        /* (blocks), where each block begins, and the size of its steps */
    float *dt;                   /* (steps), length */
    double *before;              /* (blocks + 1), optical depth from the ray's start */
    float *sigma;                /* (met, steps), extinction */
    float *scattering;           /* (scattering, met, steps), of volumes whose albedo varies */
    float *total, *tau, *within; /* (steps), of all volumes; within: from the block's start to the step's end */
    float *far;                  /* (blocks), transmitted to the block's start */
    float *transmitted;          /* (steps), to the step's start */
    float *start, *end;          /* (groups met, steps) each, optical depth of a group towards a light at the ends of steps */
    float *whole_start, *whole_end;  /* (steps), of all volumes; those of the group if there is one alone */
    float *visible;              /* (steps) */
    float *source;               /* (steps), scattered light */
    float *mean_start, *mean_end;  /* (groups met, steps), mean transmittance towards the emitters of a lamp */
    float *fluence, *reference;  /* (steps), unattenuated, of a lamp, and reference_of it for ray features */
    float *lit, *received;       /* (steps), fraction of it that surfaces let through, and fluence on a coarse scale */
    int64_t nodes;               /* ends of blocks; the end that two blocks share counts once */
    double *node_place;          /* (steps; at most twice as many as blocks), where they are on the ray */
    int32_t *first_node;         /* (blocks), at the start of each block; the node at its end is the next */
    float *node_light;           /* (met, steps), light of a lamp that each volume scatters towards the camera */
    float *node_fluence, *node_reference;  /* (steps), as `fluence` and `reference` */
    float *group_tau;            /* (groups met, steps) */
    float *light;                /* (steps) */
    double *edge_place;          /* (5 blocks), edges of steps to look up: place on the ray, depth from the camera */
    float *edge_depth;
    int32_t *edge_from, *edge_to;   /* (5 blocks), the step that begins and the step that ends there, or -1 */
    int32_t *listed;             /* (5 blocks), numbers of edges whose optical depths are looked up, ascending */
    int64_t lit_from, lit_to;    /* steps that the light at hand may reach; whole lanes, so that lit_to may lie behind */
    Line *lines;                 /* (volumes) */
    float *shifts;               /* (volumes, shift_stride), of lines */
    int64_t shift_stride;
    int64_t *met;                /* (met_count), volumes whose support the ray meets */
    int64_t *active;             /* (active_count), groups with volumes that it meets or that may shadow these */
    int64_t *rows, *group_rows;  /* (volumes) and (groups), where the steps of those that are met begin */
    int64_t met_count, active_count;
    uint8_t *is_met, *shades;    /* (volumes), whether the ray meets each, and whether it may shadow points of the ray */
    uint8_t *group_met;          /* (groups), whether the ray meets any of its volumes */
    int64_t *cells;              /* (met, LANES), around blocks that follow each other */
    uint8_t *near;               /* (AHEAD + 1, met), whether a volume may hold something in a block; 2: no density */
    int64_t *sample_step;        /* (depth samples), among the steps above */
    float *sample_inside;        /* (depth samples), position in the step */
    float *sample_light;         /* (depth samples), fluence of a lamp on a coarse scale */
} Work;

static inline Line line_in(const double *linear, const double *offset, const Ray *ray) {
    Line line;
    for (int i = 0; i < 3; i++) {
        double start = 0.0, slope = 0.0;
        for (int j = 0; j < 3; j++) {
            start += linear[3 * i + j] * (ray->origin[j] + ray->near * ray->direction[j]);
            slope += linear[3 * i + j] * ray->direction[j];
        }
        line.first[i] = start + offset[i];
        line.slope[i] = slope * ray->dt;
    }
    line.blocks_per_cell = line.reach = 0.0;
    line.linear = linear, line.shifts = NULL, line.last = 0;
    return line;
}

/* A ray as a volume meets it that is moved back to where it is at the frame; distances along the ray stay. */
static inline const Ray *ray_of(const Medium *medium, const Ray *ray, Ray *moved) {
    if (!medium->motion || ray->eye < 0) return ray;
    const double *frame = medium->motion + 12 * ray->eye;
    *moved = *ray;
    for (int i = 0; i < 3; i++) {
        moved->moved[i] = frame[4 * i + 3], moved->moved[3 + i] = 0.0;
        for (int j = 0; j < 3; j++) {
            moved->moved[i] += frame[4 * i + j] * ray->origin[j];
            moved->moved[3 + i] += frame[4 * i + j] * ray->direction[j];
        }
    }
    moved->origin = moved->moved, moved->direction = moved->moved + 3;
    return moved;
}

/* The line through a volume, whose cells it passes. */
static inline Line line_through(const Medium *medium, const Ray *ray) {
    Ray moved;
    Line line = line_in(medium->linear, medium->offset, ray_of(medium, ray, &moved));
    double x = fabs(line.slope[0]), y = fabs(line.slope[1]), z = fabs(line.slope[2]);
    line.blocks_per_cell = 1.0 / ((x > y ? (x > z ? x : z) : (y > z ? y : z)) * medium->occupancy.scale * STEPS);
    return line;
}

/* Where a straight line is. */
static inline void position_at(const Line *line, double place, float *position) {
    for (int axis = 0; axis < 3; axis++) position[axis] = (float)(place * line->slope[axis] + line->first[axis]);
}

/* Where LANES places of a line would be if it were straight. */
static inline void straight_at(const Line *line, const double *places, Floats *position) {
    Doubles place;
    memcpy(&place, places, sizeof place);
    for (int axis = 0; axis < 3; axis++) {
        position[axis] = __builtin_convertvector(place * line->slope[axis] + line->first[axis], Floats);
    }
}

/* Shift positions on a line that is not straight. */
static inline void shift_positions(const Line *line, const double *places, Floats *position) {
    Floats shift[3];
    FOR_LANES(n) {
        double last = (double)line->last, place = places[n] > 0.0 ? places[n] < last ? places[n] : last : 0.0;
        int64_t node = least_int((int64_t)place, line->last - 1);
        float fraction = (float)(place - (double)node);
        const float *from = line->shifts + 3 * node;
        for (int k = 0; k < 3; k++) shift[k][n] = from[k] + fraction * (from[3 + k] - from[k]);
    }
    for (int k = 0; k < 3; k++) {
        const double *row = line->linear + 3 * k;
        position[k] += (float)row[0] * shift[0] + (float)row[1] * shift[1] + (float)row[2] * shift[2];
    }
}

/* Positions at LANES places of a line. */
static inline void positions_at(const Line *line, const double *places, Floats *position) {
    straight_at(line, places, position);
    if (line->shifts) shift_positions(line, places, position);
}

/* Positions of the samples of one block: SAMPLES for each of STEPS steps. */
static inline void positions_in_block(const Line *line, double place, double size, Floats *position) {
    const Floats samples = {0.25f, 0.75f, 1.25f, 1.75f, 2.25f, 2.75f, 3.25f, 3.75f};
    for (int axis = 0; axis < 3; axis++) {
        position[axis] = samples * (float)(size * line->slope[axis]) + (float)(place * line->slope[axis] + line->first[axis]);
    }
    if (line->shifts) {
        double places[LANES];
        FOR_LANES(n) places[n] = place + size * (double)samples[n];
        shift_positions(line, places, position);
    }
}

/* Values of a grid at the samples of a block. */
static inline Floats sample_block(const Grid *grid, const Line *line, double place, double size) {
    Floats position[3];
    positions_in_block(line, place, size, position);
    return sample_grid(grid, position);
}

/* Bounds on the neighbourhood of a block before it is sampled. */
typedef struct {
    int near;        /* whether any volume may hold something, */
    double peak;     /* the largest extinction that there may be */
    int64_t empty;   /* coarse blocks behind this one that are known to be empty */
} Nearby;

/* Whether a volume may hold density or emission in a block whose middle lies in a cell; adds the volume to nearby. */
static inline int cell_near(const Scene *scene, const Medium *medium, const Line *line, int64_t cell, Nearby *nearby) {
    const Occupancy *cells = &medium->occupancy;
    int64_t clearance = scene->skip_empty ? cells->clearance[cell] : 0, empty = 0;
    if (clearance > 1) {
        /* Blocks are judged by the cells of their middles, which are rounded. */
        double blocks = ((double)clearance - 1.01) * line->blocks_per_cell;
        empty = blocks >= 1.0 && blocks < FAR_AWAY ? (int64_t)blocks : 0;
    }
    if (empty < nearby->empty) nearby->empty = empty;
    if (clearance > 0) return 0;
    nearby->near = 1;
    nearby->peak += (double)cells->peaks[cell] * medium->sigma_t;
    return 1;
}

/* As cell_near, for a block of a line that is not straight: its samples may be anywhere. */
static inline int shifted_near(const Medium *medium, const Line *line, double place, double size, Nearby *nearby) {
    Floats position[3];
    positions_in_block(line, place, size, position);
    Longs cells = cells_around(&medium->occupancy, position);
    float peak = -1.0f;
    FOR_LANES(n) {
        float held = medium->occupancy.peaks[cells[n]];
        if (!medium->occupancy.clearance[cells[n]]) peak = held > peak ? held : peak;
    }
    nearby->empty = 0;
    if (!(peak >= 0.0f)) return 0;
    nearby->near = 1;
    nearby->peak += (double)peak * medium->sigma_t;
    return 1;
}

/* As shifted_near, for a coarse block whose middle would lie in a cell if the line were straight. */
static inline int shifted_block_near(const Scene *scene, const Medium *medium, const Line *line, double place,
                                     int64_t cell, Nearby *nearby) {
    double blocks = ((double)medium->occupancy.clearance[cell] - line->reach - 1.01) * line->blocks_per_cell;
    if (!scene->skip_empty || !(blocks >= 1.0 && blocks < FAR_AWAY)) return shifted_near(medium, line, place, 1.0, nearby);
    if ((int64_t)blocks < nearby->empty) nearby->empty = (int64_t)blocks;
    return 0;
}

/* As cell_near, for a block anywhere. */
static inline int block_near(const Scene *scene, const Medium *medium, const Line *line, double place, double size,
                             Nearby *nearby) {
    float position[3];
    if (line->shifts) return shifted_near(medium, line, place, size, nearby);
    position_at(line, place + 0.5 * STEPS * size, position);
    return cell_near(scene, medium, line, cell_around(&medium->occupancy, position), nearby);
}

/* Bounds of all volumes around a block; near: (met), whether each may hold density or emission there. */
static inline Nearby look_around(const Scene *scene, const Work *work, double place, double size, uint8_t *near) {
    Nearby nearby = {0, 0.0, INT64_MAX};
    for (int64_t m = 0; m < work->met_count; m++) {
        int64_t v = work->met[m];
        near[m] = (uint8_t)block_near(scene, scene->media + v, work->lines + v, place, size, &nearby);
    }
    return nearby;
}

static void start_ray(const Rays *rays, int64_t number, Ray *ray) {
    int64_t count = rays->counts[number];
    ray->origin = rays->origins + 3 * number;
    ray->direction = rays->directions + 3 * number;
    ray->near = rays->near_distance[number];
    ray->eye = rays->eyes ? rays->eyes[number] : -1;
    ray->count = count < 1 ? 1 : count > rays->max_count ? rays->max_count : count;
    ray->dt = (rays->far_distance[number] - ray->near) / (double)ray->count;
}

/* Cut an interval of places to where first + place * slope lies between two bounds. */
static inline void cut_interval(double first, double slope, double low, double high, double *from, double *to) {
    double a = (low - first) / slope, b = (high - first) / slope;
    if (slope == 0.0) {
        if (!(first >= low && first <= high)) *to = -1.0;
        return;
    }
    if (a > b) {
        double swapped = a;
        a = b, b = swapped;
    }
    if (a > *from) *from = a;
    if (b < *to) *to = b;
}

/* Whether a ray meets a volume's support. */
static int meets(const Medium *medium, const Line *line, const Ray *ray) {
    double from = 0.0, to = (double)ray->count;
    for (int k = 0; k < 3; k++) {
        cut_interval(line->first[k], line->slope[k], medium->support[k], medium->support[3 + k], &from, &to);
    }
    return from <= to;
}

/* Let a volume's velocities bend a ray's line through it: to where what is seen was at the frame. */
static void bend(const Medium *medium, const Ray *through, float *shifts, Line *line) {
    Ray moved;
    const Ray *ray = ray_of(medium, through, &moved);
    double time = medium->times[ray->eye];
    float longest = 0.0f;
    line->shifts = shifts, line->last = (ray->count + STEPS - 1) / STEPS * STEPS;
    for (int64_t node = 0; node <= line->last; node += LANES) {
        Doubles place[3], velocity[3], distance;
        FOR_LANES(n) distance[n] = ray->near + (double)(node + n) * ray->dt;
        for (int k = 0; k < 3; k++) place[k] = ray->origin[k] + distance * ray->direction[k];
        velocities_at(&medium->flow, place, time - (Doubles){0.0}, velocity);
        Floats shift[3];
        for (int k = 0; k < 3; k++) {
            shift[k] = __builtin_convertvector(-time * velocity[k], Floats);
            FOR_LANES(n) shifts[3 * (node + n) + k] = shift[k][n];
        }
        for (int k = 0; k < 3; k++) {
            const double *row = line->linear + 3 * k;
            Floats along = (float)row[0] * shift[0] + (float)row[1] * shift[1] + (float)row[2] * shift[2];
            FOR_LANES(n) longest = fabsf(along[n]) <= longest ? longest : fabsf(along[n]);
        }
    }
    line->reach = (double)longest * medium->occupancy.scale;
}

/* Whether a volume's support may lie between any point of a ray and a sun: seen along the sun's main axis, on a plane
across it. */
static int may_shade(const Medium *medium, const SunColumns *sun, const Line *line, const Ray *ray) {
    double from = 0.0, to = (double)ray->count;
    int64_t main = sun->main;
    double deep = (double)medium->density.shape[main], towards = sun->direction[main];
    cut_interval(line->first[main], line->slope[main], towards > 0.0 ? -INFINITY : -1.0, towards > 0.0 ? deep : INFINITY,
                 &from, &to);
    for (int k = 0; k < 2; k++) {
        int64_t axis = sun->others[k];
        double lean = sun->direction[axis] / towards, begin = lean, end = -lean * deep;
        double low = (begin < end ? begin : end) - 1.0, high = (begin > end ? begin : end) + (double)medium->density.shape[axis];
        cut_interval(line->first[axis] - lean * line->first[main], line->slope[axis] - lean * line->slope[main], low, high,
                     &from, &to);
    }
    return from <= to;
}

/* Squared distance of a point from the segment from 0 to `longest` along a direction. */
static inline double segment_distance(const double *point, const double *direction, double longest) {
    double square = dot_of(direction, direction), along = square > 0.0 ? dot_of(point, direction) / square : 0.0;
    along = along > 0.0 ? along < longest ? along : longest : 0.0;
    double apart[3] = {point[0] - along * direction[0], point[1] - along * direction[1], point[2] - along * direction[2]};
    return dot_of(apart, apart);
}

/* Whether a ray may meet what a sphere (4,) holds. */
static inline int may_meet(const double *sphere, const Ray *ray) {
    double centre[3];
    for (int k = 0; k < 3; k++) centre[k] = sphere[k] - ray->origin[k] - ray->near * ray->direction[k];
    return !(segment_distance(centre, ray->direction, (double)ray->count * ray->dt) > sphere[3] * sphere[3]);
}

/* Whether a sphere (4,) is away from a ray and from all that lies between it and the suns. */
static inline int far_away(const Scene *scene, const double *sphere, const Ray *ray) {
    double longest = (double)ray->count * ray->dt, square = sphere[3] * sphere[3], centre[3];
    for (int k = 0; k < 3; k++) centre[k] = sphere[k] - ray->origin[k] - ray->near * ray->direction[k];
    if (may_meet(sphere, ray)) return 0;
    for (int64_t l = 0; l < scene->suns; l++) {
        /* Seen along the sun's light. */
        const double *sun = scene->sun_directions + 3 * l;
        double ahead = dot_of(centre, sun), lean = dot_of(ray->direction, sun), lowest = lean < 0.0 ? lean * longest : 0.0;
        double across[3], direction[3];
        for (int k = 0; k < 3; k++) across[k] = centre[k] - ahead * sun[k], direction[k] = ray->direction[k] - lean * sun[k];
        if (!(ahead + sphere[3] < lowest) && !(segment_distance(across, direction, longest) > square)) return 0;
    }
    return 1;
}

/* Find the volumes that matter to a ray: lamps shine from everywhere, and a volume alone always matters. */
static void find_met(const Scene *scene, const Ray *ray, Work *work) {
    int all = scene->volumes == 1 || scene->lamps > 0;
    work->met_count = work->active_count = 0;
    for (int64_t v = 0; v < scene->volumes; v++) {
        const Medium *medium = scene->media + v;
        if (!all && scene->spheres && far_away(scene, scene->spheres + 4 * v, ray)) {
            work->is_met[v] = work->shades[v] = 0;
            continue;
        }
        work->lines[v] = line_through(medium, ray);
        work->is_met[v] = (uint8_t)(work->met_count < work->most_met && (all || meets(medium, work->lines + v, ray)));
        work->rows[v] = work->met_count * work->stride;
        work->shades[v] = (uint8_t)(all || medium->times);
        if (medium->times && ray->eye >= 0 && work->is_met[v]) {
            bend(medium, ray, work->shifts + v * work->shift_stride, work->lines + v);
        }
        for (int64_t l = 0; l < scene->suns && !work->shades[v]; l++) {
            work->shades[v] = (uint8_t)may_shade(medium, medium->suns + l, work->lines + v, ray);
        }
        if (work->is_met[v]) work->met[work->met_count++] = v;
    }
    int64_t groups = 0;
    for (int64_t g = 0; g < scene->groups; g++) {
        int active = 0;
        work->group_met[g] = 0;
        work->group_rows[g] = groups * work->stride;
        for (int64_t m = scene->group_starts[g]; m < scene->group_starts[g + 1]; m++) {
            int64_t v = scene->group_members[m];
            work->group_met[g] |= work->is_met[v];
            active |= work->is_met[v] | work->shades[v];
        }
        groups += work->group_met[g];
        if (active) work->active[work->active_count++] = g;
    }
}

/* Means over the steps of a block, of samples; 0 where steps begin behind the ray's end. */
static inline Steps step_means(Floats samples, const Ray *ray, double place, double size) {
    Steps first = __builtin_shufflevector(samples, samples, 0, 2, 4, 6);
    Steps second = __builtin_shufflevector(samples, samples, 1, 3, 5, 7);
    Steps means = 0.5f * first + 0.5f * second;
    for (int k = 0; k < STEPS && !(place + (STEPS - 1) * size < (double)ray->count); k++) {
        if (!(place + k * size < (double)ray->count)) means[k] = 0.0f;
    }
    return means;
}

/* Extinction and optical thickness of the steps of a block, which are left as those from `at` on.

near: (met), 1 for those that may hold density there. */
static inline void sample_media(const Scene *scene, const Ray *ray, double place, double size, const uint8_t *near,
                                int64_t at, Work *work) {
    float *sums = work->within + at;
    Steps total = {0.0f}, tau;
    for (int64_t m = 0; m < work->met_count; m++) {
        int64_t v = work->met[m];
        const Medium *medium = scene->media + v;
        Steps sigma = {0.0f};
        if (near[m] == 1 && medium->sigma_t > 0.0) {
            Floats samples = sample_block(&medium->density, work->lines + v, place, size);
            sigma = step_means(samples, ray, place, size) * (float)medium->sigma_t;
        }
        memcpy(work->sigma + work->rows[v] + at, &sigma, sizeof sigma);
        total += sigma;
    }
    tau = total * (float)(ray->dt * size);
    memcpy(work->total + at, &total, sizeof total);
    memcpy(work->tau + at, &tau, sizeof tau);
    sums[0] = tau[0];
    for (int k = 1; k < STEPS; k++) sums[k] = sums[k - 1] + tau[k];
}

/* Into how many parts a block is cut, by the optical depth in front of it: 1 where its steps are thin enough. */
static int parts_of(const Scene *scene, const float *tau, double reached, double size, double peak) {
    double depth = reached < 600.0 ? reached : 600.0, thickest = 0.0;
    for (int k = 0; k < STEPS; k++) thickest = (double)tau[k] > thickest ? (double)tau[k] : thickest;
    int parts = 1;
    /* The limit only grows with depth. */
    if (thickest > scene->step_thickness) {
        double allowed = scene->step_thickness * exp(depth / scene->step_growth);
        while (parts < MOST_PARTS && thickest > parts * allowed) parts *= 2;
    }
    /* Coarse steps need not be cut where none can be thick. */
    if (!(thickest > 0.0) || !(peak > 2.0 * size * scene->peak_thickness) || !(peak > scene->peak_thickness)) return parts;
    if (!(size > parts * scene->finest)) return parts;
    double allowed_peak = scene->peak_thickness * exp(depth / scene->peak_growth);
    while (parts < MOST_PARTS && peak > parts * allowed_peak && size > parts * scene->finest) parts *= 2;
    return parts;
}

/* Whether a volume may hold density at any sample of a coarse block. */
static inline int block_held(const Medium *medium, const Line *line, double place) {
    Floats position[3];
    if (!medium->held) return 1;
    positions_in_block(line, place, 1.0, position);
    return any_held(medium, position);
}

/* Coarse blocks that may hold density or emission, one after another. */
typedef struct {
    int64_t count, used;
    double from;          /* place from which on the next blocks are searched */
    double place[AHEAD], peak[AHEAD];
    int64_t before[AHEAD], passed;  /* blocks near density that turned out to be empty: in front of each, and since */
} Coming;

/* Find and sample the next coarse blocks of a ray that ends at `whole`; returns whether there are any. */
static int look_ahead(const Scene *scene, const Ray *ray, double whole, int keep_empty, Work *work, Coming *coming) {
    double from = coming->from;
    int64_t count = 0, passed = coming->passed;
    while (count < AHEAD && from < whole) {
        /* The cells of consecutive blocks, some of which are then skipped. */
        double middle[LANES];
        FOR_LANES(n) middle[n] = from + STEPS * (n + 0.5);
        for (int64_t m = 0; m < work->met_count; m++) {
            Floats position[3];
            straight_at(work->lines + work->met[m], middle, position);
            Longs cells = cells_around(&scene->media[work->met[m]].occupancy, position);
            memcpy(work->cells + LANES * m, &cells, sizeof cells);
        }
        for (int64_t n = 0; n < LANES && count < AHEAD && from < whole;) {
            int filled = keep_empty;
            Nearby nearby = {0, 0.0, INT64_MAX};
            for (int64_t m = 0; m < work->met_count; m++) {
                const Medium *medium = scene->media + work->met[m];
                const Line *line = work->lines + work->met[m];
                uint8_t *near = work->near + count * work->met_count + m;
                int64_t cell = work->cells[LANES * m + n];
                *near = (uint8_t)(line->shifts ? shifted_block_near(scene, medium, line, from, cell, &nearby)
                                               : cell_near(scene, medium, line, cell, &nearby));
                if (*near && !block_held(medium, line, from)) *near = 2;
                filled |= *near == 1;
            }
            int64_t next = nearby.empty < INT64_MAX ? 1 + nearby.empty : 1;
            /* A ray whose features are wanted where it begins has a block there. */
            if ((nearby.near && filled) || (scene->at_start && from == 0.0)) {
                coming->place[count] = from;
                coming->peak[count] = nearby.peak;
                coming->before[count] = passed;
                passed = 0;
                count++;
            } else {
                passed += nearby.near;
            }
            from += (double)(STEPS * next);
            n = next < LANES ? n + next : LANES;
        }
    }
    coming->from = from, coming->count = count, coming->used = 0, coming->passed = passed;
    for (int64_t n = 0; n < count; n++) {
        const uint8_t *near = work->near + n * work->met_count;
        sample_media(scene, ray, coming->place[n], 1.0, near, STEPS * (work->most_blocks + n), work);
    }
    return count > 0;
}

/* Keep a block whose steps were left as those from `at` on. */
static void keep_block(const Ray *ray, double place, double size, int64_t at, Work *work) {
    int64_t to = STEPS * work->blocks;
    if (at != to) {
        memcpy(work->total + to, work->total + at, sizeof(Steps));
        memcpy(work->tau + to, work->tau + at, sizeof(Steps));
        memcpy(work->within + to, work->within + at, sizeof(Steps));
        for (int64_t m = 0; m < work->met_count; m++) {
            float *sigma = work->sigma + m * work->stride;
            memcpy(sigma + to, sigma + at, sizeof(Steps));
        }
    }
    for (int k = 0; k < STEPS; k++) work->dt[to + k] = (float)(ray->dt * size);
    work->place[work->blocks] = place;
    work->size[work->blocks] = size;
    work->before[work->blocks + 1] = work->before[work->blocks] + (double)work->within[to + STEPS - 1];
    work->blocks++;
}

/* Fill the blocks of a ray up to the optical depth `behind`. */
static void fill_blocks(const Scene *scene, const Ray *ray, double behind, int keep_empty, Work *work) {
    double whole = (double)((ray->count + STEPS - 1) / STEPS * STEPS), place = 0.0, reached = 0.0, gap = 0.0;
    double size[LEVELS + 1] = {1.0}, end[LEVELS + 1] = {0.0};
    int level = 0;
    Coming coming = {0};
    work->blocks = work->looked_at = 0;
    work->before[0] = 0.0;
    while (place < whole && reached < behind) {
        while (level > 0 && !(place < end[level])) level--;
        double step = size[level], peak;
        int64_t at = STEPS * work->blocks;
        int near = 1;
        if (level == 0) {
            if (coming.used == coming.count && !look_ahead(scene, ray, whole, keep_empty, work, &coming)) {
                work->looked_at += coming.passed;
                break;
            }
            work->looked_at += coming.before[coming.used];
            /* Blocks in between are empty. */
            if (coming.place[coming.used] > place) gap = step;
            place = coming.place[coming.used], peak = coming.peak[coming.used];
            at = STEPS * (work->most_blocks + coming.used++);
        } else {
            uint8_t *around = work->near + AHEAD * work->met_count;
            Nearby nearby = look_around(scene, work, place, step, around);
            near = nearby.near || (scene->at_start && place == 0.0), peak = nearby.peak;
            sample_media(scene, ray, place, step, around, at, work);
        }
        work->looked_at += near;
        const float *tau = work->tau + at;
        /* What the blocks to come may need at most, if each is kept. */
        int64_t needed = work->blocks + (int64_t)((whole - place) / STEPS) + (LEVELS + 1) * 2 * MOST_PARTS;
        int parts = level < LEVELS && needed < work->most_blocks ? parts_of(scene, tau, reached, step, peak * (ray->dt * step)) : 1;
        if (parts > 1) {
            double from = place;
            /* Density that begins here may begin in the step in front, behind its samples. */
            if (gap > 0.0 && tau[0] > 0.0f) {
                double back = gap < step ? gap : step;
                if (4.0 * step <= MOST_PARTS * back) {
                    while (parts * back < 4.0 * step) parts *= 2;
                    from = place - back;
                }
            }
            level++;
            size[level] = step / parts;
            end[level] = place + STEPS * step;
            place = from;
            gap = 0.0;
            continue;
        }
        float gained = work->within[at + STEPS - 1];
        reached += (double)gained;
        gap = tau[STEPS - 1] > 0.0f ? 0.0 : step;
        if (near && (keep_empty || gained > 0.0f || (scene->at_start && place == 0.0))) keep_block(ray, place, step, at, work);
        place += STEPS * step;
    }
}

#endif
