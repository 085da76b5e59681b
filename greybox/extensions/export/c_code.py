"""One discrete step as C that stands alone: a header to read, a source to compile."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from greybox.base import format_unit, write_file
from greybox.base.texts import to_comment, to_identifier, to_identifiers
from greybox.estimation.linear.exported_model import ExportedModel, to_plant
from greybox.estimation.result import Fit
from greybox.extensions.export.discrete_step import DiscreteStep, make_discrete_step
from greybox.extensions.export.observer import Observer, refuse_sampling
from greybox.extensions.export.target import ExportTarget, read_template
from greybox.model import Input, Model, Output, State, equations_text
from greybox.model.expressions.printer import c_literal
from greybox.simulation.integrators.input_delay import count_history_columns
from greybox.simulation.kernel.c_routine import CRoutine
from greybox.simulation.kernel.tape import read_tape

# The step of a model as plain C: what the C export and the FMU share.

ADVANCE, OUTPUTS = ("x", "ua", "ub", "q", "h"), ("x", "u", "p")


def write_step(interval: DiscreteStep) -> str:
    """Sizes, the step, the outputs and the state at rest: C99, for arrays of doubles, without memory of its own.

    Raises UnsupportedOperationError for an operation that C does not have.
    """
    step = interval.step
    # A row of the step: the inputs, then the past of a delayed one with its share of the interval.
    columns = len(interval.signals.inputs) + count_history_columns(step.past)
    sizes = {
        "NX": len(interval.x0),
        "NU": len(interval.signals.inputs),
        "NY": len(interval.signals.outputs),
        "NP": len(interval.p),
        "NQ": len(interval.coefficients()),
        "PAST": interval.past,
        "LATE": interval.late_input,
        "COLUMNS": max(columns, 1),
        "SUBSTEPS": step.substeps,
    }
    # The functions of a model end in _start, _outputs and _step, none of these does: no name of a model is that of one here.
    routines = [
        # Without tangents, which need vector types, and without fused products: the text is plain C99.
        CRoutine("advance", read_tape(step.advance, varying=(0, 1, 2)), ADVANCE, (), 0),
        CRoutine("sensors", read_tape(step.outputs, varying=(0, 1)), OUTPUTS, (), 0),
        # The state at rest may follow from constants that somebody changes in the source.
        CRoutine("rest", read_tape(interval.start), ("p",), (), 0),
    ]
    return "\n".join(
        [
            *(["#include <float.h>"] if interval.past else []),
            "#include <math.h>",
            "",
            "#define INLINE static",
            *(f"#define {name} {size}" for name, size in sizes.items()),
            # Equal to itself whatever the compiler may assume of numbers, which NaN is not.
            f"#define UNKNOWN {'DBL_MAX' if interval.past else '0'} /* an earlier input that nobody gave */",
            "",
            *(routine.text() for routine in routines),
            read_template("step.c"),
        ]
    )


def write_constants(plant: ExportedModel, interval: DiscreteStep) -> list[str]:
    """The array of the constants, one a line, each with its unit and where it comes from."""
    lines = []
    for q, value in zip(interval.signals.all_parameters, interval.p, strict=True):
        # Unit and origin stand beside each number: the file is read without the model.
        remark = to_comment(f"{q.name} [{format_unit(q.unit) or '-'}] {plant.provenance(q.name)}")
        lines.append(f"    {c_literal(float(value))}, /* {remark} */")
    return ["static const double constants[] = {", *(lines or ["    0"]), "};"]


# Keywords of C and C++, and what headers and compilers define in small letters: a macro replaces the name of a member as well.
RESERVED = frozenset(
    re.findall(
        r"\w+",
        """
        auto break case char const continue default do double else enum extern float for goto if inline int long
        register restrict return short signed sizeof static struct switch typedef union unsigned void volatile
        while alignas alignof asm atomic_cancel atomic_commit atomic_noexcept bool catch class co_await co_return co_yield
        concept const_cast consteval constexpr constinit char8_t char16_t char32_t decltype delete dynamic_cast explicit export
        false friend mutable namespace new noexcept nullptr operator private protected public reflexpr reinterpret_cast
        requires static_assert static_cast synchronized template this thread_local throw true try typeid typename typeof
        typeof_unqual using virtual wchar_t and and_eq bitand bitor compl not not_eq or or_eq xor xor_eq
        alloca arm assert cdecl complex environ errno far huge i386 imaginary interface linux major makedev max min minor
        mips near noreturn pascal powerpc small sparc stderr stdin stdout sun unix vax
        sa_handler sa_sigaction st_atime st_ctime st_mtime si_pid si_uid si_value si_addr si_status si_band
        s_addr s6_addr h_addr d_fileno ru_first ru_last setjmp va_arg va_copy va_end va_start offsetof
        I NULL
        """,
    )
)
# How macros are written: a name of this shape may be one of any header, so none of ours is.
MACRO = re.compile(r"[A-Z][A-Z0-9_]*[A-Z0-9_]")


def to_c(
    plant: Fit | Model | Observer, path: str | Path, *, dt: float | None = None, substeps: int = 0
) -> tuple[Path, Path]:
    """Write one sampling interval of a model as C99 without dependencies: a source and the header beside it.

    It is the library's own step (exact hold or Runge-Kutta with its substeps), with every effect in it: friction that sticks, bristles,
    play, delays. The parameters are in the source with their units and where they come from; nothing is allocated, there are no globals
    that change.

    Parameters
    ----------
    plant
        A fit, a model at its present values, or an `Observer`: its state is the estimate with its covariance, its inputs are those of
        the plant and the measurements (NaN for a missing one), its outputs the states after them with their standard deviations.
    path
        Of the source, ``plant.c``.
    dt
        Sampling time in s; None takes that of the fitted records.
    substeps
        Of a Runge-Kutta step; 0 chooses.

    Returns
    -------
    tuple of Path
        The source and the header.

    Raises
    ------
    ModelError
        Where no sampling time is known.
    UnsupportedOperationError
        For an operation that C does not have.
    """
    interval: DiscreteStep
    if isinstance(plant, Observer):
        refuse_sampling(dt, substeps)
        source, interval = plant.plant, plant.corrected
    else:
        source = to_plant(plant)
        interval = make_discrete_step(source, dt, substeps=substeps)
    target = Path(path).with_suffix(".c")
    header = target.with_suffix(".h")
    text = _source(source, interval, header.name)
    declarations = write_file(header, _header(source, interval))
    return write_file(target, text), declarations


def _header(plant: ExportedModel, interval: DiscreteStep) -> str:
    model, name = interval.signals, to_identifier(interval.signals.name)
    # Equations and constants are those of the plant, also in the header of its observer.
    table = [
        (q.name, repr(float(q.value)), format_unit(q.unit) or "-", plant.provenance(q.name))
        for q in plant.model.all_parameters
    ]
    # Columns under one another, the last one as long as it is.
    widths = [max(len(row[k]) for row in table) for k in range(3)] if table else [0, 0, 0]
    constants = ["  " + "  ".join(c.ljust(w) for c, w in zip(row, [*widths, 0], strict=True)).rstrip() for row in table]
    about = [
        f"{model.title}: {model.description}" if model.description else model.title,
        "",
        *equations_text(plant.model).splitlines(),
        "",
        f"One step is {interval.dt:g} s with the input held; integrated by {interval.step.label}.",
        *(
            [
                f"Half the step changes a state by {interval.deviation:.1e} of its movement at most, over the record or a step of inputs."
            ]
            if interval.deviation > 0
            else []
        ),
        "",
        "Constants",
        *constants,
        "",
        *plant.origin(),
        *(f"Note: {finding}" for finding in plant.findings),
    ]
    structures = [
        *_struct(f"{name}_state", model.all_states, _past_members(interval)),
        *_struct(f"{name}_input", model.inputs),
        *_struct(f"{name}_output", model.outputs),
    ]
    return read_template(
        "plant.h",
        about="\n".join(f"   {to_comment(line)}".rstrip() for line in about),
        name=name,
        NAME=name.upper(),
        dt=c_literal(interval.dt),
        interval=f"{interval.dt:g}",
        structures="\n".join(structures),
    )


def _source(plant: ExportedModel, interval: DiscreteStep, header_name: str) -> str:
    model, name = interval.signals, to_identifier(interval.signals.name)
    coefficients: list[str] = []
    # An exact hold computes nothing from the constants: its matrices are numbers of their own.
    if interval.step.per_interval:
        coefficients = [
            "/* Exact discretisation with these constants for one sampling time; changing a constant above does not change these:",
            "   export the model anew. */",
            "static const double coefficients[] = {",
            *_blocks(interval),
            "};\n\n",
        ]
    members = _members(model.all_states, _past_members(interval))
    states, past = members[: len(model.all_states)], members[len(model.all_states) :]
    inputs, outputs = _members(model.inputs), _members(model.outputs)

    def assign(to: str, names: Sequence[str], source: str) -> str:
        return "".join(f"    {to}->{member} = {source}[{k}];\n" for k, member in enumerate(names))

    # C has no empty array: a model without inputs has one element that nothing reads.
    return read_template(
        "plant.c",
        title=to_comment(model.title),
        described=to_comment(header_name),
        header=header_name,
        step=write_step(interval),
        constants="\n".join(write_constants(plant, interval)) + "\n",
        coefficients="\n".join(coefficients),
        use="coefficients" if coefficients else "constants",
        name=name,
        NAME=name.upper(),
        states=", ".join(f"state->{m}" for m in states) or "0",
        past=", ".join(f"state->{m}" for m in past) or "0",
        inputs=", ".join(f"input->{m}" for m in inputs) or "0",
        unused="" if inputs else "    (void)input;\n",
        begin=assign("state", states, "x") + "".join(f"    state->{m} = UNKNOWN;\n" for m in past),
        show=assign("output", outputs, "y"),
        keep=assign("state", states, "x") + assign("state", past, "past"),
    )


def _struct(name: str, signals: Sequence[State | Input | Output], extra: Sequence[tuple[str, str]] = ()) -> list[str]:
    remarks = [f"[{format_unit(s.unit) or '-'}] {s.description}".rstrip() for s in signals] + [
        remark for _, remark in extra
    ]
    # C has no empty structure either.
    members = _members(signals, extra) or ["none"]
    remarks = remarks or ["nothing"]
    width = max(map(len, members)) + 1
    lines = [f"    double {m + ';':{width}} /* {to_comment(r)} */" for m, r in zip(members, remarks, strict=True)]
    return [f"struct {name} {{", *lines, "};", ""]


def _members(signals: Sequence[State | Input | Output], extra: Sequence[tuple[str, str]] = ()) -> list[str]:
    return to_identifiers([*(s.name for s in signals), *(name for name, _ in extra)], spell=_to_member)


def _to_member(name: str) -> str:
    plain = to_identifier(name)
    # An underscore at the end is in no word of the language, of a library or of a system.
    return f"{plain}_" if plain in RESERVED or MACRO.fullmatch(plain) else plain


def _past_members(interval: DiscreteStep) -> list[tuple[str, str]]:
    if not interval.past:
        return []
    late = interval.signals.inputs[interval.late_input]
    return [
        (
            f"{late.name}_{k + 1}",
            f"[{format_unit(late.unit) or '-'}] {late.name} of {k + 1} steps ago; DBL_MAX: as in the first step",
        )
        for k in range(interval.past)
    ]


def _blocks(interval: DiscreteStep) -> list[str]:
    """The coefficients of the exact hold, block by block."""
    nx, nu = len(interval.x0), len(interval.signals.inputs)
    sizes = {
        "Phi: x+ = Phi x + ..., column by column": nx * nx,
        "Gamma of the held inputs and of the constant 1": nx * (nu + 1),
    }
    # The first-order hold's second matrix is there, too: the step has one layout for both.
    sizes |= {"of inputs that are linear in between (not used here)": nx * nu}
    q, lines = interval.coefficients(), []
    for title, size in [
        *sizes.items(),
        ("of the delayed input, 0, 1, 2 ... intervals ago", len(q) - sum(sizes.values())),
    ]:
        texts, q = [c_literal(float(v)) for v in q[:size]], q[size:]
        if texts:
            lines += [f"    /* {title} */", *("    " + ", ".join(texts[k : k + nx]) + "," for k in range(0, size, nx))]
    return lines


TARGET = ExportTarget(
    "C",
    ".c",
    # The header first: in the order in which they are read.
    lambda plant, path, **options: to_c(plant, path, **options)[::-1],
    options=frozenset(["dt", "substeps", "observer"]),
    stepped="one step of",
)
