/* SPDX-License-Identifier: MIT
   Copyright (c) 2026 The fourtank-hil authors */

/* The plant: state, delays of the hoses, and the way from one moment to the next.

   equations.h has the equations themselves, translated from the emulator's. The order of calls is that of the emulator:
   inputs act from now on; at every level period the wear is brought to now; what arrives from a hose acts at its moment;
   between two such moments the plant advances in equal steps of at most 20 ms. Times are whole nanoseconds from the
   start. Memory is needed for what is on its way in a hose only. */

#ifndef FOURTANK_PLANT_H
#define FOURTANK_PLANT_H

#include <math.h>
#include <stddef.h>
#include <string.h>

#include "equations.h"
#include "variables.h"

typedef long long Nanoseconds;

#define NS_PER_S 1e9
#define MAX_STEP_S 0.02

typedef void *(*Allocate)(size_t count, size_t size);
typedef void (*Release)(void *memory);

typedef struct {
    double flow_V, effectiveness;
} Inflow;

typedef struct {
    Nanoseconds at;
    Inflow inflow;
} Arrival;

/* What a pump gives arrives `delay` later; a queue of `count` arrivals in a ring of `room` places, from `first` on. */
typedef struct {
    Nanoseconds delay;
    Inflow given, arrived;
    Arrival *ring;
    size_t room, first, count;
} Hose;

typedef struct {
    double value[VARIABLES]; /* inputs and parameters as set; outputs are computed when they are asked for */
    Nanoseconds now;
    double level[4], flow[2];
    double pumped, drained, spilled, caught;
    struct Slopes slopes;
    Hose hose[2];
} Plant;

static Nanoseconds whole_ns(double seconds) { return (Nanoseconds)floor(seconds * NS_PER_S + 0.5); }

/* 0, or -1 when there is no memory. */
static int hose_give(Hose *hose, Inflow inflow, Nanoseconds now, Allocate allocate, Release release)
{
    if (inflow.flow_V == hose->given.flow_V && inflow.effectiveness == hose->given.effectiveness) {
        return 0;
    }
    if (hose->delay == 0) {
        hose->given = hose->arrived = inflow;
        return 0;
    }
    if (hose->count == hose->room) {
        const size_t room = hose->room ? 2 * hose->room : 16;
        Arrival *ring = allocate(room, sizeof *ring);
        size_t at;
        if (ring == NULL) {
            return -1;
        }
        for (at = 0; at < hose->count; at++) {
            ring[at] = hose->ring[(hose->first + at) % hose->room];
        }
        if (hose->ring != NULL) {
            release(hose->ring);
        }
        hose->ring = ring;
        hose->room = room;
        hose->first = 0;
    }
    hose->given = inflow;
    hose->ring[(hose->first + hose->count) % hose->room] = (Arrival){now + hose->delay, inflow};
    hose->count++;
    return 0;
}

static void hose_take(Hose *hose, Nanoseconds now)
{
    while (hose->count > 0 && hose->ring[hose->first].at <= now) {
        hose->arrived = hose->ring[hose->first].inflow;
        hose->first = (hose->first + 1) % hose->room;
        hose->count--;
    }
}

/* Put the plant at its start; the rings keep their room. */
static void plant_start(Plant *plant)
{
    const Inflow nothing = {0.0, 1.0};
    int n;
    plant->now = 0;
    plant->pumped = plant->drained = plant->spilled = plant->caught = 0.0;
    for (n = 0; n < 4; n++) {
        plant->level[n] = plant->value[at_start1_cm + n];
    }
    for (n = 0; n < 2; n++) {
        plant->flow[n] = 0.0;
        plant->hose[n].delay = whole_ns(plant->value[at_delay1_s + n]);
        plant->hose[n].given = plant->hose[n].arrived = nothing;
        plant->hose[n].first = plant->hose[n].count = 0;
    }
}

/* Bring the coefficients to the inputs and parameters. */
static void plant_follow_faults(Plant *plant)
{
    const double *v = plant->value;
    const double *area = v + at_area1_cm2, *outlet = v + at_outlet1_cm2, *blocked = v + at_blocked1;
    const double *leak = v + at_leak1, *gain = v + at_gain1_cm3_Vs, *split = v + at_split1, *datum = v + at_datum1_cm;
    double c[12];
    coefficients(area[0], area[1], area[2], area[3], outlet[0], outlet[1], outlet[2], outlet[3], blocked[0], blocked[1],
                 blocked[2], blocked[3], leak[0], leak[1], leak[2], leak[3], v[at_gravity_cm_s2], gain[0], gain[1],
                 split[0], split[1], c);
    plant->slopes = (struct Slopes){c[0], c[1], c[2],  c[3],  c[4],     c[5],     c[6],     c[7],
                                    c[8], c[9], c[10], c[11], datum[0], datum[1], datum[2], datum[3]};
}

/* Let the pumps run at the voltages and shares of now; 0, or -1 when there is no memory. */
static int plant_drive(Plant *plant, Allocate allocate, Release release)
{
    const double *v = plant->value;
    const double run_h = (double)plant->now / (3600.0 * NS_PER_S);
    int n;
    for (n = 0; n < 2; n++) {
        const double wear = left_by_wear(v[at_wear1_1_h + n], run_h);
        const double flow_V = flow_voltage(v[at_v1_applied_V + n], v[at_dead_zone1_V + n], v[at_curve1_1_V + n]);
        const Inflow inflow = {flow_V, wear * v[at_effectiveness1 + n]};
        if (hose_give(&plant->hose[n], inflow, plant->now, allocate, release) != 0) {
            return -1;
        }
        hose_take(&plant->hose[n], plant->now);
    }
    return 0;
}

static void plant_step(Plant *plant, double dt_s)
{
    const double *area = plant->value + at_area1_cm2, *height = plant->value + at_height1_cm;
    const double *gain = plant->value + at_gain1_cm3_Vs, *share = plant->value + at_overflow_to_lower1;
    double flow[2][3], new_level[7];
    int n, is_inside = 1;
    for (n = 0; n < 2; n++) {
        const Inflow inflow = plant->hose[n].arrived;
        followed(dt_s, plant->value[at_lag1_s + n], plant->flow[n], inflow.flow_V, flow[n]);
        plant->flow[n] = flow[n][2];
        flow[n][0] *= inflow.effectiveness;
        flow[n][1] *= inflow.effectiveness;
        flow[n][2] *= inflow.effectiveness;
    }
    runge_kutta(&plant->slopes, dt_s, plant->level[0], plant->level[1], plant->level[2], plant->level[3], flow[0][0],
                flow[1][0], flow[0][1], flow[1][1], flow[0][2], flow[1][2], new_level);
    plant->drained += area[0] * new_level[4] + area[1] * new_level[5];
    plant->pumped += pumped(dt_s, gain[0], gain[1], flow[0][0], flow[1][0], flow[0][1], flow[1][1], flow[0][2],
                            flow[1][2]);
    for (n = 0; n < 4; n++) {
        is_inside = is_inside && 0.0 <= new_level[n] && new_level[n] <= height[n];
    }
    if (!is_inside) {
        bounded(new_level[0], new_level[1], new_level[2], new_level[3], area[0], area[1], area[2], area[3], height[0],
                height[1], height[2], height[3], share[0], share[1], new_level);
        plant->drained += new_level[4];
        plant->spilled += new_level[5];
        plant->caught += new_level[6];
    }
    memcpy(plant->level, new_level, sizeof plant->level);
}

/* Advance to a moment with the inputs as they are; 0, or -1 when there is no memory. */
static int plant_advance(Plant *plant, Nanoseconds to, Allocate allocate, Release release)
{
    plant_follow_faults(plant);
    if (plant_drive(plant, allocate, release) != 0) {
        return -1;
    }
    while (plant->now < to) {
        const Nanoseconds period_end = (plant->now / LEVEL_PERIOD_NS + 1) * LEVEL_PERIOD_NS;
        Nanoseconds next = period_end < to ? period_end : to;
        double dt_s, steps, step;
        int n;
        for (n = 0; n < 2; n++) {
            const Hose *hose = &plant->hose[n];
            if (hose->count > 0 && hose->ring[hose->first].at < next) {
                next = hose->ring[hose->first].at;
            }
        }
        dt_s = (double)(next - plant->now) / NS_PER_S;
        steps = ceil(dt_s / MAX_STEP_S - 1e-9);
        for (step = 0.0; step < steps; step += 1.0) {
            plant_step(plant, dt_s / steps);
        }
        plant->now = next;
        hose_take(&plant->hose[0], next);
        hose_take(&plant->hose[1], next);
        if (next == period_end && plant_drive(plant, allocate, release) != 0) {
            return -1;
        }
    }
    return 0;
}

/* The value of a variable now. */
static double plant_value(const Plant *plant, unsigned int at)
{
    const double *v = plant->value;
    if (at >= at_true_h1_cm && at < at_true_h1_cm + 4) {
        return plant->level[at - at_true_h1_cm];
    }
    if (at >= at_h1_V && at < at_h1_V + 4) {
        const unsigned int n = at - at_h1_V;
        const double gain_V_cm = v[at_sensor_gain1_V_cm + n] * (1.0 + v[at_scale_error1 + n]);
        return gain_V_cm * plant->level[n] + v[at_sensor_offset1_V + n] + v[at_bias1_V + n];
    }
    if (at >= at_flow1_cm3_s && at < at_flow1_cm3_s + 2) {
        const unsigned int n = at - at_flow1_cm3_s;
        return v[at_gain1_cm3_Vs + n] * plant->hose[n].arrived.effectiveness * plant->flow[n];
    }
    if (at >= at_drain1_cm3_s && at < at_drain1_cm3_s + 2) {
        const unsigned int n = at - at_drain1_cm3_s;
        double slope[6];
        slopes(&plant->slopes, plant->level[0], plant->level[1], plant->level[2], plant->level[3],
               plant->hose[0].arrived.effectiveness * plant->flow[0],
               plant->hose[1].arrived.effectiveness * plant->flow[1], slope);
        return v[at_area1_cm2 + n] * slope[4 + n];
    }
    switch (at) {
    case at_pumped_cm3: return plant->pumped;
    case at_drained_cm3: return plant->drained;
    case at_spilled_cm3: return plant->spilled;
    case at_caught_cm3: return plant->caught;
    default: return v[at];
    }
}

#endif
