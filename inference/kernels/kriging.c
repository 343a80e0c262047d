/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Values at cells of a grid, from those at cells near by. */

#include <math.h>

#include "fields.h"
#include "variants.h"

/* Known cells that a cell's values come from, at most. */
#define NEIGHBOURS 6

/* The nearest known cells around a cell, and steps to them with their squares; returns how many there are. */
static int find_neighbours(const Kriging *kriging, int64_t cell, const int32_t **nearest, int32_t *numbers) {
    int count = 0;
    for (int64_t n = 0; n < kriging->offsets && count < NEIGHBOURS; n++) {
        int32_t number = kriging->numbers[cell + kriging->step[n]];
        if (number < 0) continue;
        numbers[count] = number;
        nearest[count++] = kriging->offset + 4 * n;
    }
    return count;
}

/* Weights of neighbours: K^-1 c, by Cholesky's decomposition of their covariances K, with those towards the cell, c. */
static void find_weights(const Kriging *kriging, int count, const int32_t **nearest, float *weights) {
    float rows[NEIGHBOURS][NEIGHBOURS], inverse[NEIGHBOURS];
    for (int i = 0; i < count; i++) {
        for (int j = 0; j <= i; j++) {
            int32_t square = 0;
            for (int axis = 0; axis < 3; axis++) {
                int32_t apart = nearest[i][axis] - nearest[j][axis];
                square += apart * apart;
            }
            float sum = kriging->covariance[square] + (i == j ? (float)kriging->noise : 0.0f);
            for (int k = 0; k < j; k++) sum -= rows[i][k] * rows[j][k];
            rows[i][j] = sum * (i == j ? 1.0f : inverse[j]);
        }
        inverse[i] = 1.0f / sqrtf(rows[i][i]);
        float sum = kriging->covariance[nearest[i][3]];
        for (int k = 0; k < i; k++) sum -= rows[i][k] * weights[k];
        weights[i] = sum * inverse[i];
    }
    for (int i = count - 1; i >= 0; i--) {
        for (int k = i + 1; k < count; k++) weights[i] -= rows[k][i] * weights[k];
        weights[i] *= inverse[i];
    }
}

int64_t NAMED(krige, VARIANT)(const Kriging *kriging) {
    for (int64_t n = 0; n < kriging->cells; n++) {
        const int32_t *nearest[NEIGHBOURS];
        int32_t numbers[NEIGHBOURS];
        float weights[NEIGHBOURS];
        int count = find_neighbours(kriging, kriging->cell[n], nearest, numbers);
        find_weights(kriging, count, nearest, weights);
        for (int64_t v = 0; v < kriging->values; v++) {
            float mean = kriging->mean[v], sum = mean;
            for (int i = 0; i < count; i++) sum += weights[i] * (kriging->known[numbers[i] * kriging->values + v] - mean);
            kriging->found[n * kriging->values + v] = sum;
        }
    }
    return kriging->cells;
}
