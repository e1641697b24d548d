/* SPDX-License-Identifier: MIT
   Copyright (c) 2026 The fourtank-hil authors */

/* What this unit needs of the C interface of the Functional Mock-up Interface 2.0 (FMI 2.0, Modelica Association, 2014):
   types, values and names as the standard gives them. */

#ifndef FOURTANK_FMI2_H
#define FOURTANK_FMI2_H

#include <stddef.h>

typedef void *fmi2Component;
typedef void *fmi2ComponentEnvironment;
typedef void *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer;
typedef int fmi2Boolean;
typedef const char *fmi2String;
typedef char fmi2Byte;

typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum { fmi2DoStepStatus, fmi2PendingStatus, fmi2LastSuccessfulTime, fmi2Terminated } fmi2StatusKind;

typedef struct {
    void (*logger)(fmi2ComponentEnvironment environment, fmi2String instance, fmi2Status status, fmi2String category,
                   fmi2String message, ...);
    void *(*allocateMemory)(size_t count, size_t size);
    void (*freeMemory)(void *memory);
    void (*stepFinished)(fmi2ComponentEnvironment environment, fmi2Status status);
    fmi2ComponentEnvironment componentEnvironment;
} fmi2CallbackFunctions;

/* A library exports the names of the standard; units that are linked into one program each need a prefix of their own:
   compile with -DFMI2_FUNCTION_PREFIX=NAME_ for that. */
#define FMI_JOIN_NOW(prefix, name) prefix##name
#define FMI_JOIN(prefix, name) FMI_JOIN_NOW(prefix, name)
#if defined(FMI2_FUNCTION_PREFIX) && !defined(FMI2_OVERRIDE_FUNCTION_PREFIX)
#define FMI_NAME(name) FMI_JOIN(FMI2_FUNCTION_PREFIX, name)
#define FMI_EXPORT
#else
#define FMI_NAME(name) name
#if defined(_WIN32) || defined(__CYGWIN__)
#define FMI_EXPORT __declspec(dllexport)
#elif defined(__GNUC__)
#define FMI_EXPORT __attribute__((visibility("default")))
#else
#define FMI_EXPORT
#endif
#endif
#define FMI_FUNCTION(type, name) FMI_EXPORT type FMI_NAME(name)

#endif
