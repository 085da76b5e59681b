/* FMI 2.0 for co-simulation, around the step above. Value references: inputs, outputs, states, constants, one after the other.

   The types and functions are those of the standard (Functional Mock-up Interface for Model Exchange and Co-Simulation 2.0, sections 2
   and 4), declared here so that the source compiles by itself. */

#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#define FMI __declspec(dllexport)
#else
#define FMI __attribute__((visibility("default")))
#endif

typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer;
typedef int fmi2Boolean;
typedef const char *fmi2String;
typedef void *fmi2Component;
typedef void *fmi2FMUstate;
typedef char fmi2Byte;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef void (*Log)(void *, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
typedef struct {
    Log logger;
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(void *, fmi2Status);
    void *environment;
} Callbacks;

/* What a run is made of; a copy of it is the whole of its state. */
typedef struct {
    double x[NX + 1], past[PAST + 1], u[NU + 1], p[NP + 1], time;
    int set[NX + 1], running; /* states that were set from outside; whether initialisation is over */
} Run;

typedef struct {
    Run run;
    const Callbacks *calls;
    char name[200];
} Instance;

#define OUTPUT NU
#define STATE (NU + NY)
#define CONSTANT (NU + NY + NX)
#define END (NU + NY + NX + NP)
#define AS(c) (&((Instance *)(c))->run)

static fmi2Status refuse(fmi2Component c, const char *why)
{
    Instance *self = c;
    if (self && self->calls && self->calls->logger)
        self->calls->logger(self->calls->environment, self->name, fmi2Error, "logStatusError", "%s", why);
    return fmi2Error;
}

static void begin(Run *run)
{
    struct rest_once once;
    double x[NX + 1];

    prepare_rest(&once, run->p);
    rest(&once, run->p, x);
    for (int i = 0; i < NX; i++)
        if (!run->set[i])
            run->x[i] = x[i];
    for (int i = 0; i < PAST; i++)
        run->past[i] = UNKNOWN;
}

static void reset(Run *run)
{
    memset(run, 0, sizeof *run);
    for (int i = 0; i < NP; i++)
        run->p[i] = constants[i];
    begin(run);
}

FMI const char *fmi2GetTypesPlatform(void) { return "default"; }
FMI const char *fmi2GetVersion(void) { return "2.0"; }

FMI fmi2Component fmi2Instantiate(fmi2String name, int kind, fmi2String guid, fmi2String resources, const Callbacks *calls,
                                  fmi2Boolean visible, fmi2Boolean logging)
{
    Instance *self;
    (void)resources, (void)visible, (void)logging;
    if (kind != 1 || !guid || strcmp(guid, GUID) != 0)
        return NULL; /* not for co-simulation, or another description than this one's */
    self = calloc(1, sizeof *self);
    if (!self)
        return NULL;
    self->calls = calls;
    if (name)
        strncpy(self->name, name, sizeof self->name - 1);
    reset(&self->run);
    return self;
}

FMI void fmi2FreeInstance(fmi2Component c) { free(c); }
FMI fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String kinds[])
{
    (void)c, (void)on, (void)n, (void)kinds;
    return fmi2OK;
}
FMI fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerant, fmi2Real tolerance, fmi2Real from, fmi2Boolean ends, fmi2Real to)
{
    (void)tolerant, (void)tolerance, (void)ends, (void)to;
    AS(c)->time = from;
    return fmi2OK;
}
FMI fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return c ? fmi2OK : fmi2Error; }
FMI fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    begin(AS(c)); /* constants may have been set, and the state at rest follows from them */
    AS(c)->running = 1;
    return fmi2OK;
}
FMI fmi2Status fmi2Terminate(fmi2Component c) { return c ? fmi2OK : fmi2Error; }
FMI fmi2Status fmi2Reset(fmi2Component c)
{
    reset(AS(c));
    return fmi2OK;
}

FMI fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[])
{
    Run *run = AS(c);
    double y[NY];

    if (n && !(vr && value))
        return refuse(c, "no value references, or no place for values");
    if (!run->running)
        begin(run);
    read_sensors(run->x, run->past, run->u, run->p, DT, y);
    for (size_t k = 0; k < n; k++) {
        if (vr[k] >= END) /* before it becomes an int, which may be negative */
            return refuse(c, "unknown value reference");
        const int r = (int)vr[k];
        value[k] = r < OUTPUT ? run->u[r] : r < STATE ? y[r - OUTPUT] : r < CONSTANT ? run->x[r - STATE] : run->p[r - CONSTANT];
    }
    return fmi2OK;
}

FMI fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[])
{
    Run *run = AS(c);

    if (n && !(vr && value))
        return refuse(c, "no value references, or no values");
    for (size_t k = 0; k < n; k++) {
        if (vr[k] >= END)
            return refuse(c, "unknown value reference");
        const int r = (int)vr[k];
        if (r < OUTPUT)
            run->u[r] = value[k];
        else if (r >= STATE && r < CONSTANT && !run->running)
            run->x[r - STATE] = value[k], run->set[r - STATE] = 1;
        else if (r >= CONSTANT && !FIXED[r - CONSTANT])
            run->p[r - CONSTANT] = value[k];
        else if (r >= CONSTANT && value[k] == run->p[r - CONSTANT])
            continue;
        else
            return refuse(c, "this variable cannot be set: an output, a state after initialisation, or a constant of a delay");
    }
    return fmi2OK;
}

/* Sampling intervals in one step: a second of computing, and far from the largest int. */
#define MOST_PARTS 1e7

FMI fmi2Status fmi2DoStep(fmi2Component c, fmi2Real now, fmi2Real length, fmi2Boolean final)
{
    Run *run = AS(c);
    const double ratio = length / DT, whole = floor(ratio + 0.5);
    const int even = whole >= 1 && fabs(ratio - whole) <= 1e-6;
    int parts;

    (void)final;
    /* A step that is tried again is another one, unless the state is set back: the two clocks differ by their rounding alone. */
    if (!(fabs(now - run->time) <= 1e-3 * DT + 1e-9 * fabs(now)))
        return refuse(c, "a step that does not begin where the last one ended");
    if (!(length >= 0))
        return refuse(c, "a step back in time");
    if (!(ratio <= MOST_PARTS))
        return refuse(c, "a step of more than ten million times " DT_TEXT " s: take shorter steps");
    parts = even ? (int)whole : (int)ceil(ratio);
    if (PAST && !even && length > 0)
        return refuse(c, "the delay of an input needs communication steps that are whole multiples of " DT_TEXT " s");
    for (int k = 0; k < parts; k++)
        interval(run->x, run->past, run->u, run->p, even ? DT : length / parts);
    run->time += length;
    for (int i = 0; i < NX; i++)
        if (!(fabs(run->x[i]) <= 1.7e308))
            return refuse(c, "a state is not finite any more");
    return fmi2OK;
}

FMI fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    if (!*state)
        *state = malloc(sizeof(Run));
    if (!*state)
        return refuse(c, "out of memory");
    memcpy(*state, AS(c), sizeof(Run));
    return fmi2OK;
}
FMI fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state)
{
    if (!state)
        return refuse(c, "no state is given");
    memcpy(AS(c), state, sizeof(Run));
    return fmi2OK;
}
FMI fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    (void)c;
    free(*state);
    *state = NULL;
    return fmi2OK;
}
FMI fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size)
{
    (void)c, (void)state;
    *size = sizeof(Run);
    return fmi2OK;
}
FMI fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    if (size < sizeof(Run))
        return refuse(c, "too little room for the state");
    memcpy(bytes, state, sizeof(Run));
    return fmi2OK;
}
FMI fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    if (size < sizeof(Run))
        return refuse(c, "not a state of this model");
    if (!*state)
        *state = malloc(sizeof(Run));
    if (!*state)
        return refuse(c, "out of memory");
    memcpy(*state, bytes, sizeof(Run));
    return fmi2OK;
}

FMI fmi2Status fmi2GetRealStatus(fmi2Component c, int kind, fmi2Real *value)
{
    if (kind != 2)
        return fmi2Discard;
    *value = AS(c)->time; /* the last successful time */
    return fmi2OK;
}

/* What the description does not offer. */
#define NOT_OFFERED(name, arguments, spare)                                                                                 \
    FMI fmi2Status name arguments { return spare, refuse(c, #name " is not offered"); }
NOT_OFFERED(fmi2GetDirectionalDerivative,
            (fmi2Component c, const fmi2ValueReference *a, size_t n, const fmi2ValueReference *b, size_t m, const fmi2Real *d, fmi2Real *e),
            ((void)a, (void)n, (void)b, (void)m, (void)d, (void)e))
NOT_OFFERED(fmi2SetRealInputDerivatives,
            (fmi2Component c, const fmi2ValueReference *vr, size_t n, const fmi2Integer *order, const fmi2Real *value),
            ((void)vr, (void)n, (void)order, (void)value))
NOT_OFFERED(fmi2GetRealOutputDerivatives,
            (fmi2Component c, const fmi2ValueReference *vr, size_t n, const fmi2Integer *order, fmi2Real *value),
            ((void)vr, (void)n, (void)order, (void)value))
NOT_OFFERED(fmi2GetStatus, (fmi2Component c, int kind, fmi2Status *value), ((void)kind, (void)value))
NOT_OFFERED(fmi2GetIntegerStatus, (fmi2Component c, int kind, fmi2Integer *value), ((void)kind, (void)value))
NOT_OFFERED(fmi2GetBooleanStatus, (fmi2Component c, int kind, fmi2Boolean *value), ((void)kind, (void)value))
NOT_OFFERED(fmi2GetStringStatus, (fmi2Component c, int kind, fmi2String *value), ((void)kind, (void)value))
FMI fmi2Status fmi2CancelStep(fmi2Component c) { return refuse(c, "fmi2CancelStep is not offered"); }

/* There are no variables of these types. */
#define NONE_OF(type)                                                                                                       \
    FMI fmi2Status fmi2Get##type(fmi2Component c, const fmi2ValueReference *vr, size_t n, fmi2##type *value)               \
    {                                                                                                                      \
        return (void)vr, (void)value, n ? refuse(c, "no variables of this type") : fmi2OK;                                 \
    }                                                                                                                      \
    FMI fmi2Status fmi2Set##type(fmi2Component c, const fmi2ValueReference *vr, size_t n, const fmi2##type *value)         \
    {                                                                                                                      \
        return (void)vr, (void)value, n ? refuse(c, "no variables of this type") : fmi2OK;                                 \
    }
NONE_OF(Integer)
NONE_OF(Boolean)
NONE_OF(String)
