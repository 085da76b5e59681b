"""What an FMU says of itself: signals and parameters by `modelDescription.xml`, and a model without equations to read records by."""

from __future__ import annotations

import math
import os
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from greybox.base.errors import DataError, ModelError, nearest
from greybox.base.texts import to_identifiers
from greybox.base.units import unit_converter
from greybox.base.values import Printable
from greybox.model.balance import Balance
from greybox.model.model import Model
from greybox.model.signals import Input, Output, Parameter, State

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


# Most parameters that are fitted unless they are named: each costs a run an iteration.
MOST_FREE = 12


@dataclass(frozen=True, eq=False)
class FmuPlant(Printable):
    """An FMU as a plant.

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
    """

    path: Path
    title: str
    fmi_version: str
    kind: str
    inputs: tuple[FmuVariable, ...]
    outputs: tuple[FmuVariable, ...]
    parameters: tuple[FmuVariable, ...]

    @property
    def file_name(self) -> str:
        """Name of the file, without its folder."""
        return self.path.name

    def choose(self, names: Sequence[str]) -> tuple[FmuVariable, ...]:
        """The parameters of these names or labels; all constants for none. Raises ModelError for unknown names, and for too many."""
        if not names:
            constants = tuple(v for v in self.parameters if not v.is_initial)
            if len(constants) > MOST_FREE:
                raise ModelError(
                    f"{self.title} has {len(constants)} parameters, and each costs a run in every step; name those to fit"
                    " (free=[...], shell: --free NAME)"
                )
            return constants
        return tuple(self.find(name) for name in names)

    def find(self, name: str) -> FmuVariable:
        """The parameter of this name or label. Raises ModelError."""
        for variable in self.parameters:
            if name in (variable.name, variable.label):
                return variable
        raise ModelError(f"{self.title} has no parameter {name!r}; {nearest(name, [v.label for v in self.parameters])}")

    @cached_property
    def record_model(self) -> Model:
        """A model with the same signals and no equations, by which records are read."""
        states = [State(o.label, o.unit) for o in self.outputs]

        def balances(x: Any, u: Any, p: Any) -> list[Balance]:
            return [Balance(s.name, s.unit, p[f"{s.name}__time"], s.name, back=-x[s.name]) for s in states]

        return Model(
            to_identifiers([self.title])[0],
            states=states,
            inputs=[Input(i.label, i.unit) for i in self.inputs],
            outputs=[Output(o.label, o.unit) for o in self.outputs],
            parameters=[Parameter(f"{o.label}__time", "s", 1.0, fixed=True) for o in self.outputs],
            balances=balances,
        )


# Bytes that an FMU unpacks to at most.
LARGEST_UNPACKED = 1000000000


def read_fmu(path: str | os.PathLike[str], *, outputs: Sequence[str] | None = None) -> FmuPlant:
    """Read the description of an FMU of FMI 2 or 3, for co-simulation or model exchange.

    Parameters
    ----------
    path
        The file.
    outputs
        Variables that are measured; None takes the FMU's outputs. Others may be named.

    Returns
    -------
    FmuPlant
        Its signals and parameters. Nothing of the FMU is run yet.

    Raises
    ------
    DataError
        For a file that is no FMU of these versions, or too large.
    ModelError
        Where it has no output, or not those named.
    """
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
    except DataError:
        raise
    except Exception as error:  # of the library, on bytes that it did not expect
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
    return FmuPlant(file, description.modelName, str(description.fmiVersion), kind, inputs, chosen, parameters)


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
    unit = variable.unit or getattr(declared, "unit", None) or "1"
    try:
        unit_converter(str(unit), str(unit))
    except ModelError:  # of a unit that none converts, records are read as plain numbers
        unit = "1"
    bounds = (number(variable.min, -math.inf), number(variable.max, math.inf))
    is_initial = variable.causality in (None, "local")
    # A start that is not stated counts as zero.
    start, text = number(variable.start, 0.0), variable.description or ""
    return FmuVariable(variable.name, label, str(unit), text, start, bounds, is_initial)
