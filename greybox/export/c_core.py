"""The step of a model as plain C: what the C export and the FMU share."""

from __future__ import annotations

from importlib.resources import files

import casadi as ca

from greybox.export.discrete import Interval
from greybox.integrators.past import extra_columns
from greybox.kernel.emit import Routine, number
from greybox.kernel.tape import read

ADVANCE, OUTPUTS = ("x", "ua", "ub", "q", "h"), ("x", "u", "p")


def core(interval: Interval) -> str:
    """Sizes, the step, the outputs and the state at rest: C99, for arrays of doubles, without memory of its own.

    Raises UnsupportedOperationError for an operation that C does not have.
    """
    step = interval.step
    columns = len(interval.model.inputs) + extra_columns(step.past)
    sizes = {
        "NX": len(interval.x0), "NU": len(interval.model.inputs), "NY": len(interval.model.outputs), "NP": len(interval.p),
        "NQ": len(interval.coefficients()), "PAST": interval.past, "LATE": interval.late_input, "COLUMNS": max(columns, 1),
        "SUBSTEPS": step.substeps,
    }  # fmt: skip
    system = interval.model.system
    start = ca.Function("start", [system.p], [ca.densify(system.start)])
    routines = [
        Routine("advance", read(step.advance, varying=(0, 1, 2)), ADVANCE, (), 0),
        Routine("outputs", read(step.outputs, varying=(0, 1)), OUTPUTS, (), 0),
        Routine("start", read(start), ("p",), (), 0),
    ]
    return "\n".join(
        [
            "#include <math.h>", "", "#define INLINE static", *(f"#define {name} {size}" for name, size in sizes.items()), "",
            *(routine.text() for routine in routines), template("step.c"),
        ]
    )  # fmt: skip


def template(name: str) -> str:
    """The text of a C file beside this one."""
    return files("greybox.export").joinpath(name).read_text(encoding="utf-8")


def comment(text: str) -> str:
    """Text that cannot end a comment of C."""
    return text.replace("*/", "* /").replace("/*", "/ *")


def rows(values: list[float], remarks: list[str]) -> str:
    """Initialisers of an array, one a line, each with a remark."""
    return "\n".join(f"    {number(float(v))}, /* {comment(r)} */" for v, r in zip(values, remarks, strict=True))
