/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Triangles onto a raster of sample points; rasterization.rasterize finds the same points and values in numpy. */

#include "fields.h"
#include "lanes.h"
#include "variants.h"

/* One edge function at points of a row: proportional to a barycentric coordinate. */
typedef struct {
    double x, y, along_x, along_y;
} Edge;

static inline Edge edge_between(const double *tail, const double *head) {
    Edge edge = {tail[0], tail[1], head[0] - tail[0], head[1] - tail[1]};
    return edge;
}

static inline Doubles at_edge(const Edge *edge, double row, Doubles column) {
    return edge->along_x * (row - edge->y) - edge->along_y * (column - edge->x);
}

/* Points `first` to `last` of a row that one triangle covers. */
static inline void fill_row(const Raster *data, int64_t t, const Edge *edges, int64_t row, int64_t first, int64_t last) {
    const double *value = data->value + 3 * t;
    double *largest = data->largest + row * data->columns;
    int64_t *number = data->number + row * data->columns;
    for (int64_t column = first; column <= last; column += LANES) {
        Doubles at, known = {0.0};
        FOR_LANES(n) at[n] = (double)(column + n);
        Doubles a = at_edge(edges, (double)row, at), b = at_edge(edges + 1, (double)row, at), c = at_edge(edges + 2, (double)row, at);
        Longs covered = ((a >= 0.0) & (b >= 0.0) & (c >= 0.0)) | ((a <= 0.0) & (b <= 0.0) & (c <= 0.0));
        Doubles area = a + b + c, found = (a * value[0] + b * value[1] + c * value[2]) / area;
        covered &= area != 0.0;
        int whole = column + LANES - 1 <= last;
        if (whole) {
            memcpy(&known, largest + column, sizeof known);
            covered &= found >= known;
        }
        int64_t any = 0;
        FOR_LANES(n) any |= covered[n];
        if (!any) continue;
        for (int n = 0; n < LANES && column + n <= last; n++) {
            if (!covered[n] || !(found[n] >= largest[column + n])) continue;
            largest[column + n] = found[n];
            number[column + n] = data->taken[t];
        }
    }
}

int64_t NAMED(fill_raster, VARIANT)(const Raster *data) {
    for (int64_t t = 0; t < data->triangles; t++) {
        const double *corners = data->corners + 6 * t;
        const int64_t *first = data->first + 2 * t, *last = data->last + 2 * t;
        /* The box of a triangle with a corner that is not a number lies anywhere. */
        if (first[0] < 0 || first[1] < 0 || last[0] >= data->columns || last[1] >= data->rows) continue;
        Edge edges[3] = {edge_between(corners + 2, corners + 4), edge_between(corners + 4, corners), edge_between(corners, corners + 2)};
        for (int64_t row = first[1]; row <= last[1]; row++) fill_row(data, t, edges, row, first[0], last[0]);
    }
    return data->triangles;
}
