/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Light of suns in the steps of a ray: optical depths towards suns, transmittance, and single scattering. */

#ifndef MRPNN_LIT_STEPS_H
#define MRPNN_LIT_STEPS_H

#include "lamp_sampling.h"
#include "steps.h"

/* Scattering coefficients of the steps of all blocks, where albedos vary. */
static void sample_scattering(const Scene *scene, const Ray *ray, Work *work) {
    for (int64_t m = 0; m < work->met_count && scene->varying; m++) {
        int64_t v = work->met[m];
        const Medium *medium = scene->media + v;
        const float *sigma = work->sigma + work->rows[v];
        if (!medium->varies) continue;
        for (int64_t c = 0; c < scene->scattering; c++) {
            float *scattering = work->scattering + c * work->most_met * work->stride + work->rows[v];
            for (int64_t b = 0; b < work->blocks; b++) {
                const float *extinction = sigma + STEPS * b;
                float *out = scattering + STEPS * b;
                double place = work->place[b], size = work->size[b];
                int filled = 0;
                for (int k = 0; k < STEPS; k++) out[k] = 0.0f, filled |= extinction[k] > 0.0f;
                if (!filled) continue;
                Floats samples = sample_block(medium->scattering + c, work->lines + v, place, size);
                Steps scattered = step_means(samples, ray, place, size) * (float)medium->sigma_t;
                /* Interpolation in single precision may leave a little where there is no density. */
                for (int k = 0; k < STEPS; k++) out[k] = scattered[k] < extinction[k] ? scattered[k] : extinction[k];
            }
        }
    }
}

/* Scattering coefficients of a volume in a colour channel at steps: its extinction, for albedo 1, where the albedo does
not vary. */
static inline const float *scattering_of(const Scene *scene, const Work *work, int64_t v, int64_t c) {
    return (scene->media[v].varies ? work->scattering + c * work->most_met * work->stride : work->sigma) + work->rows[v];
}

/* Position on the ray of a point within a step. */
static inline double place_in(const Work *work, int64_t step, double inside) {
    int64_t block = step / STEPS;
    return work->place[block] + ((double)(step % STEPS) + inside) * work->size[block];
}

/* Parts of a step in whose middles visibility is looked up where it changes. */
#define VISIBLE_PARTS 8

/* Visibility of a light, 0 to 1, at a place on the ray; `from`: what tells it. */
typedef float (*VisibleAt)(const void *from, double place);

/* Fill `visible` in filled steps that may be lit: as in the middle of each, and the mean over a step where that differs from the step
before or behind it, so that edges of shadows do not jump from step to step. */
static void look_up_visibility(VisibleAt visible_at, const void *from, Work *work) {
    int64_t first = work->lit_from, steps = least_int(work->lit_to, STEPS * work->blocks);
    for (int64_t s = first; s < steps; s++) {
        work->visible[s] = work->total[s] > 0.0f ? visible_at(from, place_in(work, s, 0.5)) : 1.0f;
    }
    float before = -1.0f;
    for (int64_t s = first; s < steps; s++) {
        float middle = work->visible[s], sum = 0.0f;
        int filled = work->total[s] > 0.0f, followed = s + 1 < steps && work->total[s + 1] > 0.0f;
        float behind = followed ? work->visible[s + 1] : middle;
        int differs = filled && (behind != middle || (before >= 0.0f && before != middle));
        before = filled ? middle : -1.0f;
        if (!differs) continue;
        for (int n = 0; n < VISIBLE_PARTS; n++) sum += visible_at(from, place_in(work, s, (n + 0.5) / VISIBLE_PARTS));
        work->visible[s] = sum / VISIBLE_PARTS;
    }
}

/* What tells the visibility of a sun. */
typedef struct {
    const ShadowMap *map;
    Line line;
} SunShadow;

static float sun_visible_at(const void *from, double place) {
    const SunShadow *shadow = from;
    float position[3];
    position_at(&shadow->line, place, position);
    return visibility_of(shadow->map, position);
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

/* List the edges of steps that may be lit, where `shaded` of those that surfaces do not hide from the light: nothing else
depends on the depth. Returns their number. */
static int64_t list_lit(int shaded, int64_t edges, Work *work) {
    int64_t count = 0;
    for (int64_t e = 0; e < edges; e++) {
        int32_t from = work->edge_from[e], to = work->edge_to[e];
        int begins = from >= work->lit_from && from < work->lit_to && (!shaded || work->visible[from] > 0.0f);
        int ends = to >= work->lit_from && to < work->lit_to && (!shaded || work->visible[to] > 0.0f);
        work->listed[count] = (int32_t)e;
        count += begins | ends;
    }
    return count;
}

/* Store depths at edges with the steps that start and end there. */
static inline void store_at_edges(const Work *work, const int32_t *edges, int used, Floats depths, float *start, float *end) {
    float values[LANES];
    memcpy(values, &depths, sizeof values);
    for (int n = 0; n < used; n++) {
        int32_t from = work->edge_from[edges[n]], to = work->edge_to[edges[n]];
        if (from >= 0) start[from] = values[n];
        if (to >= 0) end[to] = values[n];
    }
}

/* Optical depths of each group and of all volumes towards one light, at the edges that are listed; the depths of steps
without such edges are those of darkness.

l: number of the sun. columns: (volumes), around an emitter, or NULL for the sun. listed: number of the edges. */
static void look_up_depths(const Scene *scene, int64_t l, const LampColumns *const *columns, int64_t listed, Work *work) {
    int64_t steps = STEPS * work->blocks;
    float dark = (float)scene->dark;
    int single_group = scene->groups == 1, outside = scene->volumes > 1 || scene->at_start;
    for (int64_t s = 0; s < steps && !single_group; s++) work->whole_start[s] = work->whole_end[s] = dark;
    for (int64_t n = 0; n < work->active_count; n++) {
        int64_t g = work->active[n];
        float *start = work->start + work->group_rows[g], *end = work->end + work->group_rows[g];
        for (int64_t s = 0; s < steps && work->group_met[g]; s++) start[s] = end[s] = dark;
    }
    for (int64_t e = 0; e < listed; e += LANES) {
        const int32_t *numbers = work->listed + e;
        double place[LANES];
        Floats depth, total = in_all(0.0f);
        /* The last edge again where there are no more. */
        FOR_LANES(n) {
            int64_t edge = work->listed[least_int(e + n, listed - 1)];
            place[n] = work->edge_place[edge], depth[n] = work->edge_depth[edge];
        }
        int used = (int)least_int(listed - e, LANES);
        for (int64_t n = 0; n < work->active_count; n++) {
            int64_t g = work->active[n];
            Floats sum = in_all(0.0f);
            for (int64_t m = scene->group_starts[g]; m < scene->group_starts[g + 1]; m++) {
                int64_t v = scene->group_members[m];
                if (!work->shades[v]) continue;
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
                sum += volume_sun_depth(&medium->density, sun, extinction, position, depth, outside);
            }
            if (work->group_met[g]) store_at_edges(work, numbers, used, sum, work->start + work->group_rows[g], work->end + work->group_rows[g]);
            total += sum;
        }
        if (!single_group) store_at_edges(work, numbers, used, total, work->whole_start, work->whole_end);
    }
}

/* Transmittance to the starts of blocks and of steps, and how much of it steps take, in `light`. */
static void transmit(Work *work) {
    for (int64_t b = 0; b < work->blocks; b += LANES) {
        Floats rounded, rounding;
        FOR_LANES(n) {
            double before = work->before[b + n < work->blocks ? b + n : work->blocks];
            rounded[n] = (float)before;
            rounding[n] = (float)(before - (double)rounded[n]);
        }
        store(work->far + b, transmittance(rounded) * (1.0f - rounding));
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
    double total = 0.0;
    for (int64_t s = 0; s < STEPS * work->blocks; s += STEPS) {
        float sum = 0.0f;
        for (int k = 0; k < STEPS; k++) sum += a[s + k] * b[s + k];
        total += (double)sum;
    }
    return total;
}

/* Single scattering of one sun: the integral over each step of sigma exp(-tau to the camera - tau to the sun). */
static void add_single(const Scene *scene, int64_t l, Work *work, double *single) {
    int64_t steps = STEPS * work->blocks;
    float *light = work->light;
    for (int64_t s = 0; s < steps; s += LANES) {
        Floats start = load(work->whole_start + s), end = load(work->whole_end + s) + load(work->tau + s);
        Floats scattered = load(work->transmitted + s) * mean_transmittance(start, end) * load(work->dt + s);
        store(light + s, scene->shadow_maps ? scattered * load(work->visible + s) : scattered);
    }
    for (int64_t n = 0; n < work->met_count * scene->scattering; n++) {
        int64_t v = work->met[n / scene->scattering], c = n % scene->scattering;
        single[(v * scene->suns + l) * scene->scattering + c] += sum_of(scattering_of(scene, work, v, c), light, work);
    }
}

/* 4 pi times the scattered light of one light that scatters towards the camera, in the middle of each filled step from
the first sample on.

fluence: of group g. l: number of the light. */
static void look_up_source(const Scene *scene, const Fluence *fluence, int64_t g, int64_t l, const Ray *ray, Work *work) {
    int64_t from = work->sample_step[0];
    const float *tau = work->group_tau + work->group_rows[g];
    int64_t steps = STEPS * work->blocks;
    if (!fluence->lights) {
        memset(work->source, 0, (size_t)steps * sizeof *work->source);
        return;
    }
    const float *light = fluence->lights[l], scale = fluence->scales ? (float)fluence->scales[l] : 1.0f;
    /* Light is told where the volumes are at the frame; those of a group move with the first. */
    Ray moved;
    int64_t first = scene->group_members[scene->group_starts[g]];
    ray = ray_of(scene->media + first, ray, &moved);
    Line line = line_in(fluence->linear, fluence->offset, ray);
    if (work->is_met[first]) line.shifts = work->lines[first].shifts, line.last = work->lines[first].last;
    float weight[3], jitter[3], most = (float)(fluence->cells - 1);
    for (int i = 0; i < 3; i++) {
        double sum = 0.0;
        for (int j = 0; j < 3; j++) sum += fluence->flux_from_world[3 * i + j] * ray->direction[j];
        weight[i] = (float)sum;
        jitter[i] = (float)scene->jitter[i];
    }
    for (int64_t s = from / LANES * LANES; s < steps; s += LANES) {
        double middle[LANES];
        Floats number, light_towards;
        Ints cell = {0};
        for (int k = 0; k < LANES / STEPS; k++) {
            int64_t block = least_int(s / STEPS + k, work->blocks - 1);
            double size = work->size[block], place = work->place[block];
            /* Of the step on a ray that consists of such steps alone; sizes are powers of two. */
            double number_there = place / size;
            for (int n = 0; n < STEPS; n++) {
                middle[STEPS * k + n] = place + (n + 0.5) * size;
                number[STEPS * k + n] = (float)(number_there + n);
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
        light_towards = first_of(fluence_and_x) + weight[0] * second_of(fluence_and_x);
        light_towards = light_towards + weight[1] * first_of(y_and_z) + weight[2] * second_of(y_and_z);
        Ints filled = (load(tau + s) > 0.0f) & (light_towards > 0.0f);
        store(work->source + s, choose(filled, light_towards * scale, in_all(0.0f)));
    }
}

#endif
