/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Depth samples of a ray, and what networks read of the ray there. */

#ifndef MRPNN_SAMPLES_H
#define MRPNN_SAMPLES_H

#include "lit_steps.h"

static int64_t sample_count(const Scene *scene, double alpha) {
    int64_t most = scene->depth_samples;
    if (!scene->adaptive) return alpha > 0.0 ? most : 0;
    if (!(alpha > scene->min_alpha)) return 0;
    int64_t count = (int64_t)ceil((double)most * sqrt(alpha < 1.0 ? alpha : 1.0));
    if (count > scene->coarse_count) count = (count + scene->coarse_count - 1) / scene->coarse_count * scene->coarse_count;
    int64_t fewest = most < 2 ? most : 2;
    return count < fewest ? fewest : count > most ? most : count;
}

/* Add a depth sample within a step. */
static void add_sample(const Scene *scene, const Ray *ray, int64_t s, double inside, int64_t n, Work *work, Gathered *out) {
    int64_t sample = out->samples + n;
    work->sample_step[n] = s;
    work->sample_inside[n] = (float)inside;
    out->sample_distance[sample] = ray->near + place_in(work, s, inside) * ray->dt;
    float total = work->total[s] > 1e-30f ? work->total[s] : 1e-30f;
    for (int64_t v = 0; v < scene->volumes; v++) {
        out->sample_fraction[sample * scene->volumes + v] = work->is_met[v] ? work->sigma[work->rows[v] + s] / total : 0.0f;
    }
    for (int64_t i = 0; i < scene->volumes * scene->scattering && scene->varying; i++) {
        const float *scattering = scattering_of(scene, work, i / scene->scattering, i % scene->scattering);
        out->sample_scattering[sample * scene->volumes * scene->scattering + i] = work->is_met[i / scene->scattering] ? scattering[s] / total : 0.0f;
    }
}

/* Add depth sample n, ascending, with `opacity` in front of it. */
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

/* Add depth samples in `detail` strata of each Gauss-Legendre node's interval of opacity: at the node where a stratum
holds it, else in the middle; returns their number. */
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
        double width = weights[n] / (double)detail;
        for (int64_t k = 0; k < detail; k++) {
            double low = begin + (double)k * width;
            int holds = (k == 0 || nodes[n] >= low) && (k + 1 == detail || nodes[n] < low + width);
            double node = holds ? nodes[n] : low + 0.5 * width;
            place_sample(scene, ray, node * alpha, n * detail + k, work, out);
            out->sample_weight[out->samples + n * detail + k] = width * alpha;
        }
        begin += weights[n];
    }
    return count * detail;
}

/* Optical thickness of steps in each group. */
static void sum_groups(const Scene *scene, Work *work) {
    int64_t steps = STEPS * work->blocks;
    for (int64_t a = 0; a < work->active_count; a++) {
        int64_t g = work->active[a];
        for (int64_t s = 0; s < steps && work->group_met[g]; s += LANES) {
            Floats sigma = in_all(0.0f);
            for (int64_t n = scene->group_starts[g]; n < scene->group_starts[g + 1]; n++) {
                int64_t v = scene->group_members[n];
                if (work->is_met[v]) sigma += load(work->sigma + work->rows[v] + s);
            }
            store(work->group_tau + work->group_rows[g] + s, sigma * load(work->dt + s));
        }
    }
}

/* One light of one group, at the steps and samples of a ray, as ray features see it. */
typedef struct {
    const Fluence *fluence;
    const float *visible;        /* (steps), fraction that surfaces let through; or NULL */
    const float *received;       /* (steps), its light without attenuation; NULL: 1 */
    const float *unit;           /* (samples), divisor of its light; NULL: 1 */
    float *features;             /* of the first sample, */
    int64_t stride;              /* and from each to the next */
} Gathering;

/* Ray features of one group and light at the samples of a ray: integrals of the light ahead, from the ray's end.

The lanes are the integrals: those of the light itself with each scale, and those of scattered light. */
static void gather_features(const Scene *scene, int64_t g, const Gathering *of, int64_t count, const Work *work) {
    int64_t row = work->group_rows[g], steps = STEPS * work->blocks, from = work->sample_step[0];
    const float *start = work->start + row, *end = work->end + row, *tau = work->group_tau + row;
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
            Floats gone, through = exp_minus(along_ray * rest, &gone), sums = light * gone + through * ahead;
            if (of->unit) sums = sums / of->unit[n];
            memcpy(values + 2, &sums, INTEGRALS * sizeof *values);
        }
        ahead = light * lost + passed * ahead;
        tau_ahead += tau[s];
    }
}

#endif
