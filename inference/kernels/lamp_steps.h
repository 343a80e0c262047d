/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Light of lamps in the steps of a ray. */

#ifndef MRPNN_LAMP_STEPS_H
#define MRPNN_LAMP_STEPS_H

#include "samples.h"

/* Phase function, 1/sr, of a lamp's light towards the camera at a point that lies `behind` the ray's nearest point to
the lamp; passing: square of the lamp's distance from the ray, distance: from the point. */
static inline double scattered_back(const float *phase, double behind, double passing, double distance) {
    /* The square root of 1 - |cosine|, without cancellation. */
    double position = sqrt(passing / larger(distance * (distance + fabs(behind)), 1e-60)) * MRPNN_PHASES;
    const float *table = phase + (behind > 0.0 ? MRPNN_PHASES + 1 : 0);
    position = position < MRPNN_PHASES ? position : MRPNN_PHASES;
    int64_t cell = within((int64_t)position, MRPNN_PHASES - 1);
    return table[cell] + (position - (double)cell) * (table[cell + 1] - table[cell]);
}

/* As scattered_back, of several points. */
static inline Floats scattered_back_at(const float *phase, Doubles behind, Doubles passing) {
    Floats along = __builtin_convertvector(behind, Floats), size = choose(along > 0.0f, along, -along);
    Floats square = __builtin_convertvector(behind * behind + passing, Floats);
    square = clamped_to(square, in_all(1e-30f), in_all(1e30f));
    Floats distance = square * inverse_roots(square);
    Floats versine = __builtin_convertvector(passing, Floats) / (distance * (distance + size));
    versine = clamped_to(versine, in_all(1e-30f), in_all(1.0f));
    Floats position = versine * inverse_roots(versine) * (float)MRPNN_PHASES, below, above;
    Ints cell = ints_within(to_ints(position), MRPNN_PHASES - 1);
    FOR_LANES(n) {
        const float *at = phase + (along[n] > 0.0f ? MRPNN_PHASES + 1 : 0) + cell[n];
        below[n] = at[0], above[n] = at[1];
    }
    return lerp_lanes(below, above, least_of(position - to_floats(cell), in_all(1.0f)));
}

/* A ray as an emitter sees it. */
typedef struct {
    const Emitter *emitter;
    const Ray *ray;
    double origin[3];  /* of the ray, from the emitter */
    double nearest;    /* distance on the ray to its nearest point to the emitter, */
    double passing;    /* and the square of the emitter's distance from there */
    double lit[2];     /* distances from there between which the emitter may light the ray */
} Pass;

static inline Pass pass_of(const Emitter *emitter, const Ray *ray) {
    Pass pass = {.emitter = emitter, .ray = ray};
    for (int k = 0; k < 3; k++) pass.origin[k] = ray->origin[k] - emitter->position[k];
    pass.nearest = -dot_of(pass.origin, ray->direction);
    for (int k = 0; k < 3; k++) {
        double across = pass.origin[k] + pass.nearest * ray->direction[k];
        pass.passing += across * across;
    }
    lit_interval(emitter, 1.0, ray->origin, ray->direction, pass.lit);
    for (int k = 0; k < 2; k++) pass.lit[k] -= pass.nearest;
    return pass;
}

/* Turn the direction from a spot's emitter to a point into the cone, within which all its light travels; gives `behind`
and `passing` of a light that is seen in that direction at the distance 1. */
static inline void turn_into_cone(const Pass *pass, double *behind, double *passing) {
    const Emitter *emitter = pass->emitter;
    double away[3], direction[3];
    for (int k = 0; k < 3; k++) away[k] = pass->origin[k] + (pass->nearest + *behind) * pass->ray->direction[k];
    double distance = larger(sqrt(dot_of(away, away)), 1e-30), level = dot_of(away, emitter->axis) / distance, tilt = 0.0;
    if (!(level < emitter->bound)) return;
    for (int k = 0; k < 3; k++) {
        away[k] = away[k] / distance - level * emitter->axis[k];
        tilt += away[k] * away[k];
    }
    double across = sqrt(larger(1.0 - emitter->bound * emitter->bound, 0.0)) / larger(sqrt(tilt), 1e-30);
    for (int k = 0; k < 3; k++) direction[k] = emitter->bound * emitter->axis[k] + across * away[k];
    *behind = larger(smaller(dot_of(direction, pass->ray->direction), 1.0), -1.0);
    *passing = 1.0 - *behind * *behind;
}

/* Add the single scattering of a step that is not far shorter than its distance to an emitter: the nodes lie in the
angle under which the emitter sees the step, in which the inverse square is constant.

ends: of the step, from the ray's nearest point to the emitter. weight: of its light. */
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
            if (!(work->sigma[work->rows[v] + s] > 0.0f)) continue;
            double phase = scattered_back(scene->media[v].phase, behind, passing, distance);
            for (int64_t c = 0; c < scene->scattering; c++) {
                single[v * stride + c] += light * scattering_of(scene, work, v, c)[s] * phase;
            }
        }
    }
}

/* Add the single scattering of a node in each of the `used` steps: its distance behind the ray's nearest point to the
emitter, and the light there times the length that the node stands for. */
static inline void add_node(const Scene *scene, const Pass *pass, Ints used, Doubles behind, Floats light, int64_t first,
                            const Work *work, double *single, int64_t stride) {
    Doubles passing = (Doubles){0} + pass->passing;
    if (pass->emitter->cone) {
        FOR_LANES(n) {
            double turned = behind[n], apart = pass->passing;
            turn_into_cone(pass, &turned, &apart);
            behind[n] = turned, passing[n] = apart;
        }
    }
    for (int64_t v = 0; v < scene->volumes; v++) {
        Ints filled = used & (load(work->sigma + work->rows[v] + first) > 0.0f);
        if (!any_lane(filled)) continue;
        Floats scattered = light * scattered_back_at(scene->media[v].phase, behind, passing);
        for (int64_t c = 0; c < scene->scattering; c++) {
            Floats added = scattered * load(scattering_of(scene, work, v, c) + first);
            double sum = 0.0;
            FOR_LANES(n) sum += filled[n] ? (double)added[n] : 0.0;
            single[v * stride + c] += sum;
        }
    }
}

/* Single scattering of an emitter: as add_single, with the integrals over steps of its fluence times the phase
function. Steps that are very short for their distance have a node in their middle, others two, and steps that are not
far shorter than their distance the nodes of add_bent. */
static void add_emitter(const Scene *scene, const Emitter *emitter, const Ray *ray, const Work *work, double *single,
                        int64_t stride) {
    const Pass pass = pass_of(emitter, ray);
    double wide = scene->wide * scene->wide, brief = scene->brief * scene->brief;
    double extent = pass.passing + emitter->extent * emitter->extent;
    for (int64_t first = work->lit_from; first < work->lit_to; first += LANES) {
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

/* World points within steps. The last step again where there are no more. */
static inline void points_in(const Ray *ray, const Work *work, const int64_t *numbers, const float *inside, int64_t count,
                             int64_t first, Doubles *point) {
    Doubles distance;
    FOR_LANES(n) {
        int64_t k = least_int(first + n, count - 1);
        distance[n] = ray->near + place_in(work, numbers ? numbers[k] : k, inside ? (double)inside[k] : 0.5) * ray->dt;
    }
    for (int k = 0; k < 3; k++) point[k] = ray->origin[k] + distance * ray->direction[k];
}

/* Unattenuated fluence of an emitter in the middles of steps, in `light`. It is added, times the number of emitters
that are alike, to the lamp's, and so is, times `facing`, the fluence that it would have if it faced the steps. */
static void look_up_fluence(const Emitter *emitter, const Ray *ray, float alike, float facing, Work *work) {
    int64_t steps = STEPS * work->blocks;
    for (int64_t first = facing > 0.0f ? 0 : work->lit_from; first < steps; first += LANES) {
        int lit = first >= work->lit_from && first < work->lit_to;
        Doubles point[3];
        if (!lit && !(facing > 0.0f)) break;
        points_in(ray, work, NULL, NULL, steps, first, point);
        if (lit) {
            Floats fluence = emitter_fluences(emitter, point);
            store(work->light + first, fluence);
            store(work->fluence + first, load(work->fluence + first) + alike * fluence);
        }
        if (!(facing > 0.0f)) continue;
        store(work->reference + first, load(work->reference + first) + facing * brightest_of(emitter, point));
    }
}

/* Tell which steps an emitter may light, and a step on either side. */
static void find_lit(const Emitter *emitter, const Ray *ray, Work *work) {
    int64_t steps = STEPS * work->blocks, from = steps, to = 0;
    double lit[2];
    lit_interval(emitter, DISKS_REACH, ray->origin, ray->direction, lit);
    double begin = (lit[0] - ray->near) / ray->dt, end = (lit[1] - ray->near) / ray->dt;
    for (int64_t b = 0; b < work->blocks; b++) {
        if (!(work->place[b] + STEPS * work->size[b] >= begin && work->place[b] <= end)) continue;
        from = least_int(from, STEPS * b), to = STEPS * (b + 1);
    }
    from = from > 0 ? from - 1 : 0;
    work->lit_from = from / LANES * LANES;
    work->lit_to = to ? (least_int(to + 1, steps) + LANES - 1) / LANES * LANES : work->lit_from;
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

/* Add the light of an emitter at the ends of blocks. */
static void add_at_nodes(const Scene *scene, const Emitter *emitter, const Ray *ray, int features, Work *work) {
    const Pass pass = pass_of(emitter, ray);
    for (int64_t first = 0; first < work->nodes; first += LANES) {
        Doubles distance, point[3];
        FOR_LANES(n) distance[n] = ray->near + work->node_place[least_int(first + n, work->nodes - 1)] * ray->dt;
        for (int k = 0; k < 3; k++) point[k] = ray->origin[k] + distance * ray->direction[k];
        Floats fluence = emitter_fluences(emitter, point);
        for (int64_t v = 0; v < scene->volumes; v++) {
            float *light = work->node_light + work->rows[v] + first;
            Doubles passing = (Doubles){0} + pass.passing, behind = distance - pass.nearest;
            store(light, load(light) + fluence * scattered_back_at(scene->media[v].phase, behind, passing));
        }
        if (!features) continue;
        store(work->node_fluence + first, load(work->node_fluence + first) + fluence);
        store(work->node_reference + first, load(work->node_reference + first) + brightest_of(emitter, point));
    }
}

static void clear_nodes(const Scene *scene, Work *work) {
    size_t size = (size_t)(work->nodes + LANES - 1) / LANES * LANES * sizeof(float);
    for (int64_t v = 0; v < scene->volumes; v++) memset(work->node_light + work->rows[v], 0, size);
    memset(work->node_fluence, 0, size);
    memset(work->node_reference, 0, size);
}

/* Interpolate between the ends of blocks: at the middles of steps, which are whole lanes. */
static void interpolate_nodes(const float *at_nodes, const Work *work, float *out) {
    const Floats fraction = {0.125f, 0.375f, 0.625f, 0.875f, 0.125f, 0.375f, 0.625f, 0.875f};
    for (int64_t b = 0; b < work->blocks; b += LANES / STEPS) {
        int32_t node = work->first_node[b], next = work->first_node[least_int(b + 1, work->blocks - 1)];
        float a = at_nodes[node], c = at_nodes[next];
        float more = at_nodes[node + 1] - a, further = at_nodes[next + 1] - c;
        const Floats start = {a, a, a, a, c, c, c, c}, rise = {more, more, more, more, further, further, further, further};
        store(out + STEPS * b, start + fraction * rise);
    }
}

/* Single scattering, and fluence in the middles of steps, from the light at the ends of blocks. */
static void add_from_nodes(const Scene *scene, int features, Work *work, double *single, int64_t stride) {
    int64_t steps = STEPS * work->blocks;
    float *weight = work->received, *light = work->light;
    for (int64_t s = 0; s < steps; s += LANES) {
        Floats start = load(work->whole_start + s), end = load(work->whole_end + s) + load(work->tau + s);
        Floats passed = load(work->transmitted + s) * mean_transmittance(start, end) * load(work->dt + s);
        store(weight + s, passed * load(work->visible + s));
    }
    for (int64_t v = 0; v < scene->volumes; v++) {
        interpolate_nodes(work->node_light + work->rows[v], work, light);
        for (int64_t s = 0; s < steps; s += LANES) store(light + s, load(light + s) * load(weight + s));
        for (int64_t c = 0; c < scene->scattering; c++) {
            single[v * stride + c] += sum_of(scattering_of(scene, work, v, c), light, work);
        }
    }
    if (!features) return;
    interpolate_nodes(work->node_reference, work, light);
    for (int64_t s = 0; s < steps; s += LANES) store(work->reference + s, load(work->reference + s) + load(light + s));
    interpolate_nodes(work->node_fluence, work, light);
    for (int64_t s = 0; s < steps; s += LANES) store(work->fluence + s, load(work->fluence + s) + load(light + s));
}

/* Mean optical depths of a lamp's light at the edges that are listed, in the only volume. */
static void look_up_mean(const Scene *scene, const Grid *mean, int64_t listed, Work *work) {
    float dark = (float)scene->dark;
    for (int64_t s = 0; s < STEPS * work->blocks; s++) work->start[s] = work->end[s] = dark;
    for (int64_t e = 0; e < listed; e += LANES) {
        double place[LANES];
        Floats position[3];
        FOR_LANES(n) place[n] = work->edge_place[work->listed[least_int(e + n, listed - 1)]];
        positions_at(work->lines, place, position);
        for (int axis = 0; axis < 3; axis++) position[axis] = position[axis] + 1.0f;
        store_at_edges(work, work->listed + e, (int)least_int(listed - e, LANES), sample_grid(mean, position), work->start, work->end);
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

/* Whether the emitters of a lamp are parts of one sphere. */
static inline int of_one_sphere(const Lamp *lamp) {
    for (int64_t e = 0; e < lamp->emitters; e++) {
        const Emitter *part = lamp->parts + e;
        if (part->flat || memcmp(part->centre, lamp->parts->centre, sizeof part->centre)) return 0;
        if (part->radius != lamp->parts->radius || part->intensity != lamp->parts->intensity) return 0;
    }
    return 1;
}

/* Fluence of a lamp in ray features: no less than a fraction of the fluence if it faced the point. */
static inline Floats reference_of(Floats fluence, Floats most) {
    most *= LEAST_FACING;
    return clamped_to(choose(fluence > most, fluence, most), in_all(1e-30f), in_all(1e30f));
}

/* The light of a lamp at the samples of a ray on a coarse scale. */
static void light_samples(const Scene *scene, const Lamp *lamp, const Ray *ray, int64_t count, Work *work) {
    for (int64_t first = 0; first < count; first += LANES) {
        Doubles point[3];
        Floats fluence = in_all(0.0f), most = in_all(0.0f);
        points_in(ray, work, work->sample_step, work->sample_inside, count, first, point);
        for (int64_t e = 0; e < lamp->emitters; e++) {
            fluence += emitter_fluences(lamp->parts + e, point);
            most += brightest_of(lamp->parts + e, point);
        }
        Floats coarse = softened(reference_of(fluence, most), scene->lamp_radius);
        for (int n = 0; n < LANES && first + n < count; n++) {
            work->sample_light[first + n] = coarse[n] > 1e-30f ? coarse[n] : 1e-30f;
        }
    }
}

/* Add an emitter's light, attenuated by the optical depths, and by surfaces, to the sums over emitters. */
static void add_part(const Scene *scene, int alone, Work *work) {
    for (int64_t first = work->lit_from; first < work->lit_to; first += LANES) {
        Floats light = load(work->light + first), next = light;
        Ints filled = load(work->total + first) > 0.0f;
        store(work->lit + first, load(work->lit + first) + light * load(work->visible + first));
        if (alone) continue;
        /* The edge between two steps belongs to the second. */
        FOR_LANES(n) {
            if (n % STEPS < STEPS - 1 && filled[n + 1]) next[n] = light[n + 1];
        }
        for (int64_t g = 0; g < scene->groups; g++) {
            int64_t at = work->group_rows[g] + first;
            float *starts = work->mean_start + at, *ends = work->mean_end + at;
            store(starts, load(starts) + light * transmittance(load(work->start + at)));
            store(ends, load(ends) + next * transmittance(load(work->end + at)));
        }
    }
}

/* A mean transmittance as an optical depth: the light behind it over that without. */
static inline float depth_of(float passed, float fluence, float dark) {
    float mean = fluence > 1e-30f ? passed / fluence : 0.0f;
    return least(-logf(mean > 1e-30f ? mean : 1e-30f), dark);
}

/* A lamp as a single light: fluence on a coarse scale, the fraction that surfaces let through, and optical depths. */
static void join_parts(const Scene *scene, int alone, Work *work) {
    int64_t steps = STEPS * work->blocks;
    for (int64_t first = 0; first < steps; first += LANES) {
        Floats reference = reference_of(load(work->fluence + first), load(work->reference + first));
        Floats coarse = softened(reference, scene->lamp_radius);
        store(work->received + first, choose(load(work->total + first) > 0.0f, coarse, in_all(0.0f)));
        store(work->lit + first, load(work->lit + first) / reference);
    }
    for (int64_t g = 0; g < scene->groups && !alone; g++) {
        int64_t row = work->group_rows[g];
        float *start = work->start + row, *end = work->end + row, dark = (float)scene->dark;
        for (int64_t s = 0; s < steps; s++) {
            int64_t next = s % STEPS < STEPS - 1 && work->total[s + 1] > 0.0f ? s + 1 : s;
            int filled = work->total[s] > 0.0f;
            start[s] = filled ? depth_of(work->mean_start[row + s], work->fluence[s], dark) : dark;
            end[s] = filled ? depth_of(work->mean_end[row + s], work->fluence[next], dark) : dark;
        }
    }
}

/* What tells the visibility of an emitter. */
typedef struct {
    const LampShadowMap *map;
    const Ray *ray;
} LampShadow;

static float lamp_visible_at(const void *from, double place) {
    const LampShadow *shadow = from;
    double along = shadow->ray->near + place * shadow->ray->dt, point[3];
    for (int j = 0; j < 3; j++) point[j] = shadow->ray->origin[j] + along * shadow->ray->direction[j];
    return (float)lamp_visibility(shadow->map, point);
}

/* Single scattering and ray features of a lamp of power 1; count: of samples with features. */
static void add_lamp(const Scene *scene, int64_t k, const Ray *ray, int64_t edges, int64_t count, Work *work, int64_t r,
                     Gathered *out) {
    const Lamp *lamp = scene->lamp_list + k;
    int64_t most_steps = work->stride, steps = STEPS * work->blocks;
    int64_t stride = scene->lamps * scene->scattering;
    double *single = out->lamp_scattering + r * scene->volumes * stride + k * scene->scattering;
    for (int64_t v = 0; v < scene->volumes; v++) {
        for (int64_t c = 0; c < scene->scattering; c++) single[v * stride + c] = 0.0;
    }
    int64_t whole = (steps + LANES - 1) / LANES * LANES;
    for (int64_t s = 0; s < whole; s++) {
        work->lit[s] = work->fluence[s] = work->reference[s] = 0.0f, work->visible[s] = 1.0f;
    }
    for (int64_t g = 0; g < scene->groups; g++) {
        for (int64_t s = 0; s < steps; s++) work->mean_start[g * most_steps + s] = work->mean_end[g * most_steps + s] = 0.0f;
    }
    if (!work->blocks) return;
    double distance = distance_of(lamp, ray, work), longest = 0.0;
    for (int64_t b = 0; b < work->blocks; b++) longest = larger(longest, work->size[b]);
    int mean = lamp->mean && distance >= lamp->mean_from, alone = lamp->emitters == 1 || mean;
    int smooth = STEPS * longest * ray->dt <= lamp->smooth * (distance - lamp->reach);
    work->lit_from = 0, work->lit_to = steps;
    if (mean) look_up_mean(scene, lamp->mean, list_lit(0, edges, work), work);
    if (smooth) clear_nodes(scene, work);
    for (int64_t e = 0; e < lamp->emitters; e++) {
        const Emitter *emitter = lamp->parts + e;
        find_lit(emitter, ray, work);
        if (lamp->shadow_maps) {
            LampShadow shadow = {lamp->shadow_maps + e, ray};
            look_up_visibility(lamp_visible_at, &shadow, work);
        }
        /* The mean depth of several emitters is that of their light without surfaces. */
        int shaded = lamp->shadow_maps && (alone || !count);
        if (!mean) look_up_depths(scene, 0, lamp->columns + e * scene->volumes, list_lit(shaded, edges, work), work);
        if (smooth) {
            add_at_nodes(scene, emitter, ray, count > 0, work);
            if (mean && e + 1 < lamp->emitters) continue;
            add_from_nodes(scene, count > 0, work, single, stride);
            if (!mean) clear_nodes(scene, work);
        } else {
            /* All emitters of a sphere give the same, but for a cone. */
            int sphere = of_one_sphere(lamp), alike = sphere && !emitter->cone;
            float times = alike ? (float)lamp->emitters : 1.0f;
            float facing = !count ? 0.0f : !sphere ? 1.0f : e == 0 ? (float)lamp->emitters : 0.0f;
            if (!alike || e == 0) look_up_fluence(emitter, ray, times, facing, work);
            add_emitter(scene, emitter, ray, work, single, stride);
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

#endif
