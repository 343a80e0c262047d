/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Moments of light that has scattered by a wide angle once: inference/source_terms/wide_light.py explains them. */

#include "fields.h"
#include "lanes.h"
#include "variants.h"

/* Directions that are followed at once, and moments in two vectors. */
#define WAYS 4
#define HALF LANES
#define MOMENTS (2 * HALF)
/* Amount, direction and row of the table of a lobe. */
#define PARTS 5
/* Kinds of cells. */
#define EMPTY 0
#define FILLED 2

typedef float Quad __attribute__((vector_size(4 * WAYS)));
typedef int32_t QuadOfInts __attribute__((vector_size(4 * WAYS)));

static Quad quad(const float *from) {
    Quad values;
    memcpy(&values, from, sizeof values);
    return values;
}

/* The nearest whole numbers in [0, last]; 0 for NaN. */
static QuadOfInts nearest(Quad x, float last) {
    Quad zero = {0.0f}, most = zero + last;
    QuadOfInts above = x > zero;
    Quad raised = (Quad)(above & (QuadOfInts)x);
    QuadOfInts within = raised < most;
    return __builtin_convertvector((Quad)((within & (QuadOfInts)raised) | (~within & (QuadOfInts)most)) + 0.5f, QuadOfInts);
}

/* Light of a cell's lobes that scatters along the directions. */
static Quad scattered(const MomentSweep *data, const float *lobes, const Quad *along) {
    Quad radiance = {0.0f};
    float last = (float)(data->columns - 1);
    for (int64_t l = 0; l < data->lobes; l++, lobes += PARTS) {
        if (!(lobes[0] > 0.0f)) continue;
        Quad cosine = lobes[1] * along[0] + lobes[2] * along[1] + lobes[3] * along[2];
        QuadOfInts column = nearest((cosine + 1.0f) * (0.5f * last), last);
        const float *row = data->table + nearest((Quad){lobes[4]}, (float)(data->rows - 1))[0] * data->columns;
        for (int n = 0; n < WAYS; n++) radiance[n] += lobes[0] * row[column[n]];
    }
    return radiance;
}

int64_t NAMED(sweep_moments, VARIANT)(const MomentSweep *data) {
    int64_t rows = data->shape[1], columns = data->shape[2], row = WAYS * (columns + 1), plane = (rows + 1) * row;
    float *before = data->scratch, *after = before + plane;
    Quad f = quad(data->slopes), g = quad(data->slopes + WAYS), along[3];
    for (int k = 0; k < 3; k++) along[k] = quad(data->along + WAYS * k);
    memset(before, 0, (size_t)(2 * plane) * sizeof *before);
    for (int64_t k = 0; k < data->shape[0]; k++) {
        for (int64_t i = 0; i < rows; i++) {
            for (int64_t c = 0; c < columns; c++) {
                int64_t cell = data->first + k * data->strides[0] + i * data->strides[1] + c * data->strides[2];
                /* Light of the previous slice, with a row and a column of zeros before the first. */
                const float *own = before + (i + 1) * row + WAYS * (c + 1), *last = own - row;
                Quad ahead = quad(own) * (1.0f - f) + quad(last) * f;
                Quad behind = quad(own - WAYS) * (1.0f - f) + quad(last - WAYS) * f;
                Quad moved = ahead * (1.0f - g) + behind * g;
                Quad leaving = moved, inside = moved;
                if (data->kinds[cell] == FILLED) {
                    Quad source = scattered(data, data->light + PARTS * data->lobes * cell, along), rise = moved - source;
                    leaving = source + rise * quad(data->passed + WAYS * cell);
                    inside = source + rise * quad(data->mean + WAYS * cell);
                }
                memcpy(after + (i + 1) * row + WAYS * (c + 1), &leaving, sizeof leaving);
                if (data->kinds[cell] == EMPTY) continue;
                float *moments = data->moments + MOMENTS * cell;
                Floats low = load(moments), high = load(moments + HALF);
                for (int n = 0; n < WAYS; n++) {
                    low += load(data->weights + MOMENTS * n) * inside[n];
                    high += load(data->weights + MOMENTS * n + HALF) * inside[n];
                }
                store(moments, low);
                store(moments + HALF, high);
            }
        }
        float *swapped = before;
        before = after, after = swapped;
    }
    return WAYS;
}
