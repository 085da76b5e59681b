"""Runs of an FMU beside records, by fmpy: one instance that is reset from run to run, and made anew after one that fails."""

from __future__ import annotations

import contextlib
import io
import os
import shutil
import sys
import tempfile
import warnings
from collections.abc import Iterator, Mapping, Sequence
from ctypes import c_double
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from xml.etree import ElementTree

import numpy as np

from greybox.base.errors import DataError, OutputError, is_own_bug, shorten
from greybox.data.experiment import Experiment
from greybox.extensions.fmu.description import FmuDescription, FmuVariable
from greybox.simulation.plant import PlantRunError


@contextlib.contextmanager
def _silence() -> Iterator[list[BaseException]]:
    """Nothing that an FMU or its solver prints is shown: a failure says it once. Gives the errors that were lost in calls from C."""
    lost: list[BaseException] = []

    def keep(event: Any) -> None:
        lost.append(event.exc_value or FmuRunError(str(event)))

    hook, sys.unraisablehook = sys.unraisablehook, keep
    saved = {}
    nowhere = os.open(os.devnull, os.O_RDWR)
    try:
        for number in (1, 2):
            with contextlib.suppress(OSError):
                saved[number] = os.dup(number)
                os.dup2(nowhere, number)
        with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")
            yield lost
    finally:
        sys.unraisablehook = hook
        for number, copy in saved.items():
            os.dup2(copy, number)
            os.close(copy)
        os.close(nowhere)


class FmuRunError(PlantRunError):
    """A run of an FMU that failed."""


# Deviation of such a run from the one by the solver, over the movement of the output, up to which its slopes are used.
SENSITIVITY_ERROR = 0.0001
# Relative tolerance asked of the FMU's solver.
RELATIVE_TOLERANCE = 1e-08


def _find_straight(record: Experiment, plant: FmuDescription) -> np.ndarray:
    """Which inputs (nu,) move between rows; a band-limited one is taken as straight."""
    return np.array([record.courses[i.label] != "zero" for i in plant.inputs], bool)


# Steps of a co-simulation in each row where an input is straight between rows: what a staircase through the middles leaves of a straight
# line is a hundredth of what the held input would.
STEPS_OF_STRAIGHT = 10


class FmuSimulator:
    """Runs an FMU; a context manager, which unpacks it and removes it again.

    Parameters
    ----------
    plant
        The FMU.
    """

    def __init__(self, plant: FmuDescription) -> None:
        self.plant = plant
        self.runs = self.failures = self.rows = 0
        self._folder: str | None = None
        self._description: Any = None
        self._instance: Any = None
        self._may_differentiate: bool | None = None

    def __enter__(self) -> Self:
        from fmpy import extract, read_model_description

        self._folder = tempfile.mkdtemp(prefix="greybox-fmu-")
        try:
            extract(str(self.plant.path), unzipdir=self._folder)
            self._description = read_model_description(self._folder, validate=False)
        # Only fmpy runs here, which raises Exception itself. An interrupt goes on when the folder is removed.
        except BaseException as error:
            self._discard()
            shutil.rmtree(self._folder, ignore_errors=True)
            if not isinstance(error, Exception):
                raise
            if isinstance(error, OSError):  # a disk that is full
                raise OutputError(error.errno, error.strerror or str(error), self._folder) from error
            reason = shorten(str(error) or type(error).__name__)
            raise FmuRunError(f"{self.plant.path.name}: cannot be unpacked ({reason}); export it again") from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Free the instance, and remove what was unpacked."""
        self._discard()
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)
            self._folder = None

    def run(self, experiment: Experiment, values: Mapping[str, float]) -> dict[str, np.ndarray]:
        """Outputs over a record.

        Parameters
        ----------
        experiment
            Its inputs drive the FMU.
        values
            Variable of the FMU -> value before the run.

        Returns
        -------
        dict
            Label of the output -> values (N,) at the times of the record.

        Raises
        ------
        FmuRunError
            Where the FMU reports an error, or an output is not finite.
        """
        time = experiment.time - experiment.time[0]
        # The FMU may take equal steps alone.
        exchange, description = self.plant.kind == "ModelExchange", self._description.coSimulation
        if not (experiment.regular or exchange or description.canHandleVariableCommunicationStepSize):
            raise DataError(
                f"experiment {experiment.name!r} is sampled at irregular times, and {self.plant.path.name} takes equal steps only"
                " (co-simulation without canHandleVariableCommunicationStepSize): resample the record, or export the FMU for model exchange"
            )
        self.runs += 1
        self.rows += experiment.rows
        try:
            result = self._simulate(experiment, time, values)
        # Of the FMU, its solver or fmpy, which raises Exception itself: whatever it is, the run is lost. A bug of ours ends all.
        except Exception as error:
            if is_own_bug(error):
                raise
            self.failures += 1
            self._discard()
            raise FmuRunError(
                f"{self.plant.path.name}: the run failed ({str(error)[:120] or type(error).__name__})"
            ) from error
        outputs = {}
        for o in self.plant.outputs:
            # The solver's own grid has rounding in its times; at the times of the record there is one value each, that after an event.
            _, last = np.unique(result["time"][::-1], return_index=True)
            kept = len(result["time"]) - 1 - last
            values_at = np.interp(time, result["time"][kept], np.asarray(result[o.name], dtype=float)[kept])
            if not np.isfinite(values_at).all() or result["time"][-1] < time[-1] - experiment.intervals[-1]:
                self.failures += 1
                raise FmuRunError(f"{self.plant.path.name}: output {o.name!r} is not finite to the end of the record")
            outputs[o.label] = values_at
        return outputs

    def _tabulate(self, experiment: Experiment, time: np.ndarray, parts: int) -> np.ndarray:
        """Rows ``time, inputs``, so many in each interval, for the input of fmpy, which is straight between rows of different times."""
        exchange, straight = self.plant.kind == "ModelExchange", _find_straight(experiment, self.plant)
        lengths = np.append(np.diff(time), 0.0)[:, None] / parts
        at = (time[:, None] + lengths * np.arange(parts)).ravel()[: (len(time) - 1) * parts + 1]
        columns = [at]
        for i, moves in zip(self.plant.inputs, straight, strict=True):
            u = experiment.inputs[i.label]
            # In co-simulation an input is held over a step: its value in the middle does what a straight line does, to the second order.
            middle = at if exchange else at + np.repeat(lengths, parts)[: len(at)] / 2
            columns.append(np.interp(middle, time, u) if moves else np.repeat(u, parts)[: len(at)])
        rows = np.column_stack(columns)
        if experiment.regular and (straight.all() or not exchange):
            return rows
        # The held value again at the end of its interval: two rows of one time are a step, and a point at which the solver stops.
        stepped = np.empty((2 * len(rows) - 1, rows.shape[1]))
        stepped[::2], stepped[1::2] = rows, rows[:-1]
        moving = np.append(True, straight & exchange)
        stepped[1::2, moving] = rows[1:, moving]
        return stepped

    def _simulate(self, experiment: Experiment, time: np.ndarray, values: Mapping[str, float]) -> Any:
        import fmpy

        table, straight = None, _find_straight(experiment, self.plant)
        parts = 1 if self.plant.kind == "ModelExchange" or not straight.any() else STEPS_OF_STRAIGHT
        step = (experiment.sampling_time or float(np.median(np.diff(time)))) / parts
        if self.plant.inputs:
            rows = self._tabulate(experiment, time, parts)
            names = [("time", float), *((i.name, float) for i in self.plant.inputs)]
            table = np.array([tuple(row) for row in rows], dtype=names)
            if not experiment.regular:
                # The rows of the table are where it stops, and nothing between.
                step = float(time[-1])
        elif not experiment.regular:
            step /= STEPS_OF_STRAIGHT
        with _silence() as lost:
            if self._instance is None:
                self._instance = fmpy.instantiate_fmu(self._folder, self._description, self.plant.kind)
            else:
                self._instance.reset()
                # The instance is used again: what followed the inputs of the last record must not see this one.
                vars(self._instance).pop("setTime", None)
            if self.plant.kind == "ModelExchange" and straight.any():
                self._follow_inputs(experiment, time)
            result = fmpy.simulate_fmu(
                self._folder,
                validate=False,
                start_time=0.0,
                stop_time=float(time[-1]),
                output_interval=step,
                step_size=step,
                # Far below the difference of a slope, which would measure the solver otherwise.
                relative_tolerance=RELATIVE_TOLERANCE,
                record_events=not experiment.regular,
                fmi_type=self.plant.kind,
                start_values=dict(values),
                input=table,
                output=[o.name for o in self.plant.outputs],
                model_description=self._description,
                fmu_instance=self._instance,
                fmi_call_logger=None,
            )
        if lost:
            raise lost[0]
        return result

    @property
    def has_derivatives(self) -> bool:
        """Whether the FMU has directional derivatives that can be used, and they have not failed so far.

        They can be for model exchange, with nothing that switches, in several instances.
        """
        if self._may_differentiate is None:
            assert self._folder is not None  # asked inside the context alone
            description, exchange = self._description, self._description.modelExchange
            is_usable = (
                self.plant.kind == "ModelExchange"
                and exchange is not None
                and not exchange.canBeInstantiatedOnlyOncePerProcess
                and description.numberOfContinuousStates
                and not description.numberOfEventIndicators
            )
            # fmpy does not read the attribute of FMI 3, which is a plural.
            root = ElementTree.parse(Path(self._folder) / "modelDescription.xml").getroot()
            element = root.find("ModelExchange")
            names = ("providesDirectionalDerivative", "providesDirectionalDerivatives")
            is_said = element is not None and any(element.get(name) in ("true", "1") for name in names)
            self._may_differentiate = bool(is_usable and is_said)
        return self._may_differentiate

    def differentiate(
        self,
        experiment: Experiment,
        values: Mapping[str, float],
        unknowns: Sequence[FmuVariable],
        widths: np.ndarray,
        outputs: Mapping[str, np.ndarray],
    ) -> np.ndarray | None:
        """Slopes (N, ny, n) of the outputs over a record, by the FMU's directional derivatives.

        Parameters
        ----------
        experiment
            Its inputs drive the FMU.
        values
            Variable of the FMU -> value before the run.
        unknowns
            With respect to what.
        widths
            Steps (n,) of differences, for what has no directional derivative.
        outputs
            The run over the record, which the one with slopes must agree with.

        Returns
        -------
        array or None
            None where the FMU has none, they fail, or that run does not agree; then they are not asked for again.
        """
        if not self.has_derivatives or self._folder is None:
            return None
        self.runs += 1
        self.rows += experiment.rows * (1 + len(unknowns))
        try:
            runner = SensitivityRunner(self._folder, self._description, self.plant)
            with _silence() as lost, contextlib.closing(runner):
                run, slopes = runner.run(experiment, values, unknowns, widths)
            if lost:
                raise lost[0]
        # Of the FMU or fmpy, which raises Exception itself: differences take their place. A bug of ours ends all.
        except Exception as raised:
            if is_own_bug(raised):
                raise
            self._may_differentiate = False
            return None
        expected = np.column_stack([outputs[o.label] for o in self.plant.outputs])
        # The run with slopes is integrated here, the other one by fmpy: where they part, something switches that was
        # not declared.
        error = np.abs(run - expected).max(axis=0)
        if not (np.isfinite(slopes).all() and np.all(error <= SENSITIVITY_ERROR * np.ptp(expected, axis=0))):
            self._may_differentiate = False
            return None
        return slopes

    def _follow_inputs(self, experiment: Experiment, time: np.ndarray) -> None:
        """Set the straight inputs wherever the solver asks for rates: by itself fmpy holds them over each of its steps."""
        instance, kind = self._instance, type(self._instance)
        known = {v.name: v.valueReference for v in self._description.modelVariables}
        moving = [
            i for i, moves in zip(self.plant.inputs, _find_straight(experiment, self.plant), strict=True) if moves
        ]
        references = [known[i.name] for i in moving]
        columns = [experiment.inputs[i.label] for i in moving]

        def set_time(at: float) -> Any:
            result = kind.setTime(instance, at)
            _set(instance, references, [float(np.interp(at, time, column)) for column in columns])
            return result

        instance.setTime = set_time

    def _discard(self) -> None:
        if self._instance is not None:
            # Only the FMU and fmpy run here: an instance whose run failed may fail again when it is freed.
            with contextlib.suppress(Exception), _silence():
                self._instance.freeInstance()
            self._instance = None


# Slopes of an FMU's outputs with respect to its parameters from its own directional derivatives.
#
# For model exchange alone: the states are integrated together with their sensitivities, ``S' = (df/dx) S + df/dp``. What the FMU has no
# directional derivative for (most have none with respect to parameters) is a difference of rates between two instances at the same state,
# which no solver scatters.

# Runge-Kutta steps between two rows of a run with sensitivities.
SENSITIVITY_STEPS = 4


class SensitivityRunner:
    """Runs an FMU with its sensitivities; `close` frees its instances.

    Parameters
    ----------
    folder
        The unpacked FMU.
    description
        As fmpy reads it.
    plant
        The FMU.
    """

    def __init__(self, folder: str, description: Any, plant: FmuDescription) -> None:
        self.folder, self.description, self.plant = folder, description, plant
        by_name = {v.name: v for v in description.modelVariables}
        # Of each rate the state that it belongs to, as itself or as its number in the list.
        derived = [d.variable.derivative for d in description.derivatives]
        states = [description.modelVariables[s - 1] if isinstance(s, int) else s for s in derived]
        self.states = [int(s.valueReference) for s in states]
        self.rates = [d.variable.valueReference for d in description.derivatives]
        self.inputs = [by_name[i.name].valueReference for i in plant.inputs]
        self.outputs = [by_name[o.name].valueReference for o in plant.outputs]
        # The instance at the values of the run, and one for each unknown, moved by its width.
        self.base: Any = None
        self.moved: list[tuple[Any, float]] = []
        self._instances: list[Any] = []

    def close(self) -> None:
        """Free every instance."""
        for instance in self._instances:
            # Only the FMU and fmpy run here: an instance whose run failed may fail again when it is freed.
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
        self.base = self._start(settings)
        self.moved = [
            (self._start({**settings, v.name: settings[v.name] + w}), w) for v, w in zip(unknowns, widths, strict=True)
        ]
        time = record.time - record.time[0]
        u = np.column_stack([record.inputs[i.label] for i in self.plant.inputs] or [np.empty((record.rows, 0))])
        straight = _find_straight(record, self.plant)
        x = self._read(self.base, "getContinuousStates")
        # S(0) = dx(0)/dp: an instance that begins with the parameter moved shows it.
        S = np.column_stack([(self._read(m, "getContinuousStates") - x) / w for m, w in self.moved])
        outputs, slopes = [], []
        for k in range(record.rows):
            self._place(time[k], x, u[k])
            y = _get(self.base, self.outputs)
            outputs.append(y)
            # dy/dp = (dg/dx) S + dg/dp, the latter at the same state
            along = [
                self._along_states(self.outputs, S[:, j]) + (_get(m, self.outputs) - y) / w
                for j, (m, w) in enumerate(self.moved)
            ]
            slopes.append(np.column_stack(along))
            if k + 1 == record.rows:
                break
            h, rise = (time[k + 1] - time[k]) / SENSITIVITY_STEPS, np.where(straight, u[k + 1] - u[k], 0.0)
            for j in range(SENSITIVITY_STEPS):
                # The inputs at the beginning, the middle and the end of the step: held, or linear between the rows.
                shares = [(j + c) / SENSITIVITY_STEPS for c in (0, 0.5, 1)]
                x, S = self._step(time[k] + h * j, h, x, S, [u[k] + rise * share for share in shares])
        return np.array(outputs), np.array(slopes)

    def _step(
        self, t: float, h: float, x: np.ndarray, S: np.ndarray, u: Sequence[np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        """One step of the classical Runge-Kutta method for states and sensitivities."""

        def rates(at: float, state: np.ndarray, along: np.ndarray, drive: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            self._place(at, state, drive)
            # FMI 2 names it so, FMI 3 the other way.
            name = "getDerivatives" if hasattr(self.base, "getDerivatives") else "getContinuousStateDerivatives"
            f = self._read(self.base, name)
            columns = [self._along_states(self.rates, along[:, j]) for j in range(len(self.moved))]
            # df/dp at the same state: no solver lies between the two rates, so that the difference may be small.
            by_parameter = [(self._read(m, name) - f) / w for m, w in self.moved]
            # S' = (df/dx) S + df/dp
            return f, np.column_stack(columns) + np.column_stack(by_parameter)

        f1, s1 = rates(t, x, S, u[0])
        f2, s2 = rates(t + h / 2, x + h / 2 * f1, S + h / 2 * s1, u[1])
        f3, s3 = rates(t + h / 2, x + h / 2 * f2, S + h / 2 * s2, u[1])
        f4, s4 = rates(t + h, x + h * f3, S + h * s3, u[2])
        return x + h / 6 * (f1 + 2 * f2 + 2 * f3 + f4), S + h / 6 * (s1 + 2 * s2 + 2 * s3 + s4)

    def _along_states(self, unknowns: Sequence[int], seed: np.ndarray) -> np.ndarray:
        """Directional derivative of ``unknowns`` along the states."""
        if not seed.any():
            return np.zeros(len(unknowns))
        return np.array(self.base.getDirectionalDerivative(list(unknowns), self.states, seed.tolist()))

    def _place(self, t: float, x: np.ndarray, u: np.ndarray) -> None:
        """Bring every instance to this time and state, with these inputs."""
        for instance in (self.base, *(m for m, _ in self.moved)):
            instance.setTime(float(t))
            instance.setContinuousStates((c_double * len(x))(*x), len(x))
            if self.inputs:
                _set(instance, self.inputs, u.tolist())

    def _read(self, instance: Any, name: str) -> np.ndarray:
        """States or rates by the function of this name."""
        values = (c_double * len(self.states))()
        getattr(instance, name)(values, len(self.states))
        return np.array(values)

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


# FMI 2 names these functions so, FMI 3 by the type.


def _get(instance: Any, references: Sequence[int]) -> np.ndarray:
    read = instance.getReal if hasattr(instance, "getReal") else instance.getFloat64
    return np.array(list(read(references)))


def _set(instance: Any, references: Sequence[int], values: Sequence[float]) -> None:
    write = instance.setReal if hasattr(instance, "setReal") else instance.setFloat64
    write(references, values)
