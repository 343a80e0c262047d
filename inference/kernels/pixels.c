/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Pixels of blurred pictures, joined with those around: inference/blur/reconstruction.py explains it. */

#include <string.h>

#include "fields.h"
#include "variants.h"

/* Squared distance from which on nothing is joined. */
#define FARTHEST 16.0f

/* exp(-square / 2), about, and 0 from FARTHEST on. */
static float weight_of(float square) {
    float near = 1.0f - square * (1.0f / FARTHEST);
    near *= near;
    near *= near;
    return near * near;
}

int64_t NAMED(join_pixels, VARIANT)(const PixelJoin *data) {
    int64_t columns = data->columns, values = data->values, reach = data->reach;
    for (int64_t row = data->first; row < data->end; row++) {
        for (int64_t column = 0; column < columns; column++) {
            int64_t here = row * columns + column;
            const float *sharp = data->sharpness + 3 * here;
            float *joined = data->joined + values * here, sum = 1.0f;
            memcpy(joined, data->image + values * here, (size_t)values * sizeof *joined);
            /* The least eigenvalue tells whether any neighbour is near enough. */
            float mean = 0.5f * (sharp[0] + sharp[2]) - FARTHEST, half = 0.5f * (sharp[0] - sharp[2]);
            if (mean > 0.0f && mean * mean > half * half + sharp[1] * sharp[1]) continue;
            int64_t top = row < reach ? -row : -reach, left = column < reach ? -column : -reach;
            int64_t bottom = data->rows - 1 - row < reach ? data->rows - 1 - row : reach;
            int64_t right = columns - 1 - column < reach ? columns - 1 - column : reach;
            for (int64_t down = top; down <= bottom; down++) {
                for (int64_t across = left; across <= right; across++) {
                    int64_t there = here + down * columns + across;
                    const float *other = data->sharpness + 3 * there, *image = data->image + values * there;
                    float x = (float)across, y = (float)down;
                    float square = x * x * (sharp[0] + other[0]) + 2.0f * x * y * (sharp[1] + other[1]) +
                                   y * y * (sharp[2] + other[2]);
                    if (!(square < FARTHEST) || there == here) continue;
                    float weight = weight_of(square);
                    sum += weight;
                    for (int64_t v = 0; v < values; v++) joined[v] += weight * image[v];
                }
            }
            for (int64_t v = 0; v < values; v++) joined[v] /= sum;
        }
    }
    return data->end - data->first;
}
