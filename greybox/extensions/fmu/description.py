"""What an FMU says of itself: signals and parameters by `modelDescription.xml`."""

from __future__ import annotations

import math
import os
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from greybox.base import DataError, ModelError, nearest, to_identifiers, unit_converter
from greybox.base.errors import is_own_bug
from greybox.data.notation import COUNT, read_notation

REAL = ("Real", "Float64", "Float32")


@dataclass(frozen=True)
class FmuVariable:
    """One variable of an FMU: its ``name`` there, the ``label`` that a record or an option gives it, and what is known of it."""

    name: str
    label: str
    unit: str
    description: str = ""
    start: float = 0.0
    bounds: tuple[float, float] = (-math.inf, math.inf)
    is_initial: bool = False
    """Whether it is the start of a state and no constant."""


@dataclass(frozen=True, eq=False)
class FmuDescription:
    """What `modelDescription.xml` says.

    Attributes
    ----------
    path
        The file.
    title
        Name of the model.
    fmi_version
        ``2.0`` or ``3.0``.
    kind
        ``CoSimulation`` or ``ModelExchange``: how it is run.
    inputs, outputs, parameters
        Real variables; parameters are those that can be set before a run.
    undriven
        Inputs of other types, and arrays: no record drives them, and they stay at their start.
    """

    path: Path
    title: str
    fmi_version: str
    kind: str
    inputs: tuple[FmuVariable, ...]
    outputs: tuple[FmuVariable, ...]
    parameters: tuple[FmuVariable, ...]
    undriven: tuple[str, ...] = ()


# Bytes that an FMU unpacks to at most.
LARGEST_UNPACKED = 1000000000


def read_description(path: str | os.PathLike[str], outputs: Sequence[str] | None = None) -> FmuDescription:
    """The description of an FMU of FMI 2 or 3, with its outputs or the variables named. Raises as `read_fmu`."""
    file = Path(path)
    try:
        from fmpy import read_model_description
    except ModuleNotFoundError as error:
        raise DataError(
            f"{file.name}: an FMU needs the package fmpy; install it with: pip install 'greybox-sysid[fmu]'"
        ) from error
    if not file.is_file():
        raise DataError(f"{file}: file not found")
    try:
        with zipfile.ZipFile(file) as archive:
            size = sum(member.file_size for member in archive.infolist())
        if size > LARGEST_UNPACKED:
            raise DataError(
                f"{file.name}: unpacks to {size / 1e6:.0f} MB, at most {LARGEST_UNPACKED / 1e6:.0f} MB are read"
            )
        description = read_model_description(str(file), validate=False)
    # Of zipfile, the XML parser or fmpy, which raises Exception itself, on bytes that they did not expect.
    except Exception as error:
        if isinstance(error, DataError) or is_own_bug(error):
            raise
        raise DataError(
            f"{file.name}: not a readable FMU ({str(error)[:120] or type(error).__name__}); export it again"
        ) from error
    if not str(description.fmiVersion).startswith(("2.", "3.")):
        raise DataError(f"{file.name}: FMI {description.fmiVersion}; FMUs of FMI 2 and 3 are run")
    if description.coSimulation is None and description.modelExchange is None:
        raise DataError(f"{file.name}: neither for co-simulation nor for model exchange; export it as one of them")
    # Arrays and other types are no signals of a record.
    scalars = [v for v in description.modelVariables if v.type in REAL and not v.dimensions]
    measured = {v.name for v in scalars if v.causality == "output"} if outputs is None else set(outputs)
    by_name = {v.name: v for v in scalars}
    for name in measured:
        if name not in by_name:
            raise ModelError(f"{file.name}: no real variable {name!r}; {nearest(name, list(by_name))}")
    if not measured:
        raise ModelError(f"{file.name}: it has no output; name a variable that is measured (outputs=[...])")
    # What can be set before a run: parameters, and exact starts of states.
    settable = [
        v
        for v in scalars
        if (v.causality in ("parameter", "structuralParameter") and v.variability in (None, "fixed", "tunable"))
        or (v.causality in (None, "local") and v.initial == "exact" and v.variability == "continuous")
    ]
    groups = ([v for v in scalars if v.causality == "input"], [v for v in scalars if v.name in measured], settable)
    labels = iter(to_identifiers([v.name for group in groups for v in group]))
    inputs, chosen, parameters = (tuple(_to_variable(v, next(labels)) for v in group) for group in groups)
    # With its own solver, where it brings one.
    kind = "CoSimulation" if description.coSimulation is not None else "ModelExchange"
    undriven = tuple(v.name for v in description.modelVariables if v.causality == "input" and v not in scalars)
    version = str(description.fmiVersion)
    return FmuDescription(file, description.modelName, version, kind, inputs, chosen, parameters, undriven)


# Bounds of a variable beyond it are none: tools write the largest number there.
FMU_FIT_ENDLESS = 1e300


def _to_variable(variable: Any, label: str) -> FmuVariable:
    def number(text: Any, otherwise: float) -> float:
        try:
            value = float(text)
        except (TypeError, ValueError):
            return otherwise
        return value if abs(value) < FMU_FIT_ENDLESS else otherwise

    declared = getattr(variable, "declaredType", None)

    def state(name: str) -> Any:
        """What the variable states, else its type."""
        of_variable = getattr(variable, name, None)
        return getattr(declared, name, None) if of_variable is None else of_variable

    try:
        # Modelica writes N.m and kg.m2.
        unit = read_notation(str(state("unit") or "1"))
        unit_converter(unit, unit)
    except ModelError:  # of a unit that none converts, records are read as plain numbers
        unit = "1"
    unit = "1" if unit == COUNT else unit
    bounds = (number(state("min"), -math.inf), number(state("max"), math.inf))
    is_initial = variable.causality in (None, "local")
    # A start that is not stated counts as zero.
    start, text = number(variable.start, 0.0), variable.description or ""
    return FmuVariable(variable.name, label, unit, text, start, bounds, is_initial)
