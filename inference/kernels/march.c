/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Camera rays through volumes, one after another; tests/reference/march.py does the same in numpy.

Compiled once for each kind of processor, with the name of the kind as VARIANT. */

#include "lamp_steps.h"
#include "variants.h"

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
        for (int64_t m = 0; m < work->met_count; m++) {
            int64_t v = work->met[m];
            const Medium *medium = scene->media + v;
            Nearby nearby = {0, 0.0, 0};
            if (!(medium->emission_factor > 0.0)) continue;
            if (!block_near(scene, medium, work->lines + v, place, size, &nearby)) continue;
            for (int64_t c = 0; c < scene->channels; c++) {
                float sum = 0.0f;
                Floats value = sample_block(medium->emission + c, work->lines + v, place, size);
                Floats absolute = choose(value < 0.0f, -value, value);
                for (int64_t times = 1; times < medium->emission_power; times++) value *= absolute;
                for (int k = 0; k < STEPS; k++) {
                    sum += (0.5f * value[SAMPLES * k] + 0.5f * value[SAMPLES * k + 1]) * through[k];
                }
                emission[c] += medium->emission_factor * (double)sum;
            }
        }
    }
}

/* Divide the scratch memory; without memory, only count its bytes. */
static int64_t divide(const Scene *scene, const Rays *rays, char *memory, Work *work) {
    /* Coarse blocks, and those that cutting adds: at each level at most about 30 blocks are cut before the limit of
    steps grows past any optical depth. An even number, whose steps are whole lanes. */
    int64_t max_count = rays->max_count < 1 ? 1 : rays->max_count;
    int64_t used = 0, blocks = (max_count + LANES - 1) / LANES * (LANES / STEPS) + 40 * 2 * MOST_PARTS * LEVELS;
    int64_t steps = STEPS * (blocks + AHEAD);
    int64_t volumes = scene->volumes, met = least_int(rays->most_met, volumes), groups = least_int(scene->groups, met);
    int64_t samples = scene->depth_samples * (scene->most_detail > 1 ? scene->most_detail : 1);
    work->most_blocks = blocks;
    work->most_met = met;
    work->stride = steps;
    /* One more than steps, in whole lanes. */
    work->shift_stride = 3 * ((max_count + STEPS) / LANES + 2) * LANES;
#define TAKE(field, type, amount)                       \
    work->field = memory ? (type *)(memory + used) : 0; \
    used += ((int64_t)sizeof(type) * (amount) + 63) / 64 * 64;
    TAKE(place, double, blocks)
    TAKE(size, double, blocks)
    TAKE(dt, float, steps)
    TAKE(before, double, blocks + 1)
    TAKE(sigma, float, met * steps)
    TAKE(scattering, float, scene->varying ? scene->scattering * met * steps : 0)
    TAKE(total, float, steps)
    TAKE(tau, float, steps)
    TAKE(within, float, steps)
    TAKE(far, float, blocks)
    TAKE(transmitted, float, steps)
    TAKE(start, float, groups * steps)
    TAKE(end, float, groups * steps)
    TAKE(whole_start, float, scene->groups == 1 ? 0 : steps)
    TAKE(whole_end, float, scene->groups == 1 ? 0 : steps)
    TAKE(visible, float, steps)
    TAKE(source, float, steps)
    TAKE(group_tau, float, groups * steps)
    TAKE(mean_start, float, scene->lamps ? groups * steps : 0)
    TAKE(mean_end, float, scene->lamps ? groups * steps : 0)
    TAKE(fluence, float, scene->lamps ? steps : 0)
    TAKE(reference, float, scene->lamps ? steps : 0)
    TAKE(lit, float, scene->lamps ? steps : 0)
    TAKE(received, float, scene->lamps ? steps : 0)
    TAKE(node_place, double, scene->lamps ? steps : 0)
    TAKE(first_node, int32_t, scene->lamps ? blocks : 0)
    TAKE(node_light, float, scene->lamps ? met * steps : 0)
    TAKE(node_fluence, float, scene->lamps ? steps : 0)
    TAKE(node_reference, float, scene->lamps ? steps : 0)
    TAKE(light, float, steps)
    TAKE(edge_place, double, 5 * blocks)
    TAKE(edge_depth, float, 5 * blocks)
    TAKE(edge_from, int32_t, 5 * blocks)
    TAKE(edge_to, int32_t, 5 * blocks)
    TAKE(listed, int32_t, 5 * blocks)
    TAKE(lines, Line, volumes)
    TAKE(shifts, float, scene->flowing ? volumes * work->shift_stride : 0)
    TAKE(met, int64_t, volumes)
    TAKE(active, int64_t, scene->groups)
    TAKE(rows, int64_t, volumes)
    TAKE(group_rows, int64_t, scene->groups)
    TAKE(is_met, uint8_t, volumes)
    TAKE(shades, uint8_t, volumes)
    TAKE(group_met, uint8_t, scene->groups)
    TAKE(cells, int64_t, LANES * volumes)
    TAKE(near, uint8_t, (AHEAD + 1) * volumes)
    TAKE(sample_step, int64_t, samples)
    TAKE(sample_inside, float, samples)
    TAKE(sample_light, float, samples)
#undef TAKE
    if (scene->groups == 1) work->whole_start = work->start, work->whole_end = work->end;
    return used;
}

static void march_ray(const Scene *scene, const Rays *rays, int64_t r, Work *work, Gathered *out) {
    Ray ray;
    start_ray(rays, r, &ray);
    find_met(scene, &ray, work);
    if (out->emission) {
        double *emission = out->emission + r * scene->channels;
        for (int64_t c = 0; c < scene->channels; c++) emission[c] = 0.0;
        add_emission(scene, &ray, work, emission);
    }
    fill_blocks(scene, &ray, scene->behind, 0, work);
    out->blocks += work->looked_at;
    /* Light is looked up only where there is density; at the start it is wanted anyway. */
    if (scene->at_start && !(work->total[0] > 0.0f)) work->total[0] = 1e-30f;
    sample_scattering(scene, &ray, work);

    double reached = 0.0, alpha = -expm1(-work->before[work->blocks]);
    transmit(work);
    for (int64_t b = 0; b < work->blocks; b++) {
        float sum = 0.0f;
        for (int k = 0; k < STEPS; k++) {
            /* The middle of a step approximates the mean distance within it. */
            sum += work->light[STEPS * b + k] * (float)place_in(work, STEPS * b + k, 0.5);
        }
        reached += (double)sum;
    }
    out->alpha[r] = alpha;
    out->depth[r] = ray.near + reached * ray.dt / (alpha > 1e-30 ? alpha : 1e-30);
    for (int64_t v = 0; v < scene->volumes; v++) {
        out->optical_depth[r * scene->volumes + v] = work->is_met[v] ? sum_of(work->sigma + work->rows[v], work->dt, work) : 0.0;
    }
    for (int64_t i = 0; i < scene->volumes * scene->scattering && scene->varying; i++) {
        int64_t v = i / scene->scattering;
        const float *scattering = scattering_of(scene, work, v, i % scene->scattering);
        out->scattering_depth[r * scene->volumes * scene->scattering + i] = work->is_met[v] ? sum_of(scattering, work->dt, work) : 0.0;
    }
    double *single = out->single_scattering + r * scene->volumes * scene->suns * scene->scattering;
    for (int64_t n = 0; n < scene->volumes * scene->suns * scene->scattering; n++) single[n] = 0.0;

    int64_t most = scene->most_detail > 1 ? scene->most_detail : 1, detail = rays->detail ? rays->detail[r] : 1;
    detail = detail < 1 ? 1 : detail > most ? most : detail;
    int64_t count = place_samples(scene, &ray, alpha, detail, work, out), edges = list_edges(work);
    int features = out->sample_features && count > 0, of_lamps = out->lamp_features && count > 0;
    if (features || of_lamps) sum_groups(scene, work);
    if (features && work->met_count < scene->volumes) {
        int64_t size = scene->groups * scene->suns * COLUMNS;
        memset(out->sample_features + out->samples * size, 0, (size_t)(count * size) * sizeof(float));
    }
    work->lit_from = 0, work->lit_to = STEPS * work->blocks;
    for (int64_t l = 0; l < scene->suns; l++) {
        if (scene->shadow_maps) {
            const ShadowMap *map = scene->shadow_maps + l;
            SunShadow shadow = {map, line_in(map->linear, map->offset, &ray)};
            look_up_visibility(sun_visible_at, &shadow, work);
        }
        look_up_depths(scene, l, NULL, list_lit(scene->shadow_maps != NULL, edges, work), work);
        add_single(scene, l, work, single);
        for (int64_t n = 0; n < work->active_count && features; n++) {
            int64_t g = work->active[n];
            if (!work->group_met[g]) continue;
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

/* Volumes that one ray meets at most, but no fewer than 1. */
static int64_t most_met(const Scene *scene, const Rays *rays) {
    int64_t most = 1;
    if (scene->volumes <= FEW || scene->lamps > 0 || !scene->spheres) return scene->volumes > 1 ? scene->volumes : 1;
    for (int64_t r = 0; r < rays->rays; r++) {
        Ray ray;
        int64_t met = 0;
        start_ray(rays, r, &ray);
        for (int64_t v = 0; v < scene->volumes; v++) met += may_meet(scene->spheres + 4 * v, &ray);
        most = met > most ? met : most;
    }
    return most;
}

/* Bytes of scratch memory for rays; sets their most_met. */
int64_t NAMED(scratch_bytes, VARIANT)(const Scene *scene, Rays *rays) {
    Work work;
    rays->most_met = most_met(scene, rays);
    return divide(scene, rays, NULL, &work);
}

/* March rays; returns how many were marched, fewer than given if `stop` was set. */
int64_t NAMED(march, VARIANT)(const Scene *scene, const Rays *rays, Gathered *out) {
    Work work;
    divide(scene, rays, rays->scratch, &work);
    out->samples = 0;
    out->blocks = 0;
    for (int64_t r = 0; r < rays->rays; r++) {
        if (rays->stop && *rays->stop) return r;
        march_ray(scene, rays, r, &work, out);
    }
    return rays->rays;
}
