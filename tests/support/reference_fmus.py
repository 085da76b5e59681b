"""The Van der Pol oscillator, Dahlquist's equation and the bouncing ball as FMUs of FMI 2 and 3, for model exchange and co-simulation.

Equations, names and start values are those that the Modelica Association publishes with its reference FMUs; the C is written here. A
mass on a spring with an input is beside them. A run with a parameter above ``FAILS_ABOVE`` reports an error.
"""

from __future__ import annotations

import subprocess
import zipfile
from pathlib import Path
from typing import NamedTuple

from greybox.simulation.kernel.c_compiler import find_compiler


class ReferenceModel(NamedTuple):
    """States with their start, the parameter with its start, and the rates in C over ``x``, ``p`` and the input ``u``.

    ``slopes`` fills their Jacobian ``J`` by rows: the model then provides directional derivatives along its states. ``jump`` is what
    happens where the first state falls below zero.
    """

    name: str
    states: tuple[tuple[str, float], ...]
    parameter: tuple[str, float]
    rates: str
    slopes: str = ""
    jump: str = ""
    input: str = ""


VAN_DER_POL = ReferenceModel(
    "VanDerPol",
    (("x0", 2.0), ("x1", 0.0)),
    ("mu", 1.0),
    "d[0] = x[1]; d[1] = p * ((1 - x[0] * x[0]) * x[1]) - x[0];",
    "J[0] = 0; J[1] = 1; J[2] = -2 * p * x[0] * x[1] - 1; J[3] = p * (1 - x[0] * x[0]);",
)
DAHLQUIST = ReferenceModel("Dahlquist", (("x", 1.0),), ("k", 1.0), "d[0] = -p * x[0];")
BOUNCING_BALL = ReferenceModel(
    "BouncingBall",
    (("h", 1.0), ("v", 0.0)),
    ("e", 0.7),
    "d[0] = x[1]; d[1] = -9.81;",
    jump="if (x[1] < 0) { x[0] = 1e-14; x[1] = -p * x[1]; return 1; } return 0;",
)
MASS = ReferenceModel(
    "Mass",
    (("x", 0.0), ("v", 0.0)),
    ("K", 30.0),
    "d[0] = x[1]; d[1] = u - 1.5 * x[1] - p * x[0];",
    "J[0] = 0; J[1] = 1; J[2] = -p; J[3] = -1.5;",
    input="F",
)
FAILS_ABOVE = 50.0
STEP = 1e-2
"""Step of the Runge-Kutta method inside a co-simulation, in seconds."""

COMMON = """
#include <stdlib.h>
#include <string.h>
#define N %(count)d
typedef struct { double time, x[N], p, u; } Run;
static const double begin[N] = {%(starts)s};
static void rates(const double *x, double p, double u, double *d) { %(rates)s }
static int jump(double *x, double p) { %(jump)s }
static int along(const Run *r, const unsigned *z, size_t nz, const unsigned *v, size_t nv, const double *dv, double *dz) {
    double J[N * N], seed[N] = {0};
    const double *x = r->x, p = r->p;
    if (!%(differentiable)d) return 3;
    %(slopes)s
    for (size_t i = 0; i < nv; i++) {
        if (!v[i] || v[i] > N) return 3;
        seed[v[i] - 1] = dv[i];
    }
    for (size_t i = 0; i < nz; i++) {
        dz[i] = 0;
        if (z[i] && z[i] <= N) dz[i] = seed[z[i] - 1];
        else if (z[i] <= 2 * N) for (int j = 0; j < N; j++) dz[i] += J[(z[i] - N - 1) * N + j] * seed[j];
        else return 3;
    }
    return 0;
}
static Run *make(void) {
    Run *r = calloc(1, sizeof *r);
    memcpy(r->x, begin, sizeof begin);
    r->p = %(value)r;
    return r;
}
static void reset(Run *r) { r->time = 0; memcpy(r->x, begin, sizeof begin); r->p = %(value)r; r->u = 0; }
static double get(const Run *r, unsigned k) {
    double d[N];
    if (k == 0) return r->time;
    if (k <= N) return r->x[k - 1];
    if (k <= 2 * N) { rates(r->x, r->p, r->u, d); return d[k - N - 1]; }
    return k == 2 * N + 1 ? r->p : r->u;
}
static void set(Run *r, unsigned k, double v) {
    if (k && k <= N) r->x[k - 1] = v;
    else if (k == 2 * N + 1) r->p = v;
    else if (k > 2 * N + 1) r->u = v;
}
static int advance(Run *r, double to) {
    double a[N], b[N], c[N], d[N], y[N];
    while (r->time < to - 1e-9) {
        double h = to - r->time < %(step)r ? to - r->time : %(step)r;
        rates(r->x, r->p, r->u, a);
        for (int i = 0; i < N; i++) y[i] = r->x[i] + h / 2 * a[i];
        rates(y, r->p, r->u, b);
        for (int i = 0; i < N; i++) y[i] = r->x[i] + h / 2 * b[i];
        rates(y, r->p, r->u, c);
        for (int i = 0; i < N; i++) y[i] = r->x[i] + h * c[i];
        rates(y, r->p, r->u, d);
        for (int i = 0; i < N; i++) r->x[i] += h / 6 * (a[i] + 2 * b[i] + 2 * c[i] + d[i]);
        r->time += h;
        if (%(jumps)d && r->x[0] < 0) jump(r->x, r->p);
    }
    return r->p > %(fails)r ? 3 : 0;
}
"""
FMI2 = """
const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
void *fmi2Instantiate(const char *n, int t, const char *g, const char *r, const void *f, int v, int l) { return make(); }
void fmi2FreeInstance(void *c) { free(c); }
int fmi2SetDebugLogging(void *c, int l, size_t n, const void *k) { return 0; }
int fmi2SetupExperiment(void *c, int d, double tol, double from, int e, double to) { ((Run *)c)->time = from; return 0; }
int fmi2EnterInitializationMode(void *c) { return 0; }
int fmi2ExitInitializationMode(void *c) { return 0; }
int fmi2Terminate(void *c) { return 0; }
int fmi2Reset(void *c) { reset(c); return 0; }
int fmi2GetReal(void *c, const unsigned *k, size_t m, double *v) { for (size_t i = 0; i < m; i++) v[i] = get(c, k[i]); return 0; }
int fmi2SetReal(void *c, const unsigned *k, size_t m, const double *v) { for (size_t i = 0; i < m; i++) set(c, k[i], v[i]); return 0; }
int fmi2DoStep(void *c, double t, double h, int n) { return advance(c, t + h); }
int fmi2EnterEventMode(void *c) { return 0; }
int fmi2NewDiscreteStates(void *c, void *info)
{ Run *r = c; memset(info, 0, 5 * sizeof(int)); if (%(jumps)d && r->x[0] <= 0) ((int *)info)[3] = jump(r->x, r->p); return 0; }
int fmi2GetDirectionalDerivative(void *c, const unsigned *z, size_t nz, const unsigned *v, size_t nv, const double *dv, double *dz)
{ return along(c, z, nz, v, nv, dv, dz); }
int fmi2EnterContinuousTimeMode(void *c) { return 0; }
int fmi2CompletedIntegratorStep(void *c, int n, int *e, int *t) { *e = *t = 0; return 0; }
int fmi2SetTime(void *c, double t) { ((Run *)c)->time = t; return 0; }
int fmi2SetContinuousStates(void *c, const double *x, size_t n) { memcpy(((Run *)c)->x, x, n * sizeof *x); return 0; }
int fmi2GetContinuousStates(void *c, double *x, size_t n) { memcpy(x, ((Run *)c)->x, n * sizeof *x); return 0; }
int fmi2GetNominalsOfContinuousStates(void *c, double *x, size_t n) { while (n) x[--n] = 1; return 0; }
int fmi2GetDerivatives(void *c, double *d, size_t n)
{ Run *r = c; rates(r->x, r->p, r->u, d); return r->p > %(fails)r && r->time > 1 ? 3 : 0; }
int fmi2GetEventIndicators(void *c, double *z, size_t n) { if (n) z[0] = ((Run *)c)->x[0]; return 0; }
"""
FMI3 = """
#include <stdbool.h>
#include <stdint.h>
const char *fmi3GetVersion(void) { return "3.0"; }
int fmi3SetDebugLogging(void *c, bool l, size_t n, const void *k) { return 0; }
void *fmi3InstantiateModelExchange(const char *n, const char *g, const char *r, bool v, bool l, void *e, void *f) { return make(); }
void *fmi3InstantiateCoSimulation(const char *n, const char *g, const char *r, bool v, bool l, bool ev, bool ea, const void *k, size_t m,
                                  void *e, void *f, void *i) { return make(); }
void fmi3FreeInstance(void *c) { free(c); }
int fmi3EnterInitializationMode(void *c, bool d, double tol, double from, bool e, double to) { ((Run *)c)->time = from; return 0; }
int fmi3ExitInitializationMode(void *c) { return 0; }
int fmi3EnterEventMode(void *c) { return 0; }
int fmi3Terminate(void *c) { return 0; }
int fmi3Reset(void *c) { reset(c); return 0; }
int fmi3GetFloat64(void *c, const uint32_t *k, size_t m, double *v, size_t n)
{ for (size_t i = 0; i < m; i++) v[i] = get(c, k[i]); return 0; }
int fmi3SetFloat64(void *c, const uint32_t *k, size_t m, const double *v, size_t n)
{ for (size_t i = 0; i < m; i++) set(c, k[i], v[i]); return 0; }
int fmi3UpdateDiscreteStates(void *c, bool *a, bool *b, bool *d, bool *e, bool *f, double *t)
{ Run *r = c; *a = *b = *d = *e = *f = 0; *t = 0; if (%(jumps)d && r->x[0] <= 0) *e = jump(r->x, r->p); return 0; }
int fmi3GetDirectionalDerivative(void *c, const uint32_t *z, size_t nz, const uint32_t *v, size_t nv, const double *dv, size_t ns,
                                 double *dz, size_t nd) { return along(c, z, nz, v, nv, dv, dz); }
int fmi3EnterContinuousTimeMode(void *c) { return 0; }
int fmi3CompletedIntegratorStep(void *c, bool n, bool *e, bool *t) { *e = *t = 0; return 0; }
int fmi3SetTime(void *c, double t) { ((Run *)c)->time = t; return 0; }
int fmi3SetContinuousStates(void *c, const double *x, size_t n) { memcpy(((Run *)c)->x, x, n * sizeof *x); return 0; }
int fmi3GetContinuousStates(void *c, double *x, size_t n) { memcpy(x, ((Run *)c)->x, n * sizeof *x); return 0; }
int fmi3GetNominalsOfContinuousStates(void *c, double *x, size_t n) { while (n) x[--n] = 1; return 0; }
int fmi3GetContinuousStateDerivatives(void *c, double *d, size_t n)
{ Run *r = c; rates(r->x, r->p, r->u, d); return r->p > %(fails)r && r->time > 1 ? 3 : 0; }
int fmi3GetEventIndicators(void *c, double *z, size_t n) { if (n) z[0] = ((Run *)c)->x[0]; return 0; }
int fmi3GetNumberOfContinuousStates(void *c, size_t *n) { *n = N; return 0; }
int fmi3GetNumberOfEventIndicators(void *c, size_t *n) { *n = %(jumps)d; return 0; }
int fmi3DoStep(void *c, double t, double h, bool n, bool *e, bool *q, bool *r, double *last)
{ *e = *q = *r = 0; *last = t + h; return advance(c, t + h); }
"""


def build_reference_fmu(model: ReferenceModel, folder: Path, version: str, kind: str) -> Path:
    """The FMU of ``model``: ``version`` 2.0 or 3.0, ``kind`` CoSimulation or ModelExchange."""
    values = {
        "count": len(model.states),
        "starts": ", ".join(repr(start) for _, start in model.states),
        "rates": model.rates,
        "slopes": model.slopes,
        "differentiable": bool(model.slopes),
        "jump": model.jump or "return 0;",
        "jumps": bool(model.jump),
        "value": model.parameter[1],
        "step": STEP,
        "fails": FAILS_ABOVE,
    }
    text = (COMMON + (FMI2 if version == "2.0" else FMI3)) % values
    text += "".join(f"int {name}(void) {{ return 3; }}\n" for name in list_functions(version) if f"{name}(" not in text)
    source = folder / f"{model.name}.c"
    source.write_text(text)
    library = folder / f"{model.name}.so"
    subprocess.run(
        [*find_compiler().command, "-O1", "-std=c99", "-w", "-shared", "-fPIC", "-o", str(library), str(source)],
        check=True,
    )
    path = folder / f"{model.name}{version[0]}{kind}.fmu"
    binary = "linux64" if version == "2.0" else "x86_64-linux"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", describe(model, version, kind))
        archive.write(library, f"binaries/{binary}/{model.name}.so")
    return path


def list_functions(version: str) -> list[str]:
    """Every function of the standard that fmpy looks for when it loads a library."""
    from fmpy import fmi2, fmi3

    classes = (fmi2.FMU2Model, fmi2.FMU2Slave) if version == "2.0" else (fmi3.FMU3Model, fmi3.FMU3Slave)
    return sorted({name for c in classes for name in dir(c) if name.startswith(f"fmi{version[0]}")})


def describe(model: ReferenceModel, version: str, kind: str) -> str:
    """Its modelDescription.xml."""
    n = len(model.states)
    three = version == "3.0"
    rows = [("time", 0, 'causality="independent" variability="continuous"', "")]
    for k, (name, start) in enumerate(model.states, 1):
        rows.append((name, k, 'causality="output" variability="continuous" initial="exact"', f'start="{start}"'))
    for k, (name, _) in enumerate(model.states, 1):
        of = f'derivative="{k if three else k + 1}"'
        rows.append((f"der({name})", n + k, 'causality="local" variability="continuous"', of))
    rows.append(
        (
            model.parameter[0],
            2 * n + 1,
            'causality="parameter" variability="tunable"',
            f'start="{model.parameter[1]}" min="0"',
        )
    )
    if model.input:
        rows.append((model.input, 2 * n + 2, 'causality="input" variability="continuous"', 'start="0"'))
    provides = f' providesDirectionalDerivative{"s" if three else ""}="true"' if model.slopes else ""
    jumps = int(bool(model.jump))
    if three:
        variables = "".join(
            f'<Float64 name="{name}" valueReference="{r}" {how} {more}/>' for name, r, how, more in rows
        )
        outputs = "".join(f'<Output valueReference="{k}"/>' for k in range(1, n + 1))
        rates = "".join(f'<ContinuousStateDerivative valueReference="{n + k}"/>' for k in range(1, n + 1))
        indicators = '<EventIndicator valueReference="1"/>' * jumps
        structure, identity = outputs + rates + indicators, f'instantiationToken="{model.name}"'
    else:
        variables = "".join(
            f'<ScalarVariable name="{name}" valueReference="{r}" {how}><Real {more}/></ScalarVariable>'
            for name, r, how, more in rows
        )
        unknowns = ["".join(f'<Unknown index="{k + at}"/>' for k in range(1, n + 1)) for at in (1, n + 1)]
        structure, identity = (
            f"<Outputs>{unknowns[0]}</Outputs><Derivatives>{unknowns[1]}</Derivatives>",
            f'guid="{model.name}"',
        )
    return (
        f'<?xml version="1.0"?><fmiModelDescription fmiVersion="{version}" modelName="{model.name}" {identity}'
        f'{"" if three else f" numberOfEventIndicators={chr(34)}{jumps}{chr(34)}"}><{kind} modelIdentifier="{model.name}"{provides}'
        f" {'canHandleVariableCommunicationStepSize=' + chr(34) + 'true' + chr(34) if kind == 'CoSimulation' else ''}/>"
        f"<ModelVariables>{variables}</ModelVariables><ModelStructure>{structure}</ModelStructure></fmiModelDescription>"
    )
