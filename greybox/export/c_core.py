"""The step of a model as plain C: what the C export and the FMU share."""

from __future__ import annotations

from importlib.resources import files

from greybox.export.discrete_step import DiscreteStep
from greybox.export.texts import to_comment
from greybox.expressions.c import c_literal
from greybox.integrators.input_delay import count_history_columns
from greybox.kernel.c_routine import CRoutine
from greybox.kernel.tape import read_tape

ADVANCE, OUTPUTS = ("x", "ua", "ub", "q", "h"), ("x", "u", "p")


def write_step(interval: DiscreteStep) -> str:
    """Sizes, the step, the outputs and the state at rest: C99, for arrays of doubles, without memory of its own.

    Raises UnsupportedOperationError for an operation that C does not have.
    """
    step = interval.step
    columns = len(interval.interface.inputs) + count_history_columns(step.past)
    sizes = {
        "NX": len(interval.x0),
        "NU": len(interval.interface.inputs),
        "NY": len(interval.interface.outputs),
        "NP": len(interval.p),
        "NQ": len(interval.coefficients()),
        "PAST": interval.past,
        "LATE": interval.late_input,
        "COLUMNS": max(columns, 1),
        "SUBSTEPS": step.substeps,
    }
    routines = [
        CRoutine("advance", read_tape(step.advance, varying=(0, 1, 2)), ADVANCE, (), 0),
        CRoutine("outputs", read_tape(step.outputs, varying=(0, 1)), OUTPUTS, (), 0),
        CRoutine("start", read_tape(interval.start_function()), ("p",), (), 0),
    ]
    return "\n".join(
        [
            "#include <math.h>",
            "",
            "#define INLINE static",
            *(f"#define {name} {size}" for name, size in sizes.items()),
            "",
            *(routine.text() for routine in routines),
            read_template("step.c"),
        ]
    )


def read_template(name: str) -> str:
    """The text of a C file beside this one."""
    return files("greybox.export").joinpath(name).read_text(encoding="utf-8")


def write_initialisers(values: list[float], remarks: list[str]) -> str:
    """Initialisers of an array, one a line, each with a remark."""
    return "\n".join(f"    {c_literal(float(v))}, /* {to_comment(r)} */" for v, r in zip(values, remarks, strict=True))
