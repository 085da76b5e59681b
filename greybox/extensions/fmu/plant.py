"""An FMU as a plant: `greybox.fit`, `validate`, `multistart`, `compare` and profiles take it as they take a model."""

from __future__ import annotations

import hashlib
import os
import weakref
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from greybox.base import ModelError, Printable, nearest, to_identifiers
from greybox.data.experiment import Experiment
from greybox.extensions.fmu.description import FmuDescription, read_description
from greybox.extensions.fmu.simulator import FmuSimulator
from greybox.model import Input, Model, Output, Parameter
from greybox.simulation.plant import LinearResponse, PlantModel
from greybox.simulation.plant_kernel import PLANT_DIFFERENCE, PlantKernel

# Most constants that are fitted unless they are named: each costs a run in every step.
MOST_FREE = 12


@dataclass(frozen=True, eq=False)
class FmuPlant(Printable):
    """An FMU as a plant (`greybox.simulation.plant.Plant`).

    Each record starts as the FMU starts: an initial state that it lets set is a constant like others, fixed until it is freed. It is
    unpacked when it is first run, and removed with this value.

    Attributes
    ----------
    fmu
        What the FMU says of itself.
    """

    fmu: FmuDescription

    is_native: ClassVar[bool] = True
    """Its code is compiled, and may end the process that runs it."""

    def __reduce__(self) -> tuple[Any, ...]:
        """Its description: another process unpacks the FMU by itself."""
        return type(self), (self.fmu,)

    @property
    def name(self) -> str:
        """Name of the model as an identifier."""
        return to_identifiers([self.fmu.title])[0]

    @property
    def description(self) -> str:
        """What it is, for people."""
        text = f"{self.fmu.path.name}, FMI {self.fmu.fmi_version} for {self.fmu.kind}"
        undriven = ", ".join(self.fmu.undriven)
        return f"{text}; inputs that are no real numbers stay at their start: {undriven}" if undriven else text

    @cached_property
    def identity(self) -> str:
        """Hash of the file."""
        return hashlib.sha256(self.fmu.path.read_bytes()).hexdigest()[:32]

    @property
    def inputs(self) -> tuple[Input, ...]:
        """Its inputs, by the names that a record gives them."""
        return tuple(Input(v.label, v.unit, description=v.description) for v in self.fmu.inputs)

    @property
    def outputs(self) -> tuple[Output, ...]:
        """Its outputs."""
        return tuple(Output(v.label, v.unit, description=v.description) for v in self.fmu.outputs)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """What can be set before a run; initial states are fixed, and so is everything where it is too much."""
        is_crowded, stated = sum(not v.is_initial for v in self.fmu.parameters) > MOST_FREE, []
        for v in self.fmu.parameters:
            # A start outside of its own bounds is the FMU's mistake, and what it runs with.
            low, high = min(v.bounds[0], v.start), max(v.bounds[1], v.start)
            bounds = (low, high) if low < high else (-np.inf, np.inf)
            fixed, source = v.is_initial or is_crowded, self.fmu.path.name
            stated.append(Parameter(v.label, v.unit, v.start, bounds, fixed, source, description=v.description))
        return tuple(stated)

    @cached_property
    def model(self) -> PlantModel:
        """The model that states its signals and constants."""
        return PlantModel.of(self)

    def find(self, name: str) -> str:
        """The name in records and options of a parameter, by that or by the FMU's own name. Raises ModelError."""
        for variable in self.fmu.parameters:
            if name in (variable.name, variable.label):
                return variable.label
        labels = [v.label for v in self.fmu.parameters]
        raise ModelError(f"{self.fmu.title} has no parameter {name!r}; {nearest(name, labels)}")

    def with_values(
        self,
        free: Sequence[str] = (),
        start: Mapping[str, float] | None = None,
        fixed: Mapping[str, float] | None = None,
    ) -> PlantModel:
        """The model with parameters chosen by either of their names.

        Parameters
        ----------
        free
            The parameters to fit; none: all constants, if they are few.
        start
            Start values; the others are those of the FMU.
        fixed
            Further values that are set and not fitted.

        Raises
        ------
        ModelError
            For unknown names, and where too many would be fitted.
        """
        model: Model = self.model
        if free:
            model = model.fix(*model.values).free(*map(self.find, free))
        model = model.start(**{self.find(n): float(v) for n, v in (start or {}).items()})
        model = model.fix(**{self.find(n): float(v) for n, v in (fixed or {}).items()})
        if not model.parameters:
            raise ModelError(f"{self.fmu.title} has no parameter to fit")
        if not model.free_parameters:
            raise ModelError(
                f"{self.fmu.title} has {len(model.parameters)} parameters, and each costs a run in every step; name those to fit"
                " (free=[...], shell: --free NAME)"
            )
        assert isinstance(model, PlantModel)
        return model

    @cached_property
    def simulator(self) -> FmuSimulator:
        """What runs it, unpacked. Raises FmuRunError and OutputError."""
        simulator = FmuSimulator(self.fmu).__enter__()
        weakref.finalize(self, simulator.close)
        return simulator

    def simulate(self, record: Experiment, values: Mapping[str, float]) -> dict[str, np.ndarray]:
        """Outputs (N,) by name over a record. Raises FmuRunError."""
        return self.simulator.run(record, self._settings(values))

    def differentiate(
        self, record: Experiment, values: Mapping[str, float], names: Sequence[str], outputs: Mapping[str, np.ndarray]
    ) -> np.ndarray | None:
        """Slopes (N, ny, n) by the FMU's directional derivatives; None where it has none that can be used."""
        if not self.simulator.has_derivatives:
            return None
        known = {v.label: v for v in self.fmu.parameters}
        unknowns = [known[name] for name in names]
        sizes = [PLANT_DIFFERENCE * (max(abs(values[v.label]), abs(v.start)) or 1.0) for v in unknowns]
        # To the other side where the upper bound is near.
        above = [values[v.label] + size > v.bounds[1] for v, size in zip(unknowns, sizes, strict=True)]
        widths = np.where(above, -1.0, 1.0) * sizes
        # What is differentiated must be set, also where it is at the FMU's own value.
        settings = self._settings(values) | {v.name: values[v.label] for v in unknowns}
        return self.simulator.differentiate(record, settings, unknowns, widths, outputs)

    def linearise(self, record: Experiment, values: Mapping[str, float]) -> LinearResponse | None:
        """The answer to small changes of the inputs along a record, from two runs of the FMU; None where no linear system follows it."""
        # A second to import, and the process that runs the FMU would wait for it.
        from greybox.comparison.input_response import estimate_linear_response

        model = self.model.start(**values)
        assert isinstance(model, PlantModel)
        return estimate_linear_response(PlantKernel(model), record)

    def _settings(self, values: Mapping[str, float]) -> dict[str, float]:
        """Variable of the FMU -> value, of those that are not at its own: a start that is not stated is not known."""
        return {v.name: values[v.label] for v in self.fmu.parameters if values[v.label] != v.start}


def read_fmu(path: str | os.PathLike[str], *, outputs: Sequence[str] | None = None) -> FmuPlant:
    """Read an FMU of FMI 2 or 3, for co-simulation or model exchange.

    Parameters
    ----------
    path
        The file.
    outputs
        Variables that are measured; None takes the FMU's outputs. Others may be named.

    Returns
    -------
    FmuPlant
        A plant for `greybox.fit` and the other verbs. Nothing of the FMU is run yet.

    Raises
    ------
    DataError
        For a file that is no FMU of these versions, or too large.
    ModelError
        Where it has no output, or not those named.

    Examples
    --------
    >>> plant = read_fmu("pump.fmu")  # doctest: +SKIP
    >>> fit(plant.model.free("gain").start(gain=2.0), record)  # doctest: +SKIP
    """
    return FmuPlant(read_description(path, outputs))
