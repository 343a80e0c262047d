/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Velocities of what is seen at points while the shutter is open. */

#include "fields.h"
#include "sampling.h"
#include "variants.h"

int64_t NAMED(flow_velocities, VARIANT)(const FlowVelocities *data) {
    for (int64_t point = 0; point < data->points; point += LANES) {
        int used = data->points - point < LANES ? (int)(data->points - point) : LANES;
        Doubles place[3], velocity[3], time;
        FOR_LANES(n) {
            int64_t from = point + (n < used ? n : used - 1);
            time[n] = data->times[from];
            for (int k = 0; k < 3; k++) place[k][n] = data->places[k * data->points + from];
        }
        velocities_at(&data->flow, place, time, velocity);
        for (int k = 0; k < 3; k++) {
            for (int n = 0; n < used; n++) data->velocities[k * data->points + point + n] = velocity[k][n];
        }
    }
    return data->points;
}
