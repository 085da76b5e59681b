/* The tape machine: the loops over a record with sizes and instructions as data, so that a model's equations run without being compiled.
   VALUE_CASES are the operations on values, generated; the numbers of the others are those of tape_machine.py. An instruction is its
   number, where the result goes, and where the operands are. */

#include <stdint.h>
#include <stdlib.h>

typedef void code(double *r, v *t, const double *const *in, const vu *const *din, double *z, v *dz);
struct routine {
    long values, tangents, numbers; /* of registers; the first `numbers` registers hold constants, tangent register 0 is zero */
    const int *once, *each;
    const double *constants;
    code *run_once, *run_each; /* machine code in the place of instructions, or NULL */
};
struct machine {
    long nx, nu, nq, ny, nb;
    struct routine advance, outputs, generator;
};
struct registers {
    const struct routine *routine;
    double *r;
    v *t;
    int nb;
};

#define LOAD -4
#define LOAD_TANGENT -5
#define STORE -6
#define STORE_TANGENT -7
#define PICK -8
#define SUM_1 -9
#define SUM_2 -10
#define SUM_3 -11
#define SUM_MORE -12
#define END -13

#define RUN run
#define LANE v
#define LANE_U vu
#define FUSE FMA_LANES
#include "machine_run.h"

/* Two blocks at a time, where the processor has registers of that width. A lane is computed as it is alone: the bits are the same. */
#if defined(__AVX512F__) && W == 4
typedef double wide __attribute__((vector_size(16 * W), aligned(8), may_alias));
INLINE wide FMA_WIDE(double a, wide b, wide c)
{
    return __builtin_ia32_vfmaddpd512_mask(a - (wide){0}, b, c, -1, 4);
}
#define RUN run_wide
#define LANE wide
#define LANE_U wide
#define FUSE FMA_WIDE
#include "machine_run.h"
INLINE void run_many(const int *pc, double *r, v *t, const double *const *in, const vu *const *din, double *z, v *dz, const int nb)
{
    if (nb % 2)
        run(pc, r, t, in, din, z, dz, nb);
    else
        run_wide(pc, r, (wide *)t, in, (const wide *const *)din, z, (wide *)dz, nb / 2);
}
#else
#define run_many run
#endif

/* Compiled code, or else the instructions, with the usual numbers of blocks as constants: their loops then vanish. */
static void execute(const struct registers *c, const int *pc, code *compiled, const double *const *in, const vu *const *din, double *z, v *dz)
{
    if (compiled) {
        compiled(c->r, c->t, in, din, z, dz);
        return;
    }
    switch (c->nb) {
    case 0:
        run(pc, c->r, c->t, in, din, z, dz, 0);
        return;
    case 1:
        run(pc, c->r, c->t, in, din, z, dz, 1);
        return;
    case 2:
        run(pc, c->r, c->t, in, din, z, dz, 2);
        return;
    case 3:
        run(pc, c->r, c->t, in, din, z, dz, 3);
        return;
    case 4:
        run(pc, c->r, c->t, in, din, z, dz, 4);
        return;
    default:
        run_many(pc, c->r, c->t, in, din, z, dz, c->nb);
    }
}

INLINE struct registers open_registers(const struct routine *routine, double *r, v *t, int nb)
{
    memcpy(r, routine->constants, routine->numbers * sizeof *r);
    for (int b = 0; b < nb; b++)
        t[b] = zero;
    return (struct registers){routine, r, t, nb};
}

#undef CONTEXT
#undef PASS
#undef ROUTINE
#define CONTEXT const struct machine *m,
#define PASS m,
#define NX (m->nx)
#define NU (m->nu)
#define NQ (m->nq)
#define NY (m->ny)
#define NB (m->nb)
#define ALL_HELD 0
#define SUBSTEPS substeps
/* Registers lie on the heap: those of a large model outgrow the stack of a thread. */
#define ROUTINE(name, once)                                                                                                              \
    __attribute__((cleanup(release))) char *once##_memory =                                                                              \
        malloc(sizeof(v) * (1 + AT_LEAST_ONE(m->name.tangents * NB)) + sizeof(double) * m->name.values);                                \
    v *const once##_tangents = (v *)(once##_memory + sizeof(v) - (uintptr_t)once##_memory % sizeof(v));                                  \
    double *const once##_values = (double *)(once##_tangents + AT_LEAST_ONE(m->name.tangents * NB));                                     \
    const struct registers once = open_registers(&m->name, once##_values, once##_tangents, NB)

static void release(char **memory)
{
    free(*memory);
}

#define ADVANCE const double *x, const vu *dx, const double *ua, const double *ub, const double *q, const vu *dq, const double *h
#define ADVANCE_IN (const double *[]){x, ua, ub, q, h}, (const vu *[]){dx, 0, 0, dq, 0}
#define OUTPUTS const double *x, const vu *dx, const double *u, const double *p, const vu *dp
#define OUTPUTS_IN (const double *[]){x, u, p}, (const vu *[]){dx, 0, dp}

INLINE void prepare_advance(const struct registers *c, ADVANCE)
{
    execute(c, c->routine->once, c->routine->run_once, ADVANCE_IN, 0, 0);
}

INLINE void advance(const struct registers *c, ADVANCE, double *z, v *dz)
{
    execute(c, c->routine->each, c->routine->run_each, ADVANCE_IN, z, dz);
}

INLINE void prepare_outputs(const struct registers *c, OUTPUTS)
{
    execute(c, c->routine->once, c->routine->run_once, OUTPUTS_IN, 0, 0);
}

INLINE void outputs(const struct registers *c, OUTPUTS, double *z, v *dz)
{
    execute(c, c->routine->each, c->routine->run_each, OUTPUTS_IN, z, dz);
}

INLINE void prepare_generator(const struct registers *c, const double *p, const vu *dp)
{
    execute(c, c->routine->once, c->routine->run_once, (const double *[]){p}, (const vu *[]){dp}, 0, 0);
}

INLINE void generator(const struct registers *c, const double *p, const vu *dp, double *z, v *dz)
{
    execute(c, c->routine->each, c->routine->run_each, (const double *[]){p}, (const vu *[]){dp}, z, dz);
}
