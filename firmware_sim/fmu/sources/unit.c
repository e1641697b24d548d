/* SPDX-License-Identifier: MIT
   Copyright (c) 2026 The fourtank-hil authors */

/* The four-tank rig as a co-simulation unit of FMI 2.0: the interface around plant.h.

   A value that is no number or outside its range is refused with fmi2Error and a message, and nothing changes. Inputs
   act from the begin of the next step on. All memory belongs to an instance; there are no static variables that change. */

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

#include "fmi2.h"
#include "plant.h"

#define MAX_TIME_S 1e8
#define POSITION_TOLERANCE_NS 1000

typedef enum { INSTANTIATED, INITIALIZATION, STEPPING, TERMINATED, FAILED } Mode;

typedef struct {
    fmi2CallbackFunctions callbacks;
    char *name;
    Mode mode;
    double start_s, stop_s; /* stop_s is infinite when there is none */
    Plant plant;
} Unit;

typedef struct {
    Mode mode;
    double start_s;
    Plant plant;
} Saved;

/* --- messages and memory --- */

static fmi2Status refuse(const Unit *unit, const char *format, ...)
{
    char text[256];
    va_list values;
    va_start(values, format);
    vsnprintf(text, sizeof text, format, values);
    va_end(values);
    if (unit->callbacks.logger != NULL) {
        unit->callbacks.logger(unit->callbacks.componentEnvironment, unit->name, fmi2Error, "logStatusError", text);
    }
    return fmi2Error;
}

static void release_rings(Plant *plant, Release release)
{
    int n;
    for (n = 0; n < 2; n++) {
        if (plant->hose[n].ring != NULL) {
            release(plant->hose[n].ring);
            plant->hose[n].ring = NULL;
        }
        plant->hose[n].room = plant->hose[n].first = plant->hose[n].count = 0;
    }
}

/* Copy a plant with its rings over another one, whose rings are given back; 0, or -1 when there is no memory. */
static int copy_plant(Plant *to, const Plant *from, Allocate allocate, Release release)
{
    Plant copy = *from;
    int n;
    for (n = 0; n < 2; n++) {
        copy.hose[n].ring = NULL;
    }
    for (n = 0; n < 2; n++) {
        const size_t room = from->hose[n].room;
        if (room > 0) {
            copy.hose[n].ring = allocate(room, sizeof(Arrival));
            if (copy.hose[n].ring == NULL) {
                release_rings(&copy, release);
                return -1;
            }
            memcpy(copy.hose[n].ring, from->hose[n].ring, room * sizeof(Arrival));
        }
    }
    release_rings(to, release);
    *to = copy;
    return 0;
}

static void set_up(Unit *unit)
{
    unsigned int at;
    for (at = 0; at < VARIABLES; at++) {
        unit->plant.value[at] = VARIABLE[at].start;
    }
    unit->mode = INSTANTIATED;
    unit->start_s = 0.0;
    unit->stop_s = INFINITY;
    plant_start(&unit->plant);
    plant_follow_faults(&unit->plant);
}

/* --- the unit's life --- */

FMI_FUNCTION(const char *, fmi2GetTypesPlatform)(void) { return "default"; }

FMI_FUNCTION(const char *, fmi2GetVersion)(void) { return "2.0"; }

FMI_FUNCTION(fmi2Status, fmi2SetDebugLogging)(fmi2Component c, fmi2Boolean on, size_t count, const fmi2String names[])
{
    (void)on, (void)count, (void)names; /* errors are always reported; there is nothing else to report */
    return c == NULL ? fmi2Error : fmi2OK;
}

FMI_FUNCTION(fmi2Component, fmi2Instantiate)(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                                             const fmi2CallbackFunctions *callbacks, fmi2Boolean visible,
                                             fmi2Boolean logging)
{
    Unit *unit, asked;
    size_t length;
    (void)resources, (void)visible, (void)logging;
    memset(&asked, 0, sizeof asked);
    if (callbacks != NULL) {
        asked.callbacks = *callbacks;
    }
    if (asked.callbacks.allocateMemory == NULL || asked.callbacks.freeMemory == NULL) {
        asked.callbacks.allocateMemory = calloc;
        asked.callbacks.freeMemory = free;
    }
    asked.name = "";
    if (name == NULL || name[0] == '\0') {
        refuse(&asked, "an instance needs a name");
        return NULL;
    }
    asked.name = (char *)name;
    if (type != fmi2CoSimulation) {
        refuse(&asked, "this unit is for co-simulation only");
        return NULL;
    }
    if (guid == NULL || strcmp(guid, UNIT_GUID) != 0) {
        refuse(&asked, "the GUID is not that of this unit, " UNIT_GUID);
        return NULL;
    }
    unit = asked.callbacks.allocateMemory(1, sizeof *unit);
    length = strlen(name) + 1;
    asked.name = unit == NULL ? NULL : asked.callbacks.allocateMemory(length, 1);
    if (asked.name == NULL) {
        if (unit != NULL) {
            asked.callbacks.freeMemory(unit);
        }
        return NULL;
    }
    memcpy(asked.name, name, length);
    *unit = asked;
    set_up(unit);
    return unit;
}

FMI_FUNCTION(void, fmi2FreeInstance)(fmi2Component c)
{
    Unit *unit = c;
    if (unit != NULL) {
        const Release release = unit->callbacks.freeMemory;
        release_rings(&unit->plant, release);
        release(unit->name);
        release(unit);
    }
}

FMI_FUNCTION(fmi2Status, fmi2SetupExperiment)(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance,
                                              fmi2Real start, fmi2Boolean has_stop, fmi2Real stop)
{
    Unit *unit = c;
    (void)has_tolerance, (void)tolerance;
    if (unit == NULL) {
        return fmi2Error;
    }
    if (unit->mode != INSTANTIATED) {
        return refuse(unit, "fmi2SetupExperiment comes before the initialization");
    }
    if (!(fabs(start) <= MAX_TIME_S)) {
        return refuse(unit, "start time %g is outside -%g .. %g s", start, MAX_TIME_S, MAX_TIME_S);
    }
    if (has_stop && !(stop >= start)) {
        return refuse(unit, "stop time %g is before start time %g", stop, start);
    }
    unit->start_s = start;
    unit->stop_s = has_stop ? stop : INFINITY;
    return fmi2OK;
}

FMI_FUNCTION(fmi2Status, fmi2EnterInitializationMode)(fmi2Component c)
{
    Unit *unit = c;
    if (unit == NULL) {
        return fmi2Error;
    }
    if (unit->mode != INSTANTIATED) {
        return refuse(unit, "fmi2EnterInitializationMode comes after fmi2Instantiate or fmi2Reset");
    }
    unit->mode = INITIALIZATION;
    return fmi2OK;
}

FMI_FUNCTION(fmi2Status, fmi2ExitInitializationMode)(fmi2Component c)
{
    Unit *unit = c;
    int n;
    if (unit == NULL) {
        return fmi2Error;
    }
    if (unit->mode != INITIALIZATION) {
        return refuse(unit, "fmi2ExitInitializationMode comes after fmi2EnterInitializationMode");
    }
    for (n = 0; n < 4; n++) {
        const double level_cm = unit->plant.value[at_start1_cm + n], height_cm = unit->plant.value[at_height1_cm + n];
        if (level_cm > height_cm) {
            return refuse(unit, "start%d_cm = %g is above height%d_cm = %g", n + 1, level_cm, n + 1, height_cm);
        }
    }
    plant_start(&unit->plant);
    plant_follow_faults(&unit->plant);
    unit->mode = STEPPING;
    return fmi2OK;
}

FMI_FUNCTION(fmi2Status, fmi2Terminate)(fmi2Component c)
{
    Unit *unit = c;
    if (unit == NULL) {
        return fmi2Error;
    }
    if (unit->mode != STEPPING) {
        return refuse(unit, "fmi2Terminate comes after the initialization, once");
    }
    unit->mode = TERMINATED;
    return fmi2OK;
}

FMI_FUNCTION(fmi2Status, fmi2Reset)(fmi2Component c)
{
    if (c == NULL) {
        return fmi2Error;
    }
    set_up(c);
    return fmi2OK;
}

/* --- variables --- */

FMI_FUNCTION(fmi2Status, fmi2GetReal)(fmi2Component c, const fmi2ValueReference reference[], size_t count,
                                      fmi2Real value[])
{
    Unit *unit = c;
    size_t n;
    if (unit == NULL) {
        return fmi2Error;
    }
    if (count > 0 && (reference == NULL || value == NULL)) {
        return refuse(unit, "fmi2GetReal: no place for values");
    }
    if (unit->mode == INSTANTIATED || unit->mode == INITIALIZATION) {
        plant_start(&unit->plant); /* parameters may have been set */
        plant_follow_faults(&unit->plant);
    }
    for (n = 0; n < count; n++) {
        if (reference[n] >= VARIABLES) {
            return refuse(unit, "fmi2GetReal: there is no variable %u", reference[n]);
        }
        value[n] = plant_value(&unit->plant, reference[n]);
    }
    return fmi2OK;
}

/* Why a variable can't be set to a value, as a status; a rounding error outside the range is moved into it. */
static fmi2Status check_value(const Unit *unit, fmi2ValueReference reference, double *value)
{
    const Variable *variable;
    double margin;
    if (reference >= VARIABLES) {
        return refuse(unit, "fmi2SetReal: there is no variable %u", reference);
    }
    variable = &VARIABLE[reference];
    if (variable->causality == OUTPUT) {
        return refuse(unit, "%s is an output and cannot be set", variable->name);
    }
    if (variable->causality == PARAMETER && unit->mode != INSTANTIATED && unit->mode != INITIALIZATION) {
        return refuse(unit, "%s is a parameter and can be set before the end of the initialization only",
                      variable->name);
    }
    margin = 1e-9 * (variable->high - variable->low);
    if (!(*value >= variable->low - margin && *value <= variable->high + margin)) {
        return refuse(unit, "%s = %g is outside %g .. %g %s", variable->name, *value, variable->low, variable->high,
                      variable->unit);
    }
    *value = lesser(greater(*value, variable->low), variable->high);
    return fmi2OK;
}

FMI_FUNCTION(fmi2Status, fmi2SetReal)(fmi2Component c, const fmi2ValueReference reference[], size_t count,
                                      const fmi2Real value[])
{
    Unit *unit = c;
    size_t n;
    if (unit == NULL) {
        return fmi2Error;
    }
    if (count > 0 && (reference == NULL || value == NULL)) {
        return refuse(unit, "fmi2SetReal: no values");
    }
    if (unit->mode == TERMINATED || unit->mode == FAILED) {
        return refuse(unit, "fmi2SetReal: the simulation has ended");
    }
    for (n = 0; n < count; n++) {
        double checked = value[n];
        if (check_value(unit, reference[n], &checked) != fmi2OK) {
            return fmi2Error;
        }
    }
    for (n = 0; n < count; n++) {
        double checked = value[n];
        check_value(unit, reference[n], &checked);
        unit->plant.value[reference[n]] = checked;
    }
    return fmi2OK;
}

/* There are no variables of other types. */
#define NO_VARIABLES(name, type)                                                                                      \
    FMI_FUNCTION(fmi2Status, name)(fmi2Component c, const fmi2ValueReference reference[], size_t count, type value[]) \
    {                                                                                                                 \
        (void)reference, (void)value;                                                                                 \
        if (c == NULL) {                                                                                              \
            return fmi2Error;                                                                                         \
        }                                                                                                             \
        return count == 0 ? fmi2OK : refuse(c, #name ": all variables are Real");                                     \
    }

NO_VARIABLES(fmi2GetInteger, fmi2Integer)
NO_VARIABLES(fmi2GetBoolean, fmi2Boolean)
NO_VARIABLES(fmi2GetString, fmi2String)
NO_VARIABLES(fmi2SetInteger, const fmi2Integer)
NO_VARIABLES(fmi2SetBoolean, const fmi2Boolean)
NO_VARIABLES(fmi2SetString, const fmi2String)

/* --- steps --- */

FMI_FUNCTION(fmi2Status, fmi2DoStep)(fmi2Component c, fmi2Real now_s, fmi2Real step_s, fmi2Boolean no_way_back)
{
    Unit *unit = c;
    Nanoseconds to, away;
    (void)no_way_back;
    if (unit == NULL) {
        return fmi2Error;
    }
    if (unit->mode != STEPPING) {
        return refuse(unit, "fmi2DoStep comes after the initialization and before the end");
    }
    if (!(step_s >= 0.0 && fabs(now_s - unit->start_s) + step_s <= MAX_TIME_S)) {
        return refuse(unit, "fmi2DoStep: no step of %g s at %g s", step_s, now_s);
    }
    away = whole_ns(now_s - unit->start_s) - unit->plant.now;
    if (away > POSITION_TOLERANCE_NS || away < -POSITION_TOLERANCE_NS) {
        return refuse(unit, "fmi2DoStep: the step begins at %.9g s, but the unit is at %.9g s", now_s,
                      unit->start_s + (double)unit->plant.now / NS_PER_S);
    }
    if (now_s + step_s > unit->stop_s + POSITION_TOLERANCE_NS / NS_PER_S) {
        return refuse(unit, "fmi2DoStep: the step ends at %.9g s, after the stop time of %.9g s", now_s + step_s,
                      unit->stop_s);
    }
    to = whole_ns(now_s - unit->start_s + step_s);
    if (plant_advance(&unit->plant, to, unit->callbacks.allocateMemory, unit->callbacks.freeMemory) != 0) {
        unit->mode = FAILED;
        return refuse(unit, "fmi2DoStep: no memory");
    }
    return fmi2OK;
}

FMI_FUNCTION(fmi2Status, fmi2CancelStep)(fmi2Component c)
{
    return c == NULL ? fmi2Error : refuse(c, "fmi2CancelStep: no step goes on in the background");
}

FMI_FUNCTION(fmi2Status, fmi2SetRealInputDerivatives)(fmi2Component c, const fmi2ValueReference reference[],
                                                      size_t count, const fmi2Integer order[], const fmi2Real value[])
{
    (void)reference, (void)count, (void)order, (void)value;
    return c == NULL ? fmi2Error : refuse(c, "fmi2SetRealInputDerivatives: inputs are constant during a step");
}

FMI_FUNCTION(fmi2Status, fmi2GetRealOutputDerivatives)(fmi2Component c, const fmi2ValueReference reference[],
                                                       size_t count, const fmi2Integer order[], fmi2Real value[])
{
    (void)reference, (void)count, (void)order, (void)value;
    return c == NULL ? fmi2Error : refuse(c, "fmi2GetRealOutputDerivatives: outputs have no derivatives");
}

FMI_FUNCTION(fmi2Status, fmi2GetStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value)
{
    (void)kind, (void)value;
    return c == NULL ? fmi2Error : fmi2Discard;
}

FMI_FUNCTION(fmi2Status, fmi2GetRealStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    const Unit *unit = c;
    if (unit == NULL) {
        return fmi2Error;
    }
    if (kind != fmi2LastSuccessfulTime || value == NULL) {
        return fmi2Discard;
    }
    *value = unit->start_s + (double)unit->plant.now / NS_PER_S;
    return fmi2OK;
}

FMI_FUNCTION(fmi2Status, fmi2GetIntegerStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value)
{
    (void)kind, (void)value;
    return c == NULL ? fmi2Error : fmi2Discard;
}

FMI_FUNCTION(fmi2Status, fmi2GetBooleanStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
{
    if (c == NULL) {
        return fmi2Error;
    }
    if (kind != fmi2Terminated || value == NULL) {
        return fmi2Discard;
    }
    *value = 0; /* the unit never asks for an end */
    return fmi2OK;
}

FMI_FUNCTION(fmi2Status, fmi2GetStringStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2String *value)
{
    (void)kind, (void)value;
    return c == NULL ? fmi2Error : fmi2Discard;
}

/* --- saved states --- */

FMI_FUNCTION(fmi2Status, fmi2GetFMUstate)(fmi2Component c, fmi2FMUstate *state)
{
    Unit *unit = c;
    Saved *saved;
    int is_new;
    if (unit == NULL || state == NULL) {
        return fmi2Error;
    }
    saved = *state;
    is_new = saved == NULL;
    if (is_new) {
        saved = unit->callbacks.allocateMemory(1, sizeof *saved);
        if (saved == NULL) {
            return refuse(unit, "fmi2GetFMUstate: no memory");
        }
        memset(saved, 0, sizeof *saved);
    }
    if (copy_plant(&saved->plant, &unit->plant, unit->callbacks.allocateMemory, unit->callbacks.freeMemory) != 0) {
        if (is_new) {
            unit->callbacks.freeMemory(saved);
        }
        return refuse(unit, "fmi2GetFMUstate: no memory");
    }
    saved->mode = unit->mode;
    saved->start_s = unit->start_s;
    *state = saved;
    return fmi2OK;
}

FMI_FUNCTION(fmi2Status, fmi2SetFMUstate)(fmi2Component c, fmi2FMUstate state)
{
    Unit *unit = c;
    const Saved *saved = state;
    if (unit == NULL) {
        return fmi2Error;
    }
    if (saved == NULL) {
        return refuse(unit, "fmi2SetFMUstate: no state");
    }
    if (copy_plant(&unit->plant, &saved->plant, unit->callbacks.allocateMemory, unit->callbacks.freeMemory) != 0) {
        return refuse(unit, "fmi2SetFMUstate: no memory");
    }
    unit->mode = saved->mode;
    unit->start_s = saved->start_s;
    return fmi2OK;
}

FMI_FUNCTION(fmi2Status, fmi2FreeFMUstate)(fmi2Component c, fmi2FMUstate *state)
{
    Unit *unit = c;
    if (unit == NULL) {
        return fmi2Error;
    }
    if (state != NULL && *state != NULL) {
        Saved *saved = *state;
        release_rings(&saved->plant, unit->callbacks.freeMemory);
        unit->callbacks.freeMemory(saved);
        *state = NULL;
    }
    return fmi2OK;
}

FMI_FUNCTION(fmi2Status, fmi2SerializedFMUstateSize)(fmi2Component c, fmi2FMUstate state, size_t *size)
{
    (void)state, (void)size;
    return c == NULL ? fmi2Error : refuse(c, "fmi2SerializedFMUstateSize: states are not serialized");
}

FMI_FUNCTION(fmi2Status, fmi2SerializeFMUstate)(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    (void)state, (void)bytes, (void)size;
    return c == NULL ? fmi2Error : refuse(c, "fmi2SerializeFMUstate: states are not serialized");
}

FMI_FUNCTION(fmi2Status, fmi2DeSerializeFMUstate)(fmi2Component c, const fmi2Byte bytes[], size_t size,
                                                  fmi2FMUstate *state)
{
    (void)bytes, (void)size, (void)state;
    return c == NULL ? fmi2Error : refuse(c, "fmi2DeSerializeFMUstate: states are not serialized");
}

FMI_FUNCTION(fmi2Status, fmi2GetDirectionalDerivative)(fmi2Component c, const fmi2ValueReference unknown[],
                                                       size_t unknowns, const fmi2ValueReference known[],
                                                       size_t knowns, const fmi2Real change[], fmi2Real result[])
{
    (void)unknown, (void)unknowns, (void)known, (void)knowns, (void)change, (void)result;
    return c == NULL ? fmi2Error : refuse(c, "fmi2GetDirectionalDerivative: not provided");
}
