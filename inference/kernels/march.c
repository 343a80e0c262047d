/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Camera rays through volumes, one after another; tests/reference/march.py does the same in numpy.

Compiled once for each kind of processor, with the name of the kind as VARIANT. A ray is cut into steps, which come in
blocks of equal steps; blocks that hold no density are passed over, dense ones are cut into smaller ones. What remains of
a ray are arrays over its steps. Places on a ray are counted in its coarse steps. */

#include <math.h>
#include <stddef.h>

#include "kernels.h"
#include "lamp_sampling.h"
#include "sampling.h"
#include "variants.h"

/* Steps per block, points per step at which density is sampled, and columns of the ray features. */
#define STEPS 4
#define SAMPLES 2
#define INTEGRALS 5
#define COLUMNS (2 + INTEGRALS)

/* How often a block may be cut, and into how many at a time. */
#define LEVELS 7
#define MOST_PARTS 8

/* Coarse blocks that are sampled together, before it is known whether the ray ends in front of them: processors compute
side by side what does not depend on each other. An even number. */
#define AHEAD 8

/* One number per step of a block. */
typedef float Steps __attribute__((vector_size(4 * STEPS)));

/* A ray as continuous indices into some frame: first + place * slope. */
typedef struct {
    double first[3], slope[3];
    double blocks_per_cell;  /* coarse blocks, by the axis along which cells of density follow each other fastest */
} Line;

/* One ray between two distances. */
typedef struct {
    const double *origin, *direction;
    double near;
    int64_t count;  /* coarse steps, and their length */
    double dt;
} Ray;

/* Scratch memory for one ray of up to `room` blocks; those of coarse blocks that are looked at ahead follow them. */
typedef struct {
    int64_t room;
    int64_t stride;              /* steps of all of these */
    int64_t blocks;
    int64_t looked_at;           /* blocks, also those that are not kept */
    double *place, *size;        /* (blocks), where each block begins, and the size of its steps */
    float *dt;                   /* (steps), length */
    double *before;              /* (blocks + 1), optical depth from the ray's start */
    float *sigma;                /* (volumes, steps), extinction */
    float *scattering;           /* (scattering, volumes, steps), of volumes whose albedo varies */
    float *total, *tau, *within; /* (steps), of all volumes; within: from the block's start to the step's end */
    float *far;                  /* (blocks), transmitted to the block's start */
    float *transmitted;          /* (steps), to the step's start */
    float *start, *end;          /* (groups, steps) each, optical depth of a group towards a light at the ends of steps */
    float *whole_start, *whole_end;  /* (steps), of all volumes; those of the group if there is one alone */
    float *visible;              /* (steps) */
    float *source;               /* (steps), scattered light */
    float *mean_start, *mean_end;  /* (groups, steps), mean transmittance towards the parts of a lamp */
    float *given, *reference;    /* (steps), fluence of a lamp, and what stands for it in ray features */
    float *lit, *received;       /* (steps), what of it surfaces let through, and what it is on a coarse scale */
    int64_t nodes;               /* ends of blocks; one that two blocks share counts once */
    double *node_place;          /* (steps; at most twice as many as blocks), where they are on the ray */
    int32_t *first_node;         /* (blocks), at the start of each block, which the one at its end follows */
    float *node_light;           /* (volumes, steps), light of a lamp that each volume scatters towards the camera */
    float *node_given, *node_reference;  /* (steps), as `given` and `reference` */
    float *group_tau;            /* (groups, steps) */
    float *light;                /* (steps) */
    double *edge_place;          /* (5 blocks), edges of steps to look up: place on the ray, depth from the camera */
    float *edge_depth;
    int32_t *edge_from, *edge_to;   /* (5 blocks), the step that begins and the step that ends there, or -1 */
    Line *lines;                 /* (volumes) */
    int64_t *cells;              /* (volumes, LANES), around blocks that follow each other */
    uint8_t *near;               /* (AHEAD + 1, volumes), whether a volume may hold something in a block; 2: no density */
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
    line.blocks_per_cell = 0.0;
    return line;
}

/* The line through a volume, whose cells it passes. */
static inline Line line_through(const Medium *medium, const Ray *ray) {
    Line line = line_in(medium->linear, medium->offset, ray);
    double x = fabs(line.slope[0]), y = fabs(line.slope[1]), z = fabs(line.slope[2]);
    line.blocks_per_cell = 1.0 / ((x > y ? (x > z ? x : z) : (y > z ? y : z)) * medium->occupancy.scale * STEPS);
    return line;
}

static inline void position_at(const Line *line, double place, float *position) {
    for (int axis = 0; axis < 3; axis++) position[axis] = (float)(place * line->slope[axis] + line->first[axis]);
}

/* As position_at, of several places. */
static inline void positions_at(const Line *line, const double *places, Floats *position) {
    Pairs place;
    memcpy(&place, places, sizeof place);
    for (int axis = 0; axis < 3; axis++) {
        position[axis] = __builtin_convertvector(place * line->slope[axis] + line->first[axis], Floats);
    }
}

/* Positions of the samples of one block: SAMPLES for each of STEPS steps. */
static inline void positions_in_block(const Line *line, double place, double size, Floats *position) {
    const Floats samples = {0.25f, 0.75f, 1.25f, 1.75f, 2.25f, 2.75f, 3.25f, 3.75f};
    for (int axis = 0; axis < 3; axis++) {
        position[axis] = samples * (float)(size * line->slope[axis]) + (float)(place * line->slope[axis] + line->first[axis]);
    }
}

/* What a grid holds at the samples of one block. */
static inline Floats sample_block(const Grid *grid, const Line *line, double place, double size) {
    Floats position[3];
    positions_in_block(line, place, size, position);
    return sample_grid(grid, position);
}

/* What is known of the neighbourhood of a block before it is sampled. */
typedef struct {
    int near;        /* whether any volume may hold something, */
    double peak;     /* the largest extinction that there may be */
    int64_t empty;   /* coarse blocks behind this one that are known to be empty */
} Nearby;

/* Whether a volume may hold something in a block whose middle lies in a cell. nearby: what is known of other volumes, to
which this one is added. */
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

/* As cell_near, for a block anywhere. */
static inline int block_near(const Scene *scene, const Medium *medium, const Line *line, double place, double size,
                             Nearby *nearby) {
    float position[3];
    position_at(line, place + 0.5 * STEPS * size, position);
    return cell_near(scene, medium, line, cell_around(&medium->occupancy, position), nearby);
}

/* What is known of all volumes around a block; near: (volumes), whether each may hold something there. */
static inline Nearby look_around(const Scene *scene, const Work *work, double place, double size, uint8_t *near) {
    Nearby nearby = {0, 0.0, INT64_MAX};
    for (int64_t v = 0; v < scene->volumes; v++) {
        near[v] = (uint8_t)block_near(scene, scene->media + v, work->lines + v, place, size, &nearby);
    }
    return nearby;
}

static void start_ray(const Rays *rays, int64_t number, Ray *ray) {
    int64_t count = rays->counts[number];
    ray->origin = rays->origins + 3 * number;
    ray->direction = rays->directions + 3 * number;
    ray->near = rays->near_distance[number];
    ray->count = count < 1 ? 1 : count > rays->max_count ? rays->max_count : count;
    ray->dt = (rays->far_distance[number] - ray->near) / (double)ray->count;
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

near: (volumes), 1 for those that may hold density there. */
static inline void sample_media(const Scene *scene, const Ray *ray, double place, double size, const uint8_t *near,
                                int64_t at, Work *work) {
    float *sums = work->within + at;
    Steps total = {0.0f}, tau;
    for (int64_t v = 0; v < scene->volumes; v++) {
        const Medium *medium = scene->media + v;
        Steps sigma = {0.0f};
        if (near[v] == 1 && medium->sigma_t > 0.0) {
            Floats samples = sample_block(&medium->density, work->lines + v, place, size);
            sigma = step_means(samples, ray, place, size) * (float)medium->sigma_t;
        }
        memcpy(work->sigma + v * work->stride + at, &sigma, sizeof sigma);
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
    /* What is allowed only grows with depth. */
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

/* Coarse blocks that may hold something, one after another. */
typedef struct {
    int64_t count, used;
    double from;          /* place from which on the next ones are looked for */
    double place[AHEAD], peak[AHEAD];
    int64_t before[AHEAD], passed;  /* blocks near density that turned out to hold none: in front of each, and since */
} Coming;

/* Find and sample the next coarse blocks of a ray that ends at `whole`; returns whether there are any. */
static int look_ahead(const Scene *scene, const Ray *ray, double whole, int keep_empty, Work *work, Coming *coming) {
    double from = coming->from;
    int64_t count = 0, passed = coming->passed;
    while (count < AHEAD && from < whole) {
        /* The cells of blocks that follow each other, of which some are then leapt over. */
        double middle[LANES];
        FOR_LANES(n) middle[n] = from + STEPS * (n + 0.5);
        for (int64_t v = 0; v < scene->volumes; v++) {
            Floats position[3];
            positions_at(work->lines + v, middle, position);
            Longs cells = cells_around(&scene->media[v].occupancy, position);
            memcpy(work->cells + LANES * v, &cells, sizeof cells);
        }
        for (int64_t n = 0; n < LANES && count < AHEAD && from < whole;) {
            int held = keep_empty;
            Nearby nearby = {0, 0.0, INT64_MAX};
            for (int64_t v = 0; v < scene->volumes; v++) {
                const Medium *medium = scene->media + v;
                const Line *line = work->lines + v;
                uint8_t *near = work->near + count * scene->volumes + v;
                *near = (uint8_t)cell_near(scene, medium, line, work->cells[LANES * v + n], &nearby);
                if (*near && !block_held(medium, line, from)) *near = 2;
                held |= *near == 1;
            }
            int64_t next = nearby.empty < INT64_MAX ? 1 + nearby.empty : 1;
            /* A ray whose features are wanted where it begins has a block there. */
            if ((nearby.near && held) || (scene->at_start && from == 0.0)) {
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
        const uint8_t *near = work->near + n * scene->volumes;
        sample_media(scene, ray, coming->place[n], 1.0, near, STEPS * (work->room + n), work);
    }
    return count > 0;
}

/* Keep a block whose steps were left as those from `at` on. */
static void keep_block(const Scene *scene, const Ray *ray, double place, double size, int64_t at, Work *work) {
    int64_t kept = STEPS * work->blocks;
    if (at != kept) {
        memcpy(work->total + kept, work->total + at, sizeof(Steps));
        memcpy(work->tau + kept, work->tau + at, sizeof(Steps));
        memcpy(work->within + kept, work->within + at, sizeof(Steps));
        for (int64_t v = 0; v < scene->volumes; v++) {
            float *sigma = work->sigma + v * work->stride;
            memcpy(sigma + kept, sigma + at, sizeof(Steps));
        }
    }
    for (int k = 0; k < STEPS; k++) work->dt[kept + k] = (float)(ray->dt * size);
    work->place[work->blocks] = place;
    work->size[work->blocks] = size;
    work->before[work->blocks + 1] = work->before[work->blocks] + (double)work->within[kept + STEPS - 1];
    work->blocks++;
}

/* Fill the blocks of a ray up to the optical depth `behind`. */
static void fill_blocks(const Scene *scene, const Ray *ray, double behind, int keep_empty, Work *work) {
    double whole = (double)((ray->count + STEPS - 1) / STEPS * STEPS), place = 0.0, reached = 0.0, gap = 0.0;
    double size[LEVELS + 1] = {1.0}, end[LEVELS + 1] = {0.0};
    int level = 0;
    Coming coming = {0};
    for (int64_t v = 0; v < scene->volumes; v++) {
        work->lines[v] = line_through(scene->media + v, ray);
    }
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
            at = STEPS * (work->room + coming.used++);
        } else {
            uint8_t *around = work->near + AHEAD * scene->volumes;
            Nearby nearby = look_around(scene, work, place, step, around);
            near = nearby.near || (scene->at_start && place == 0.0), peak = nearby.peak;
            sample_media(scene, ray, place, step, around, at, work);
        }
        work->looked_at += near;
        const float *tau = work->tau + at;
        /* What the blocks to come may need at most, if each is kept. */
        int64_t needed = work->blocks + (int64_t)((whole - place) / STEPS) + (LEVELS + 1) * 2 * MOST_PARTS;
        int parts = level < LEVELS && needed < work->room ? parts_of(scene, tau, reached, step, peak * (ray->dt * step)) : 1;
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
        if (near && (keep_empty || gained > 0.0f || (scene->at_start && place == 0.0))) keep_block(scene, ray, place, step, at, work);
        place += STEPS * step;
    }
}

/* Scattering coefficients of the steps of all blocks, where albedos vary. */
static void sample_scattering(const Scene *scene, const Ray *ray, Work *work) {
    int64_t room = work->stride;
    for (int64_t v = 0; v < scene->volumes && scene->varying; v++) {
        const Medium *medium = scene->media + v;
        const float *sigma = work->sigma + v * room;
        if (!medium->varies) continue;
        for (int64_t c = 0; c < scene->scattering; c++) {
            float *scattering = work->scattering + (c * scene->volumes + v) * room;
            for (int64_t b = 0; b < work->blocks; b++) {
                const float *here = sigma + STEPS * b;
                float *found = scattering + STEPS * b;
                double place = work->place[b], size = work->size[b];
                int filled = 0;
                for (int k = 0; k < STEPS; k++) found[k] = 0.0f, filled |= here[k] > 0.0f;
                if (!filled) continue;
                Floats samples = sample_block(medium->scattering + c, work->lines + v, place, size);
                Steps scattered = step_means(samples, ray, place, size) * (float)medium->sigma_t;
                /* Interpolation in single precision may leave a little where there is no density. */
                for (int k = 0; k < STEPS; k++) found[k] = scattered[k] < here[k] ? scattered[k] : here[k];
            }
        }
    }
}

/* Scattering coefficients of a volume in a colour channel at steps: its extinction, for albedo 1, where the albedo does
not vary. */
static inline const float *scattering_of(const Scene *scene, const Work *work, int64_t v, int64_t c) {
    int64_t room = work->stride;
    return scene->media[v].varies ? work->scattering + (c * scene->volumes + v) * room : work->sigma + v * room;
}

/* A place within a step. */
static inline double place_in(const Work *work, int64_t step, double inside) {
    int64_t block = step / STEPS;
    return work->place[block] + ((double)(step % STEPS) + inside) * work->size[block];
}

static void look_up_visibility(const Scene *scene, int64_t l, const Ray *ray, Work *work) {
    const ShadowMap *map = scene->shadow_maps + l;
    Line line = line_in(map->linear, map->offset, ray);
    for (int64_t s = 0; s < STEPS * work->blocks; s++) {
        float position[3];
        work->visible[s] = 1.0f;
        if (!(work->total[s] > 0.0f)) continue;
        position_at(&line, place_in(work, s, 0.5), position);
        work->visible[s] = visibility_of(map, position);
    }
}

/* List the edges of filled steps; the edge between blocks that follow each other belongs to the second. */
static int64_t list_edges(Work *work) {
    int64_t edges = 0;
    for (int64_t b = 0; b < work->blocks; b++) {
        int joined_before = b > 0 && work->place[b] == work->place[b - 1] + STEPS * work->size[b - 1];
        int joined_after = b + 1 < work->blocks && work->place[b + 1] == work->place[b] + STEPS * work->size[b];
        float before = (float)work->before[b];
        for (int k = 0; k <= STEPS; k++) {
            int32_t from = k < STEPS ? (int32_t)(STEPS * b + k) : -1;
            int32_t to = k > 0 ? (int32_t)(STEPS * b + k - 1) : joined_before ? (int32_t)(STEPS * b - 1) : -1;
            int wanted = (from >= 0 && work->total[from] > 0.0f) || (to >= 0 && work->total[to] > 0.0f);
            if (!wanted || (k == STEPS && joined_after)) continue;
            work->edge_place[edges] = work->place[b] + k * work->size[b];
            work->edge_depth[edges] = k > 0 ? work->within[STEPS * b + k - 1] + before : before;
            work->edge_from[edges] = from;
            work->edge_to[edges] = to;
            edges++;
        }
    }
    return edges;
}

/* Store what was found at some edges where steps start and end. */
static inline void store_at_edges(const Work *work, int64_t edge, int used, Floats found, float *start, float *end) {
    float values[LANES];
    memcpy(values, &found, sizeof values);
    for (int n = 0; n < used; n++) {
        int32_t from = work->edge_from[edge + n], to = work->edge_to[edge + n];
        if (from >= 0) start[from] = values[n];
        if (to >= 0) end[to] = values[n];
    }
}

/* Optical depths of each group and of all volumes towards one light, at the ends of filled steps.

l: number of the sun. columns: (volumes), around a part of a lamp, or NULL for the sun. */
static void look_up_depths(const Scene *scene, int64_t l, const LampColumns *const *columns, int64_t edges, Work *work) {
    int64_t room = work->stride, steps = STEPS * work->blocks;
    float dark = (float)scene->dark;
    int one = scene->groups == 1, outside = scene->volumes > 1 || scene->at_start;
    for (int64_t s = 0; s < steps && !one; s++) work->whole_start[s] = work->whole_end[s] = dark;
    for (int64_t g = 0; g < scene->groups; g++) {
        for (int64_t s = 0; s < steps; s++) work->start[g * room + s] = work->end[g * room + s] = dark;
    }
    for (int64_t e = 0; e < edges; e += LANES) {
        double place[LANES];
        Floats depth, whole = in_all(0.0f);
        /* The last edge again where there are no more. */
        FOR_LANES(n) {
            int64_t edge = e + n < edges ? e + n : edges - 1;
            place[n] = work->edge_place[edge], depth[n] = work->edge_depth[edge];
        }
        int used = edges - e < LANES ? (int)(edges - e) : LANES;
        for (int64_t g = 0; g < scene->groups; g++) {
            Floats sum = in_all(0.0f);
            for (int64_t m = scene->group_starts[g]; m < scene->group_starts[g + 1]; m++) {
                int64_t v = scene->group_members[m];
                const Medium *medium = scene->media + v;
                const Line *line = work->lines + v;
                Floats position[3];
                positions_at(line, place, position);
                if (columns) {
                    if (medium->sigma_t > 0.0) sum += lamp_depth(columns[v], position, (float)medium->sigma_t);
                    continue;
                }
                const SunColumns *sun = medium->suns + l;
                float extinction = (float)medium->sigma_t;
                sum += outside ? sun_depth_outside(&medium->density, sun, extinction, position, depth)
                               : sun_depth(&medium->density, sun, extinction, position, depth);
            }
            store_at_edges(work, e, used, sum, work->start + g * room, work->end + g * room);
            whole += sum;
        }
        if (!one) store_at_edges(work, e, used, whole, work->whole_start, work->whole_end);
    }
}

/* What is transmitted to the starts of blocks, and of steps, and what of it is lost in them, in `light`. */
static void transmit(Work *work) {
    for (int64_t b = 0; b < work->blocks; b += LANES) {
        Floats rounded, rest;
        FOR_LANES(n) {
            double before = work->before[b + n < work->blocks ? b + n : work->blocks];
            rounded[n] = (float)before;
            rest[n] = (float)(before - (double)rounded[n]);
        }
        store(work->far + b, transmittance(rounded) * (1.0f - rest));
    }
    for (int64_t s = 0; s < STEPS * work->blocks; s += LANES) {
        Floats far, tau = load(work->tau + s), lost;
        FOR_LANES(n) far[n] = work->far[(s + n) / STEPS];
        Floats transmitted = far * transmittance(load(work->within + s) - tau);
        exp_minus(tau, &lost);
        store(work->transmitted + s, transmitted);
        store(work->light + s, transmitted * lost);
    }
}

/* Sum of the products of two numbers of each step, (steps) each. */
static inline double sum_of(const float *a, const float *b, const Work *work) {
    double whole = 0.0;
    for (int64_t s = 0; s < STEPS * work->blocks; s += STEPS) {
        float sum = 0.0f;
        for (int k = 0; k < STEPS; k++) sum += a[s + k] * b[s + k];
        whole += (double)sum;
    }
    return whole;
}

/* Single scattering of one sun: the integral over each step of sigma exp(-tau to the camera - tau to the sun). */
static void add_single(const Scene *scene, int64_t l, Work *work, double *single) {
    int64_t steps = STEPS * work->blocks;
    float *light = work->light;
    for (int64_t s = 0; s < steps; s += LANES) {
        Floats start = load(work->whole_start + s), end = load(work->whole_end + s) + load(work->tau + s);
        Floats found = load(work->transmitted + s) * mean_transmittance(start, end) * load(work->dt + s);
        store(light + s, scene->shadow_maps ? found * load(work->visible + s) : found);
    }
    for (int64_t n = 0; n < scene->volumes * scene->scattering; n++) {
        int64_t v = n / scene->scattering, c = n % scene->scattering;
        single[(v * scene->suns + l) * scene->scattering + c] += sum_of(scattering_of(scene, work, v, c), light, work);
    }
}

/* 4 pi times the scattered light of one light that scatters towards the camera, in the middle of each filled step from
the first sample on.

fluence: of group g. l: number of the light. */
static void look_up_source(const Scene *scene, const Fluence *fluence, int64_t g, int64_t l, const Ray *ray, Work *work) {
    int64_t from = work->sample_step[0];
    const float *tau = work->group_tau + g * work->stride;
    int64_t steps = STEPS * work->blocks;
    if (!fluence->lights) {
        memset(work->source, 0, (size_t)steps * sizeof *work->source);
        return;
    }
    const float *light = fluence->lights[l], scale = fluence->scales ? (float)fluence->scales[l] : 1.0f;
    Line line = line_in(fluence->linear, fluence->offset, ray);
    float weight[3], jitter[3], most = (float)(fluence->cells - 1);
    for (int i = 0; i < 3; i++) {
        double sum = 0.0;
        for (int j = 0; j < 3; j++) sum += fluence->flux_from_world[3 * i + j] * ray->direction[j];
        weight[i] = (float)sum;
        jitter[i] = (float)scene->jitter[i];
    }
    for (int64_t s = from / LANES * LANES; s < steps; s += LANES) {
        double middle[LANES];
        Floats number, found;
        Ints cell = {0};
        for (int k = 0; k < LANES / STEPS; k++) {
            int64_t block = least_int(s / STEPS + k, work->blocks - 1);
            double size = work->size[block], place = work->place[block];
            /* Of the step on a ray that consists of such steps alone; sizes are powers of two. */
            double first = place / size;
            for (int n = 0; n < STEPS; n++) {
                middle[STEPS * k + n] = place + (n + 0.5) * size;
                number[STEPS * k + n] = (float)(first + n);
            }
        }
        Floats position[3];
        positions_at(&line, middle, position);
        for (int axis = 0; axis < 3; axis++) {
            /* Jittered from step to step, so that neighbouring rays do not enter a cell at the same step. */
            Floats shift = clamped_to(number * jitter[axis], in_all(0.0f), in_all(FAR_AWAY));
            shift = shift - to_floats(floors(shift)) - 0.5f;
            Ints along = to_ints(clamped_to(position[axis] + shift, in_all(0.0f), in_all(most)));
            cell = cell * (int32_t)fluence->cells + along;
        }
        Pairs fluence_and_x, y_and_z;
        FOR_LANES(n) {
            const float *at = light + 4 * (int64_t)cell[n];
            fluence_and_x[n] = pair_at(at), y_and_z[n] = pair_at(at + 2);
        }
        found = first_of(fluence_and_x) + weight[0] * second_of(fluence_and_x);
        found = found + weight[1] * first_of(y_and_z) + weight[2] * second_of(y_and_z);
        Ints filled = (load(tau + s) > 0.0f) & (found > 0.0f);
        store(work->source + s, choose(filled, found * scale, in_all(0.0f)));
    }
}

static int64_t sample_count(const Scene *scene, double alpha) {
    int64_t most = scene->depth_samples;
    if (!scene->adaptive) return alpha > 0.0 ? most : 0;
    if (!(alpha > scene->min_alpha)) return 0;
    int64_t count = (int64_t)ceil((double)most * sqrt(alpha < 1.0 ? alpha : 1.0));
    if (count > scene->coarse_count) count = (count + scene->coarse_count - 1) / scene->coarse_count * scene->coarse_count;
    int64_t fewest = most < 2 ? most : 2;
    return count < fewest ? fewest : count > most ? most : count;
}

/* Take a place in a step as a depth sample. */
static void add_sample(const Scene *scene, const Ray *ray, int64_t s, double inside, int64_t n, Work *work, Gathered *out) {
    int64_t sample = out->samples + n;
    work->sample_step[n] = s;
    work->sample_inside[n] = (float)inside;
    out->sample_distance[sample] = ray->near + place_in(work, s, inside) * ray->dt;
    float total = work->total[s] > 1e-30f ? work->total[s] : 1e-30f;
    for (int64_t v = 0; v < scene->volumes; v++) {
        out->sample_fraction[sample * scene->volumes + v] = work->sigma[v * work->stride + s] / total;
    }
    for (int64_t i = 0; i < scene->volumes * scene->scattering && scene->varying; i++) {
        const float *scattering = scattering_of(scene, work, i / scene->scattering, i % scene->scattering);
        out->sample_scattering[sample * scene->volumes * scene->scattering + i] = scattering[s] / total;
    }
}

/* A depth sample where a part of the ray's opacity is in front of it, behind those before. */
static void place_sample(const Scene *scene, const Ray *ray, double opacity, int64_t n, Work *work, Gathered *out) {
    double wanted = -log1p(-(opacity < 1.0 - 1e-12 ? opacity : 1.0 - 1e-12));
    int64_t block = n ? work->sample_step[n - 1] / STEPS : 0;
    while (block + 1 < work->blocks && work->before[block + 1] <= wanted) block++;
    wanted -= work->before[block];
    const float *within_block = work->within + STEPS * block, *tau = work->tau + STEPS * block;
    int step = 0, last = STEPS - 1;
    for (int k = 0; k < STEPS; k++) step += (double)within_block[k] <= wanted;
    for (int k = 0; k < STEPS; k++) {
        if (tau[k] > 0.0f) last = k;
    }
    if (step > last) step = last;
    float thickness = tau[step];
    double inside = (wanted - (double)(within_block[step] - thickness)) / (thickness > 1e-30f ? thickness : 1e-30f);
    inside = inside > 0.0 ? (inside < 1.0 ? inside : 1.0) : 0.0;
    add_sample(scene, ray, STEPS * block + step, inside, n, work, out);
}

/* Depth samples at the Gauss-Legendre nodes of the ray's opacity, and in the middles of `detail` parts of each node's
share but for the one that holds it; returns their number. */
static int64_t place_samples(const Scene *scene, const Ray *ray, double alpha, int64_t detail, Work *work, Gathered *out) {
    if (scene->at_start) {
        out->sample_weight[out->samples] = alpha;
        add_sample(scene, ray, 0, 0.0, 0, work, out);
        return 1;
    }
    int64_t count = work->blocks ? sample_count(scene, alpha) : 0;
    const double *nodes = scene->nodes + count * scene->depth_samples;
    const double *weights = scene->node_weights + count * scene->depth_samples;
    double begin = 0.0;
    for (int64_t n = 0; n < count; n++) {
        double part = weights[n] / (double)detail;
        for (int64_t k = 0; k < detail; k++) {
            double low = begin + (double)k * part;
            int holds = (k == 0 || nodes[n] >= low) && (k + 1 == detail || nodes[n] < low + part);
            double node = holds ? nodes[n] : low + 0.5 * part;
            place_sample(scene, ray, node * alpha, n * detail + k, work, out);
            out->sample_weight[out->samples + n * detail + k] = part * alpha;
        }
        begin += weights[n];
    }
    return count * detail;
}

/* Optical thickness of steps in each group. */
static void sum_groups(const Scene *scene, Work *work) {
    int64_t room = work->stride, steps = STEPS * work->blocks;
    for (int64_t g = 0; g < scene->groups; g++) {
        for (int64_t s = 0; s < steps; s += LANES) {
            Floats sigma = in_all(0.0f);
            for (int64_t n = scene->group_starts[g]; n < scene->group_starts[g + 1]; n++) {
                sigma += load(work->sigma + scene->group_members[n] * room + s);
            }
            store(work->group_tau + g * room + s, sigma * load(work->dt + s));
        }
    }
}

/* One light of one group, at the steps and samples of a ray, as ray features see it. */
typedef struct {
    const Fluence *fluence;
    const float *visible;        /* (steps), what surfaces let through; or NULL */
    const float *received;       /* (steps), its light without what lies in between; NULL: 1 */
    const float *unit;           /* (samples), what its light is divided by; NULL: 1 */
    float *features;             /* of the first sample, */
    int64_t stride;              /* and from one to the next */
} Gathering;

/* Ray features of one group and light at the samples of a ray: integrals of the light ahead, from the ray's end.

The lanes are the integrals: those of the light itself with each scale, and those of scattered light. */
static void gather_features(const Scene *scene, int64_t g, const Gathering *of, int64_t count, const Work *work) {
    int64_t room = work->stride, steps = STEPS * work->blocks, from = work->sample_step[0];
    const float *start = work->start + g * room, *end = work->end + g * room, *tau = work->group_tau + g * room;
    const float a = (float)scene->scales[0], b = (float)scene->scales[1], c = (float)scene->scales[2];
    const float reduced = (float)of->fluence->reduced_fraction;
    /* Towards the sun and along the ray, so that one vector holds the exponentials of a step. */
    const Floats along_ray = {a, b, c, a, reduced}, both = {a, b, c, a, b, c, a, reduced};
    const Ints of_sun = {-1, -1, -1};
    Floats ahead = in_all(0.0f);
    float tau_ahead = 0.0f;
    int64_t n = count - 1;
    for (int64_t s = steps - 1; s >= from; s--) {
        Floats lost, depth = choose(of_sun, in_all(0.5f * (start[s] + end[s])), in_all(tau[s]));
        Floats sun = exp_minus(both * depth, &lost);
        const Floats passed = __builtin_shufflevector(sun, sun, 3, 4, 5, 6, 7, 7, 7, 7);
        lost = __builtin_shufflevector(lost, lost, 3, 4, 5, 6, 7, 7, 7, 7);
        if (of->visible) sun *= of->visible[s];
        if (of->received) sun *= of->received[s];
        Floats light = choose(of_sun, sun, in_all(work->source[s]));
        for (; n >= 0 && work->sample_step[n] == s; n--) {
            float *values = of->features + n * of->stride;
            float inside = work->sample_inside[n], rest = (1.0f - inside) * tau[s];
            float sun_tau = start[s] + inside * (end[s] - start[s]), most = (float)scene->max_tau_sun;
            sun_tau = least(sun_tau, most);
            if (of->visible) {
                float lit = of->visible[s] > 1e-30f ? of->visible[s] : 1e-30f;
                sun_tau = least(sun_tau - logf(lit), most);
            }
            values[0] = sun_tau;
            values[1] = least(tau_ahead + rest, (float)scene->max_tau_ahead);
            Floats gone, kept = exp_minus(along_ray * rest, &gone), found = light * gone + kept * ahead;
            if (of->unit) found = found / of->unit[n];
            memcpy(values + 2, &found, INTEGRALS * sizeof *values);
        }
        ahead = light * lost + passed * ahead;
        tau_ahead += tau[s];
    }
}

/* Phase function, 1/sr, of a lamp's light towards the camera at a point that lies `behind` the place where the ray
passes the lamp; passing: square of the lamp's distance from the ray, distance: from the point. */
static inline double scattered_back(const float *phase, double behind, double passing, double distance) {
    /* The square root of 1 - |cosine|, without cancellation. */
    double place = sqrt(passing / larger(distance * (distance + fabs(behind)), 1e-60)) * MRPNN_PHASES;
    const float *table = phase + (behind > 0.0 ? MRPNN_PHASES + 1 : 0);
    place = place < MRPNN_PHASES ? place : MRPNN_PHASES;
    int64_t cell = within((int64_t)place, MRPNN_PHASES - 1);
    return table[cell] + (place - (double)cell) * (table[cell + 1] - table[cell]);
}

/* As scattered_back, of several points. */
static inline Floats scattered_back_at(const float *phase, Doubles behind, Doubles passing) {
    Floats along = __builtin_convertvector(behind, Floats), size = choose(along > 0.0f, along, -along);
    Floats square = __builtin_convertvector(behind * behind + passing, Floats);
    square = clamped_to(square, in_all(1e-30f), in_all(1e30f));
    Floats distance = square * inverse_roots(square);
    Floats share = __builtin_convertvector(passing, Floats) / (distance * (distance + size));
    share = clamped_to(share, in_all(1e-30f), in_all(1.0f));
    Floats place = share * inverse_roots(share) * (float)MRPNN_PHASES, here, next;
    Ints cell = ints_within(to_ints(place), MRPNN_PHASES - 1);
    FOR_LANES(n) {
        const float *at = phase + (along[n] > 0.0f ? MRPNN_PHASES + 1 : 0) + cell[n];
        here[n] = at[0], next[n] = at[1];
    }
    return lerp_lanes(here, next, least_of(place - to_floats(cell), in_all(1.0f)));
}

/* A ray as a part of a lamp sees it. */
typedef struct {
    const Emitter *emitter;
    const Ray *ray;
    double origin[3];  /* of the ray, from the part */
    double nearest;    /* distance on the ray to where it passes the part, */
    double passing;    /* and the square of the part's distance from there */
    double lit[2];     /* distances from there between which the part may light the ray */
} Pass;

static inline Pass pass_of(const Emitter *emitter, const Ray *ray) {
    Pass pass = {.emitter = emitter, .ray = ray};
    for (int k = 0; k < 3; k++) pass.origin[k] = ray->origin[k] - emitter->position[k];
    pass.nearest = -dot_of(pass.origin, ray->direction);
    for (int k = 0; k < 3; k++) {
        double across = pass.origin[k] + pass.nearest * ray->direction[k];
        pass.passing += across * across;
    }
    lit_interval(emitter, ray->origin, ray->direction, pass.lit);
    for (int k = 0; k < 2; k++) pass.lit[k] -= pass.nearest;
    return pass;
}

/* Turn the direction from a part of a spot to a point into the cone, within which all its light travels: where a ray
passes a light that is seen in that direction at the distance 1. */
static inline void turn_into_cone(const Pass *pass, double *behind, double *passing) {
    const Emitter *emitter = pass->emitter;
    double away[3], direction[3];
    for (int k = 0; k < 3; k++) away[k] = pass->origin[k] + (pass->nearest + *behind) * pass->ray->direction[k];
    double distance = larger(sqrt(dot_of(away, away)), 1e-30), level = dot_of(away, emitter->axis) / distance, tilt = 0.0;
    if (!(level < emitter->cosine)) return;
    for (int k = 0; k < 3; k++) {
        away[k] = away[k] / distance - level * emitter->axis[k];
        tilt += away[k] * away[k];
    }
    double across = sqrt(larger(1.0 - emitter->cosine * emitter->cosine, 0.0)) / larger(sqrt(tilt), 1e-30);
    for (int k = 0; k < 3; k++) direction[k] = emitter->cosine * emitter->axis[k] + across * away[k];
    *behind = larger(smaller(dot_of(direction, pass->ray->direction), 1.0), -1.0);
    *passing = 1.0 - *behind * *behind;
}

/* Add the single scattering of one step that is not far shorter than its distance to a part of a lamp: the nodes lie in
the angle under which that sees the step, in which the inverse square is constant.

ends: of the step, from where the ray passes the part. weight: of its light. */
static void add_bent(const Scene *scene, const Pass *pass, const double *ends, double weight, int64_t s,
                     const Work *work, double *single, int64_t stride) {
    const Emitter *emitter = pass->emitter;
    double begin = ends[0], end = ends[1], length = end - begin;
    double height = sqrt(pass->passing + emitter->extent * emitter->extent + 1e-6 * length * length);
    double from = atan2(begin, height), turn = atan2(end, height) - from;
    for (int64_t node = 0; node < scene->wide_count; node++) {
        double behind = height * tan(from + scene->wide_nodes[node] * turn), point[3];
        double light = scene->wide_weights[node] * turn * (height * height + behind * behind) / height;
        for (int k = 0; k < 3; k++) {
            point[k] = emitter->position[k] + pass->origin[k] + (pass->nearest + behind) * pass->ray->direction[k];
        }
        light *= emitter_fluence(emitter, point) * weight;
        double passing = pass->passing;
        if (emitter->cone) turn_into_cone(pass, &behind, &passing);
        double distance = sqrt(passing + behind * behind);
        for (int64_t v = 0; v < scene->volumes; v++) {
            if (!(work->sigma[v * work->stride + s] > 0.0f)) continue;
            double phase = scattered_back(scene->media[v].phase, behind, passing, distance);
            for (int64_t c = 0; c < scene->scattering; c++) {
                single[v * stride + c] += light * scattering_of(scene, work, v, c)[s] * phase;
            }
        }
    }
}

/* Add the single scattering of a node of some steps: where it lies behind the place where the ray passes the part, and
the light there times the length that it stands for. */
static inline void add_node(const Scene *scene, const Pass *pass, Ints some, Doubles behind, Floats light, int64_t first,
                            const Work *work, double *single, int64_t stride) {
    Doubles passing = (Doubles){0} + pass->passing;
    if (pass->emitter->cone) {
        FOR_LANES(n) {
            double place = behind[n], apart = pass->passing;
            turn_into_cone(pass, &place, &apart);
            behind[n] = place, passing[n] = apart;
        }
    }
    for (int64_t v = 0; v < scene->volumes; v++) {
        Ints filled = some & (load(work->sigma + v * work->stride + first) > 0.0f);
        if (!any_lane(filled)) continue;
        Floats scattered = light * scattered_back_at(scene->media[v].phase, behind, passing);
        for (int64_t c = 0; c < scene->scattering; c++) {
            Floats found = scattered * load(scattering_of(scene, work, v, c) + first);
            double sum = 0.0;
            FOR_LANES(n) sum += filled[n] ? (double)found[n] : 0.0;
            single[v * stride + c] += sum;
        }
    }
}

/* Single scattering of one part of a lamp: as add_single, with the integrals over steps of its fluence times the phase
function: of one node in the middle of steps that are very short for their distance, of two in others, and in steps
that are not far shorter than it those of add_bent. */
static void add_emitter(const Scene *scene, const Emitter *emitter, const Ray *ray, const Work *work, double *single,
                        int64_t stride) {
    const Pass pass = pass_of(emitter, ray);
    double wide = scene->wide * scene->wide, brief = scene->brief * scene->brief;
    double extent = pass.passing + emitter->extent * emitter->extent;
    int64_t steps = STEPS * work->blocks;
    for (int64_t first = 0; first < steps; first += LANES) {
        Floats start = load(work->whole_start + first), end = load(work->whole_end + first) + load(work->tau + first);
        Floats weight = load(work->transmitted + first) * mean_transmittance(start, end) * load(work->visible + first);
        Ints filled = (load(work->total + first) > 0.0f) & (weight > 0.0f);
        if (!any_lane(filled)) continue;
        Doubles begin, length;
        for (int n = 0; n < LANES; n += STEPS) {
            int64_t block = least_int((first + n) / STEPS, work->blocks - 1);
            for (int k = 0; k < STEPS; k++) {
                begin[n + k] = work->place[block] + (double)k * work->size[block], length[n + k] = work->size[block];
                if ((first + n) / STEPS >= work->blocks) filled[n + k] = 0;
            }
        }
        begin = ray->near + begin * ray->dt - pass.nearest;
        length *= ray->dt;
        Ints cut = (Ints){0};
        if (emitter->cone) {
            FOR_LANES(n) {
                double from = larger(begin[n], pass.lit[0]), to = smaller(begin[n] + length[n], pass.lit[1]);
                if (!(to > from)) filled[n] = 0;
                if (!(from > begin[n] || to < begin[n] + length[n])) continue;
                cut[n] = -1, begin[n] = from, length[n] = larger(to - from, 0.0);
            }
            if (!any_lane(filled)) continue;
        }
        Doubles middle = begin + 0.5 * length, square = length * length, away = extent + middle * middle;
        Ints not_brief = cut | __builtin_convertvector(square > brief * away, Ints);
        Ints bent = filled & not_brief & __builtin_convertvector(square > wide * away, Ints);
        Ints once = filled & ~not_brief, straight = filled & not_brief & ~bent;
        for (int n = 0; n < LANES && any_lane(bent); n++) {
            if (!bent[n]) continue;
            double ends[2] = {begin[n], begin[n] + length[n]};
            add_bent(scene, &pass, ends, (double)weight[n], first + n, work, single, stride);
        }
        weight *= __builtin_convertvector(length, Floats);
        if (any_lane(once)) {
            Floats light = load(work->light + first) * weight;
            add_node(scene, &pass, once, begin + 0.5 * length, light, first, work, single, stride);
        }
        if (!any_lane(straight)) continue;
        for (int node = 0; node < 2; node++) {
            Doubles behind = begin + GAUSS_NODES[node] * length, point[3];
            for (int k = 0; k < 3; k++) {
                point[k] = (emitter->position[k] + pass.origin[k]) + (pass.nearest + behind) * ray->direction[k];
            }
            Floats light = emitter_fluences(emitter, point) * (0.5f * weight);
            add_node(scene, &pass, straight, behind, light, first, work, single, stride);
        }
    }
}

/* Places within steps, in the world. The last step again where there are no more. */
static inline void points_in(const Ray *ray, const Work *work, const int64_t *numbers, const float *inside, int64_t count,
                             int64_t first, Doubles *point) {
    Doubles distance;
    FOR_LANES(n) {
        int64_t k = least_int(first + n, count - 1);
        distance[n] = ray->near + place_in(work, numbers ? numbers[k] : k, inside ? (double)inside[k] : 0.5) * ray->dt;
    }
    for (int k = 0; k < 3; k++) point[k] = ray->origin[k] + distance * ray->direction[k];
}

/* What a part of a lamp gives to the middles of steps without what lies in between, in `light`; it is added, as often as
there are parts that give the same, to what all of them give, and to what they would if they faced the steps. */
static void look_up_fluence(const Emitter *emitter, const Ray *ray, float alike, int features, Work *work) {
    int64_t steps = STEPS * work->blocks;
    for (int64_t first = 0; first < steps; first += LANES) {
        Doubles point[3];
        points_in(ray, work, NULL, NULL, steps, first, point);
        Floats found = emitter_fluences(emitter, point);
        store(work->light + first, found);
        if (!features) continue;
        store(work->given + first, load(work->given + first) + alike * found);
        store(work->reference + first, load(work->reference + first) + alike * brightest_of(emitter, point));
    }
}

/* List the ends of blocks. */
static void list_nodes(Work *work) {
    work->nodes = 0;
    for (int64_t b = 0; b < work->blocks; b++) {
        double end = work->place[b] + STEPS * work->size[b];
        int joined = b > 0 && work->place[b] == work->node_place[work->nodes - 1];
        if (!joined) work->node_place[work->nodes++] = work->place[b];
        work->first_node[b] = (int32_t)(work->nodes - 1);
        work->node_place[work->nodes++] = end;
    }
}

/* Add what a part of a lamp gives to the ends of blocks. */
static void add_at_nodes(const Scene *scene, const Emitter *emitter, const Ray *ray, int features, Work *work) {
    const Pass pass = pass_of(emitter, ray);
    for (int64_t first = 0; first < work->nodes; first += LANES) {
        Doubles distance, point[3];
        FOR_LANES(n) distance[n] = ray->near + work->node_place[least_int(first + n, work->nodes - 1)] * ray->dt;
        for (int k = 0; k < 3; k++) point[k] = ray->origin[k] + distance * ray->direction[k];
        Floats found = emitter_fluences(emitter, point);
        for (int64_t v = 0; v < scene->volumes; v++) {
            float *light = work->node_light + v * work->stride + first;
            Doubles passing = (Doubles){0} + pass.passing;
            store(light, load(light) + found * scattered_back_at(scene->media[v].phase, distance - pass.nearest, passing));
        }
        if (!features) continue;
        store(work->node_given + first, load(work->node_given + first) + found);
        store(work->node_reference + first, load(work->node_reference + first) + brightest_of(emitter, point));
    }
}

static void clear_nodes(const Scene *scene, Work *work) {
    size_t size = (size_t)(work->nodes + LANES - 1) / LANES * LANES * sizeof(float);
    for (int64_t v = 0; v < scene->volumes; v++) memset(work->node_light + v * work->stride, 0, size);
    memset(work->node_given, 0, size);
    memset(work->node_reference, 0, size);
}

/* Interpolate between the ends of blocks: at the middles of steps, which are whole lanes. */
static void spread(const float *at_nodes, const Work *work, float *out) {
    const Floats share = {0.125f, 0.375f, 0.625f, 0.875f, 0.125f, 0.375f, 0.625f, 0.875f};
    for (int64_t b = 0; b < work->blocks; b += LANES / STEPS) {
        int32_t node = work->first_node[b], next = work->first_node[least_int(b + 1, work->blocks - 1)];
        float a = at_nodes[node], c = at_nodes[next];
        float more = at_nodes[node + 1] - a, further = at_nodes[next + 1] - c;
        const Floats start = {a, a, a, a, c, c, c, c}, rise = {more, more, more, more, further, further, further, further};
        store(out + STEPS * b, start + share * rise);
    }
}

/* Single scattering, and what the middles of steps are given, from the light at the ends of blocks. */
static void add_from_nodes(const Scene *scene, int features, Work *work, double *single, int64_t stride) {
    int64_t steps = STEPS * work->blocks;
    float *weight = work->received, *light = work->light;
    for (int64_t s = 0; s < steps; s += LANES) {
        Floats start = load(work->whole_start + s), end = load(work->whole_end + s) + load(work->tau + s);
        Floats passed = load(work->transmitted + s) * mean_transmittance(start, end) * load(work->dt + s);
        store(weight + s, passed * load(work->visible + s));
    }
    for (int64_t v = 0; v < scene->volumes; v++) {
        spread(work->node_light + v * work->stride, work, light);
        for (int64_t s = 0; s < steps; s += LANES) store(light + s, load(light + s) * load(weight + s));
        for (int64_t c = 0; c < scene->scattering; c++) {
            single[v * stride + c] += sum_of(scattering_of(scene, work, v, c), light, work);
        }
    }
    if (!features) return;
    spread(work->node_reference, work, light);
    for (int64_t s = 0; s < steps; s += LANES) store(work->reference + s, load(work->reference + s) + load(light + s));
    spread(work->node_given, work, light);
    for (int64_t s = 0; s < steps; s += LANES) store(work->given + s, load(work->given + s) + load(light + s));
}

/* Optical depths of all light of a lamp, at the ends of filled steps, in the only volume. */
static void look_up_mean(const Scene *scene, const Grid *mean, int64_t edges, Work *work) {
    float dark = (float)scene->dark;
    for (int64_t s = 0; s < STEPS * work->blocks; s++) work->start[s] = work->end[s] = dark;
    for (int64_t e = 0; e < edges; e += LANES) {
        double place[LANES];
        Floats position[3];
        FOR_LANES(n) place[n] = work->edge_place[least_int(e + n, edges - 1)];
        positions_at(work->lines, place, position);
        for (int axis = 0; axis < 3; axis++) position[axis] = position[axis] + 1.0f;
        store_at_edges(work, e, (int)least_int(edges - e, LANES), sample_grid(mean, position), work->start, work->end);
    }
}

/* Distance of a lamp's centre from the blocks of a ray. */
static double distance_of(const Lamp *lamp, const Ray *ray, const Work *work) {
    double away[3], begin = ray->near + work->place[0] * ray->dt, square = 0.0;
    double end = ray->near + (work->place[work->blocks - 1] + STEPS * work->size[work->blocks - 1]) * ray->dt;
    for (int k = 0; k < 3; k++) away[k] = lamp->centre[k] - ray->origin[k];
    double nearest = larger(smaller(dot_of(away, ray->direction), end), begin);
    for (int k = 0; k < 3; k++) square += (away[k] - nearest * ray->direction[k]) * (away[k] - nearest * ray->direction[k]);
    return sqrt(square);
}

/* What stands for the light of a lamp in ray features: what it gives, but no less than a part of what it would if it
faced the point. */
static inline Floats reference_of(Floats given, Floats most) {
    most *= LEAST_FACING;
    return clamped_to(choose(given > most, given, most), in_all(1e-30f), in_all(1e30f));
}

/* The light of a lamp at the samples of a ray on a coarse scale. */
static void light_samples(const Scene *scene, const Lamp *lamp, const Ray *ray, int64_t count, Work *work) {
    for (int64_t first = 0; first < count; first += LANES) {
        Doubles point[3];
        Floats given = in_all(0.0f), most = in_all(0.0f);
        points_in(ray, work, work->sample_step, work->sample_inside, count, first, point);
        for (int64_t e = 0; e < lamp->emitters; e++) {
            given += emitter_fluences(lamp->parts + e, point);
            most += brightest_of(lamp->parts + e, point);
        }
        Floats coarse = softened_all(reference_of(given, most), scene->lamp_radius);
        for (int n = 0; n < LANES && first + n < count; n++) {
            work->sample_light[first + n] = coarse[n] > 1e-30f ? coarse[n] : 1e-30f;
        }
    }
}

/* Add the light of a part of a lamp behind the optical depths, and what surfaces let through of it, to those of all. */
static void add_part(const Scene *scene, int alone, Work *work) {
    int64_t room = work->stride, steps = STEPS * work->blocks;
    for (int64_t first = 0; first < steps; first += LANES) {
        Floats found = load(work->light + first), next = found;
        Ints known = load(work->total + first) > 0.0f;
        store(work->lit + first, load(work->lit + first) + found * load(work->visible + first));
        if (alone) continue;
        /* The edge between two steps belongs to the second. */
        FOR_LANES(n) {
            if (n % STEPS < STEPS - 1 && known[n + 1]) next[n] = found[n + 1];
        }
        for (int64_t g = 0; g < scene->groups; g++) {
            float *starts = work->mean_start + g * room + first, *ends = work->mean_end + g * room + first;
            store(starts, load(starts) + found * transmittance(load(work->start + g * room + first)));
            store(ends, load(ends) + next * transmittance(load(work->end + g * room + first)));
        }
    }
}

/* A mean transmittance as an optical depth: the light behind it over that without. */
static inline float depth_of(float passed, float given, float dark) {
    float mean = given > 1e-30f ? passed / given : 0.0f;
    return least(-logf(mean > 1e-30f ? mean : 1e-30f), dark);
}

/* A lamp as one light: what it is on a coarse scale, what is let through of that, and its optical depths. */
static void join_parts(const Scene *scene, int alone, Work *work) {
    int64_t room = work->stride, steps = STEPS * work->blocks;
    for (int64_t first = 0; first < steps; first += LANES) {
        Floats reference = reference_of(load(work->given + first), load(work->reference + first));
        Floats coarse = softened_all(reference, scene->lamp_radius);
        store(work->received + first, choose(load(work->total + first) > 0.0f, coarse, in_all(0.0f)));
        store(work->lit + first, load(work->lit + first) / reference);
    }
    for (int64_t g = 0; g < scene->groups && !alone; g++) {
        float *start = work->start + g * room, *end = work->end + g * room, dark = (float)scene->dark;
        for (int64_t s = 0; s < steps; s++) {
            int64_t next = s % STEPS < STEPS - 1 && work->total[s + 1] > 0.0f ? s + 1 : s;
            int known = work->total[s] > 0.0f;
            start[s] = known ? depth_of(work->mean_start[g * room + s], work->given[s], dark) : dark;
            end[s] = known ? depth_of(work->mean_end[g * room + s], work->given[next], dark) : dark;
        }
    }
}

/* Single scattering and ray features of a lamp of power 1; count: of samples with features. */
static void add_lamp(const Scene *scene, int64_t k, const Ray *ray, int64_t edges, int64_t count, Work *work, int64_t r,
                     Gathered *out) {
    const Lamp *lamp = scene->lamp_list + k;
    int64_t room = work->stride, steps = STEPS * work->blocks;
    int64_t stride = scene->lamps * scene->scattering;
    double *single = out->lamp_scattering + r * scene->volumes * stride + k * scene->scattering;
    for (int64_t v = 0; v < scene->volumes; v++) {
        for (int64_t c = 0; c < scene->scattering; c++) single[v * stride + c] = 0.0;
    }
    int64_t whole = (steps + LANES - 1) / LANES * LANES;
    for (int64_t s = 0; s < whole; s++) {
        work->lit[s] = work->given[s] = work->reference[s] = 0.0f, work->visible[s] = 1.0f;
    }
    for (int64_t g = 0; g < scene->groups; g++) {
        for (int64_t s = 0; s < steps; s++) work->mean_start[g * room + s] = work->mean_end[g * room + s] = 0.0f;
    }
    if (!work->blocks) return;
    double distance = distance_of(lamp, ray, work), longest = 0.0;
    for (int64_t b = 0; b < work->blocks; b++) longest = larger(longest, work->size[b]);
    int mean = lamp->mean && distance >= lamp->mean_from, alone = lamp->emitters == 1 || mean;
    int smooth = STEPS * longest * ray->dt <= lamp->smooth * (distance - lamp->reach);
    if (mean) look_up_mean(scene, lamp->mean, edges, work);
    if (smooth) clear_nodes(scene, work);
    for (int64_t e = 0; e < lamp->emitters; e++) {
        if (!mean) look_up_depths(scene, 0, lamp->columns + e * scene->volumes, edges, work);
        for (int64_t s = 0; s < steps && lamp->shadow_maps; s++) {
            double distance = ray->near + place_in(work, s, 0.5) * ray->dt, point[3];
            if (!(work->total[s] > 0.0f)) continue;
            for (int j = 0; j < 3; j++) point[j] = ray->origin[j] + distance * ray->direction[j];
            work->visible[s] = (float)lamp_visibility(lamp->shadow_maps + e, point);
        }
        if (smooth) {
            add_at_nodes(scene, lamp->parts + e, ray, count > 0, work);
            if (mean && e + 1 < lamp->emitters) continue;
            add_from_nodes(scene, count > 0, work, single, stride);
            if (!mean) clear_nodes(scene, work);
        } else {
            /* All parts of a sphere give the same. */
            int whole = !lamp->parts[e].flat && !lamp->parts[e].cone;
            if (!whole || e == 0) look_up_fluence(lamp->parts + e, ray, whole ? (float)lamp->emitters : 1.0f, count > 0, work);
            add_emitter(scene, lamp->parts + e, ray, work, single, stride);
        }
        if (count) add_part(scene, alone, work);
    }
    if (count) {
        light_samples(scene, lamp, ray, count, work);
        join_parts(scene, alone, work);
    }
    for (int64_t g = 0; g < scene->groups && count; g++) {
        look_up_source(scene, scene->lamp_fluence + g, g, k, ray, work);
        Gathering of = {.fluence = scene->lamp_fluence + g, .visible = work->lit, .received = work->received,
                        .unit = work->sample_light, .stride = scene->groups * scene->lamps * COLUMNS};
        of.features = out->lamp_features + out->samples * of.stride + (g * scene->lamps + k) * COLUMNS;
        gather_features(scene, g, &of, count, work);
    }
}

/* Emitted radiance of the channels, the integral of T(t) e(x(t)) dt. */
static void add_emission(const Scene *scene, const Ray *ray, Work *work, double *emission) {
    fill_blocks(scene, ray, scene->behind_emission, 1, work);
    transmit(work);
    for (int64_t b = 0; b < work->blocks; b++) {
        float through[LANES];
        double place = work->place[b], size = work->size[b];
        Floats tau = load(work->tau + STEPS * b), dt = load(work->dt + STEPS * b);
        store(through, load(work->transmitted + STEPS * b) * mean_transmittance(in_all(0.0f), tau) * dt);
        for (int k = 0; k < STEPS; k++) {
            if (!(place + k * size < (double)ray->count)) through[k] = 0.0f;
        }
        for (int64_t v = 0; v < scene->volumes; v++) {
            const Medium *medium = scene->media + v;
            Nearby nearby = {0, 0.0, 0};
            if (!(medium->emission_factor > 0.0)) continue;
            if (!block_near(scene, medium, work->lines + v, place, size, &nearby)) continue;
            for (int64_t c = 0; c < scene->channels; c++) {
                float sum = 0.0f;
                Floats value = sample_block(medium->emission + c, work->lines + v, place, size);
                Floats size = choose(value < 0.0f, -value, value);
                for (int64_t times = 1; times < medium->emission_power; times++) value *= size;
                for (int k = 0; k < STEPS; k++) {
                    sum += (0.5f * value[SAMPLES * k] + 0.5f * value[SAMPLES * k + 1]) * through[k];
                }
                emission[c] += medium->emission_factor * (double)sum;
            }
        }
    }
}

/* Divide the scratch memory; without memory, only count its bytes. */
static int64_t divide(const Scene *scene, int64_t max_count, char *memory, Work *work) {
    /* Coarse blocks, and what cutting adds: at each level at most some 30 blocks are cut before the steps that are
    allowed grow past any optical depth. An even number, whose steps are whole lanes. */
    int64_t used = 0, blocks = (max_count + LANES - 1) / LANES * (LANES / STEPS) + 40 * 2 * MOST_PARTS * LEVELS;
    int64_t steps = STEPS * (blocks + AHEAD);
    int64_t volumes = scene->volumes, groups = scene->groups;
    int64_t samples = scene->depth_samples * (scene->most_detail > 1 ? scene->most_detail : 1);
    work->room = blocks;
    work->stride = steps;
#define TAKE(field, type, amount)                       \
    work->field = memory ? (type *)(memory + used) : 0; \
    used += ((int64_t)sizeof(type) * (amount) + 63) / 64 * 64;
    TAKE(place, double, blocks)
    TAKE(size, double, blocks)
    TAKE(dt, float, steps)
    TAKE(before, double, blocks + 1)
    TAKE(sigma, float, volumes * steps)
    TAKE(scattering, float, scene->varying ? scene->scattering * volumes * steps : 0)
    TAKE(total, float, steps)
    TAKE(tau, float, steps)
    TAKE(within, float, steps)
    TAKE(far, float, blocks)
    TAKE(transmitted, float, steps)
    TAKE(start, float, groups * steps)
    TAKE(end, float, groups * steps)
    TAKE(whole_start, float, groups == 1 ? 0 : steps)
    TAKE(whole_end, float, groups == 1 ? 0 : steps)
    TAKE(visible, float, steps)
    TAKE(source, float, steps)
    TAKE(group_tau, float, groups * steps)
    TAKE(mean_start, float, scene->lamps ? groups * steps : 0)
    TAKE(mean_end, float, scene->lamps ? groups * steps : 0)
    TAKE(given, float, scene->lamps ? steps : 0)
    TAKE(reference, float, scene->lamps ? steps : 0)
    TAKE(lit, float, scene->lamps ? steps : 0)
    TAKE(received, float, scene->lamps ? steps : 0)
    TAKE(node_place, double, scene->lamps ? steps : 0)
    TAKE(first_node, int32_t, scene->lamps ? blocks : 0)
    TAKE(node_light, float, scene->lamps ? volumes * steps : 0)
    TAKE(node_given, float, scene->lamps ? steps : 0)
    TAKE(node_reference, float, scene->lamps ? steps : 0)
    TAKE(light, float, steps)
    TAKE(edge_place, double, 5 * blocks)
    TAKE(edge_depth, float, 5 * blocks)
    TAKE(edge_from, int32_t, 5 * blocks)
    TAKE(edge_to, int32_t, 5 * blocks)
    TAKE(lines, Line, volumes)
    TAKE(cells, int64_t, LANES * volumes)
    TAKE(near, uint8_t, (AHEAD + 1) * volumes)
    TAKE(sample_step, int64_t, samples)
    TAKE(sample_inside, float, samples)
    TAKE(sample_light, float, samples)
#undef TAKE
    if (groups == 1) work->whole_start = work->start, work->whole_end = work->end;
    return used;
}

static void march_ray(const Scene *scene, const Rays *rays, int64_t r, Work *work, Gathered *out) {
    Ray ray;
    int64_t steps = work->stride;
    start_ray(rays, r, &ray);
    if (out->emission) {
        double *emission = out->emission + r * scene->channels;
        for (int64_t c = 0; c < scene->channels; c++) emission[c] = 0.0;
        add_emission(scene, &ray, work, emission);
    }
    fill_blocks(scene, &ray, scene->behind, 0, work);
    out->blocks += work->looked_at;
    /* What is looked up where there is density, is at the start anyway. */
    if (scene->at_start && !(work->total[0] > 0.0f)) work->total[0] = 1e-30f;
    sample_scattering(scene, &ray, work);

    double reached = 0.0, alpha = -expm1(-work->before[work->blocks]);
    transmit(work);
    for (int64_t b = 0; b < work->blocks; b++) {
        float sum = 0.0f;
        for (int k = 0; k < STEPS; k++) {
            /* The middle of a step stands for the mean distance within it. */
            sum += work->light[STEPS * b + k] * (float)place_in(work, STEPS * b + k, 0.5);
        }
        reached += (double)sum;
    }
    out->alpha[r] = alpha;
    out->depth[r] = ray.near + reached * ray.dt / (alpha > 1e-30 ? alpha : 1e-30);
    for (int64_t v = 0; v < scene->volumes; v++) {
        out->optical_depth[r * scene->volumes + v] = sum_of(work->sigma + v * steps, work->dt, work);
    }
    for (int64_t i = 0; i < scene->volumes * scene->scattering && scene->varying; i++) {
        const float *scattering = scattering_of(scene, work, i / scene->scattering, i % scene->scattering);
        out->scattering_depth[r * scene->volumes * scene->scattering + i] = sum_of(scattering, work->dt, work);
    }
    double *single = out->single_scattering + r * scene->volumes * scene->suns * scene->scattering;
    for (int64_t n = 0; n < scene->volumes * scene->suns * scene->scattering; n++) single[n] = 0.0;

    int64_t most = scene->most_detail > 1 ? scene->most_detail : 1, detail = rays->detail ? rays->detail[r] : 1;
    detail = detail < 1 ? 1 : detail > most ? most : detail;
    int64_t count = place_samples(scene, &ray, alpha, detail, work, out), edges = list_edges(work);
    int features = out->sample_features && count > 0, of_lamps = out->lamp_features && count > 0;
    if (features || of_lamps) sum_groups(scene, work);
    for (int64_t l = 0; l < scene->suns; l++) {
        if (scene->shadow_maps) look_up_visibility(scene, l, &ray, work);
        look_up_depths(scene, l, NULL, edges, work);
        add_single(scene, l, work, single);
        for (int64_t g = 0; g < scene->groups && features; g++) {
            look_up_source(scene, scene->fluence + g, g, l, &ray, work);
            Gathering of = {.fluence = scene->fluence + g, .visible = scene->shadow_maps ? work->visible : NULL};
            of.stride = scene->groups * scene->suns * COLUMNS;
            of.features = out->sample_features + out->samples * of.stride + (g * scene->suns + l) * COLUMNS;
            gather_features(scene, g, &of, count, work);
        }
    }
    if (scene->lamps) list_nodes(work);
    for (int64_t k = 0; k < scene->lamps; k++) add_lamp(scene, k, &ray, edges, of_lamps ? count : 0, work, r, out);
    out->sample_counts[r] = count;
    out->samples += count;
}

/* Bytes of scratch memory for rays of at most so many steps. */
int64_t NAMED(scratch_bytes, VARIANT)(const Scene *scene, int64_t max_count) {
    Work work;
    return divide(scene, max_count < 1 ? 1 : max_count, NULL, &work);
}

/* March rays; returns how many of them, fewer than asked for if they were to stop. */
int64_t NAMED(march, VARIANT)(const Scene *scene, const Rays *rays, Gathered *out) {
    Work work;
    divide(scene, rays->max_count < 1 ? 1 : rays->max_count, rays->scratch, &work);
    out->samples = 0;
    out->blocks = 0;
    for (int64_t r = 0; r < rays->rays; r++) {
        if (rays->stop && *rays->stop) return r;
        march_ray(scene, rays, r, &work, out);
    }
    return rays->rays;
}
