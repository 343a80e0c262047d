/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Where rays meet boxes, and how many steps these want; tests/reference/boxes.py does the same in numpy. */

#include <math.h>

#include "fields.h"
#include "variants.h"

/* Cut the interval from `enter` to `leave` of a ray to where it is between two faces of a box. */
static inline void cut(double at, double slope, double low, double high, double *enter, double *leave) {
    double inverse = 1.0 / slope, a = (low - at) * inverse, b = (high - at) * inverse;
    double first = a < b ? a : b, last = a < b ? b : a;
    /* A ray within the plane of a face divides 0 by 0; that axis does not bound it. */
    if (a != a || b != b) return;
    if (!(*enter >= first)) *enter = first;
    if (!(*leave <= last)) *leave = last;
}

int64_t NAMED(cross_boxes, VARIANT)(const BoxCrossings *data) {
    for (int64_t r = 0; r < data->rays; r++) {
        const double *origin = data->origins + 3 * r, *direction = data->directions + 3 * r;
        double near = data->near_distance[r], far = data->far_distance[r];
        double first = INFINITY, last = -INFINITY, count = data->least;
        for (int64_t v = 0; v < data->boxes; v++) {
            const double *linear = data->linear + 9 * v, *offset = data->offset + 3 * v;
            const double *low = data->low + 3 * v, *high = data->high + 3 * v;
            double enter = NAN, leave = NAN, square = 0.0;
            for (int k = 0; k < 3; k++) {
                const double *row = linear + 3 * k;
                double at = row[0] * origin[0] + row[1] * origin[1] + row[2] * origin[2] + offset[k];
                double slope = row[0] * direction[0] + row[1] * direction[1] + row[2] * direction[2];
                square += slope * slope;
                cut(at, slope, low[k], high[k], &enter, &leave);
            }
            if (!(enter < leave)) continue;
            enter = enter > near ? enter : near;
            leave = leave < far ? leave : far;
            if (!(enter < leave)) continue;
            double crossed = sqrt(square) * (far - near);
            double needed = ceil((crossed > data->least ? crossed : data->least) * data->steps[v]);
            first = enter < first ? enter : first;
            last = leave > last ? leave : last;
            count = needed > count ? needed : count;
        }
        data->enter[r] = first;
        data->leave[r] = last;
        data->counts[r] = count;
    }
    return data->rays;
}
