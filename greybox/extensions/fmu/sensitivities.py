"""Slopes of an FMU's outputs with respect to its parameters from its own directional derivatives.

For model exchange alone: the states are integrated together with their sensitivities, ``S' = (df/dx) S + df/dp``. What the FMU has no
directional derivative for (most have none with respect to parameters) is a difference of rates between two instances at the same state,
which no solver scatters.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from xml.etree import ElementTree

import numpy as np

from greybox.data.experiment import Experiment
from greybox.extensions.fmu.description import FmuPlant, FmuVariable
from greybox.extensions.fmu.policy import FmuFitPolicy


def has_directional_derivatives(folder: str, description: Any, kind: str) -> bool:
    """Whether an FMU says that it has them where they can be used: for model exchange, with nothing that switches, in several instances."""
    exchange = description.modelExchange
    if kind != "ModelExchange" or exchange is None or exchange.canBeInstantiatedOnlyOncePerProcess:
        return False
    if description.numberOfEventIndicators or not description.numberOfContinuousStates:
        return False
    # fmpy does not read the attribute of FMI 3, which is a plural.
    root = ElementTree.parse(Path(folder) / "modelDescription.xml").getroot()
    element = root.find("ModelExchange")
    names = ("providesDirectionalDerivative", "providesDirectionalDerivatives")
    return element is not None and any(element.get(name) in ("true", "1") for name in names)


# Runge-Kutta steps between two rows of a run with sensitivities.
SENSITIVITY_STEPS = 4


class SensitivityRunner:
    """Runs an FMU with its sensitivities; a context manager that frees its instances.

    Parameters
    ----------
    folder
        The unpacked FMU.
    description
        As fmpy reads it.
    plant
        The FMU.
    policy
        How fine it is integrated.
    """

    def __init__(self, folder: str, description: Any, plant: FmuPlant, policy: FmuFitPolicy) -> None:
        self.folder, self.description, self.plant, self.policy = folder, description, plant, policy
        by_name = {v.name: v for v in description.modelVariables}
        self.rates = [d.variable.valueReference for d in description.derivatives]
        # Of each rate the state that it belongs to, as itself or as its number in the list.
        derived = [d.variable.derivative for d in description.derivatives]
        states = [description.modelVariables[s - 1] if isinstance(s, int) else s for s in derived]
        self.states = [int(s.valueReference) for s in states]
        self.inputs = [by_name[i.name].valueReference for i in plant.inputs]
        self.outputs = [by_name[o.name].valueReference for o in plant.outputs]
        self.references = {v.name: v.valueReference for v in description.modelVariables}
        self._instances: list[Any] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for instance in self._instances:
            with contextlib.suppress(Exception):
                instance.terminate()
            with contextlib.suppress(Exception):
                instance.freeInstance()
        self._instances.clear()

    def run(
        self, record: Experiment, settings: Mapping[str, float], unknowns: Sequence[FmuVariable], widths: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Outputs (N, ny) over a record, and their slopes (N, ny, n) with respect to the unknowns in their units.

        Parameters
        ----------
        record
            Its inputs drive the FMU.
        settings
            Variable -> value before the run, the unknowns among them.
        unknowns
            Parameters and initial states.
        widths
            Steps (n,) of differences, for what has no directional derivative.

        Raises
        ------
        Exception
            What the FMU or the library raises.
        """
        base = self._start(settings)
        moved = [self._start({**settings, v.name: settings[v.name] + w}) for v, w in zip(unknowns, widths, strict=True)]
        time = record.time - record.time[0]
        u = np.column_stack([record.inputs[i.label] for i in self.plant.inputs] or [np.empty((record.rows, 0))])
        x = np.array(self._get_states(base))
        # S(0) = dx(0)/dp: an instance that begins with the parameter moved shows it.
        S = np.column_stack([(self._get_states(m) - x) / w for m, w in zip(moved, widths, strict=True)])
        held = record.hold == "zero"
        outputs, slopes = [], []
        for k in range(record.rows):
            self._place(base, moved, time[k], x, u[k])
            outputs.append(np.array(_get(base, self.outputs)))
            slopes.append(self._outputs_along(base, moved, widths, S))
            if k + 1 == record.rows:
                break
            h, parts = time[k + 1] - time[k], SENSITIVITY_STEPS
            for j in range(parts):
                at = time[k] + h * j / parts
                ends = (
                    [u[k], u[k], u[k]]
                    if held
                    else [u[k] + (u[k + 1] - u[k]) * (j + c) / parts for c in (0.0, 0.5, 1.0)]
                )
                x, S = self._step(base, moved, widths, at, h / parts, x, S, ends)
        return np.array(outputs), np.array(slopes)

    def _step(
        self,
        base: Any,
        moved: Sequence[Any],
        widths: np.ndarray,
        t: float,
        h: float,
        x: np.ndarray,
        S: np.ndarray,
        u: Sequence[np.ndarray],
    ) -> tuple[np.ndarray, np.ndarray]:
        """One step of the classical Runge-Kutta method for states and sensitivities."""

        def rates(at: float, state: np.ndarray, along: np.ndarray, drive: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            self._place(base, moved, at, state, drive)
            f = self._get_rates(base)
            columns = [self._along_states(base, self.rates, along[:, j]) for j in range(len(moved))]
            # df/dp at the same state: no solver lies between the two rates, so that the difference may be small.
            by_parameter = [(self._get_rates(m) - f) / w for m, w in zip(moved, widths, strict=True)]
            # S' = (df/dx) S + df/dp
            return f, np.column_stack(columns) + np.column_stack(by_parameter)

        f1, s1 = rates(t, x, S, u[0])
        f2, s2 = rates(t + h / 2, x + h / 2 * f1, S + h / 2 * s1, u[1])
        f3, s3 = rates(t + h / 2, x + h / 2 * f2, S + h / 2 * s2, u[1])
        f4, s4 = rates(t + h, x + h * f3, S + h * s3, u[2])
        return x + h / 6 * (f1 + 2 * f2 + 2 * f3 + f4), S + h / 6 * (s1 + 2 * s2 + 2 * s3 + s4)

    def _outputs_along(self, base: Any, moved: Sequence[Any], widths: np.ndarray, S: np.ndarray) -> np.ndarray:
        y = np.array(_get(base, self.outputs))
        columns = [
            self._along_states(base, self.outputs, S[:, j]) + (np.array(_get(m, self.outputs)) - y) / w
            for j, (m, w) in enumerate(zip(moved, widths, strict=True))
        ]
        return np.column_stack(columns)

    def _along_states(self, instance: Any, unknowns: Sequence[int], seed: np.ndarray) -> np.ndarray:
        if not seed.any():
            return np.zeros(len(unknowns))
        return np.array(instance.getDirectionalDerivative(list(unknowns), self.states, seed.tolist()))

    def _place(self, base: Any, moved: Sequence[Any], t: float, x: np.ndarray, u: np.ndarray) -> None:
        for instance in (base, *moved):
            instance.setTime(float(t))
            _set_states(instance, x)
            if self.inputs:
                # FMI 2 names it so, FMI 3 by the type.
                write = instance.setReal if hasattr(instance, "setReal") else instance.setFloat64
                write(self.inputs, u.tolist())

    def _get_states(self, instance: Any) -> np.ndarray:
        return _read_vector(instance, "getContinuousStates", len(self.states))

    def _get_rates(self, instance: Any) -> np.ndarray:
        name = "getDerivatives" if hasattr(instance, "getDerivatives") else "getContinuousStateDerivatives"
        return _read_vector(instance, name, len(self.states))

    def _start(self, settings: Mapping[str, float]) -> Any:
        """An instance in continuous-time mode with these values."""
        import fmpy
        from fmpy.simulation import apply_start_values, settable_in_initialization_mode, settable_in_instantiated

        instance = fmpy.instantiate_fmu(self.folder, self.description, "ModelExchange")
        self._instances.append(instance)
        is_second = self.description.fmiVersion.startswith("2")
        if is_second:
            instance.setupExperiment(startTime=0.0)
        left = apply_start_values(instance, self.description, dict(settings), settable=settable_in_instantiated)
        instance.enterInitializationMode()
        apply_start_values(instance, self.description, left, settable=settable_in_initialization_mode)
        instance.exitInitializationMode()
        again = True
        # Event iteration of FMI: until the FMU has settled its discrete states.
        while again:
            again = bool((instance.newDiscreteStates() if is_second else instance.updateDiscreteStates())[0])
        instance.enterContinuousTimeMode()
        return instance


def _get(instance: Any, references: Sequence[int]) -> list[float]:
    return list(instance.getReal(references) if hasattr(instance, "getReal") else instance.getFloat64(references))


def _read_vector(instance: Any, name: str, size: int) -> np.ndarray:
    from ctypes import c_double

    values = (c_double * size)()
    getattr(instance, name)(values, size)
    return np.array(values)


def _set_states(instance: Any, x: np.ndarray) -> None:
    from ctypes import c_double

    instance.setContinuousStates((c_double * len(x))(*x), len(x))
