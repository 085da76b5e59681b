"""Runs of an FMU beside records, by fmpy: one instance that is reset from run to run, and made anew after one that fails."""

from __future__ import annotations

import contextlib
import io
import os
import shutil
import sys
import tempfile
import warnings
from collections.abc import Iterator, Mapping
from types import TracebackType
from typing import Any, Self

import numpy as np

from greybox.errors import GreyboxError, OutputError, shorten
from greybox.experiment import Experiment
from greybox.fmu.description import FmuPlant
from greybox.fmu.policy import DEFAULT_FMU_FIT, FmuFitPolicy


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


class FmuRunError(GreyboxError):
    """A run of an FMU that failed."""


class FmuSimulator:
    """Runs an FMU; a context manager, which unpacks it and removes it again.

    Parameters
    ----------
    plant
        The FMU.
    policy
        How exactly it is solved.
    """

    def __init__(self, plant: FmuPlant, policy: FmuFitPolicy = DEFAULT_FMU_FIT) -> None:
        self.plant, self.policy = plant, policy
        self.runs = self.failures = self.rows = 0
        self._folder: str | None = None
        self._description: Any = None
        self._instance: Any = None

    def __enter__(self) -> Self:
        from fmpy import extract, read_model_description

        self._folder = tempfile.mkdtemp(prefix="greybox-fmu-")
        try:
            extract(str(self.plant.path), unzipdir=self._folder)
            self._description = read_model_description(self._folder, validate=False)
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
        import fmpy

        time = experiment.time - experiment.time[0]
        step = experiment.sampling_time or float(np.median(np.diff(time)))
        self.runs += 1
        self.rows += experiment.rows
        try:
            with _silence() as lost:
                if self._instance is None:
                    self._instance = fmpy.instantiate_fmu(self._folder, self._description, self.plant.kind)
                else:
                    self._instance.reset()
                result = fmpy.simulate_fmu(
                    self._folder,
                    validate=False,
                    start_time=0.0,
                    stop_time=float(time[-1]),
                    output_interval=step,
                    step_size=step,
                    relative_tolerance=self.policy.relative_tolerance,
                    record_events=False,
                    fmi_type=self.plant.kind,
                    start_values=dict(values),
                    input=self._write_inputs(experiment, time),
                    output=[o.name for o in self.plant.outputs],
                    model_description=self._description,
                    fmu_instance=self._instance,
                    fmi_call_logger=None,
                )
            if lost:
                raise lost[0]
        except Exception as error:  # of the FMU, its solver or the library: whatever it is, the run is lost
            self.failures += 1
            self._discard()
            raise FmuRunError(
                f"{self.plant.path.name}: the run failed ({str(error)[:120] or type(error).__name__})"
            ) from error
        outputs = {}
        for o in self.plant.outputs:
            values_at = np.interp(time, result["time"], np.asarray(result[o.name], dtype=float))
            if not np.isfinite(values_at).all() or result["time"][-1] < time[-1] - step:
                self.failures += 1
                raise FmuRunError(f"{self.plant.path.name}: output {o.name!r} is not finite to the end of the record")
            outputs[o.label] = values_at
        return outputs

    def _write_inputs(self, experiment: Experiment, time: np.ndarray) -> np.ndarray | None:
        if not self.plant.inputs:
            return None
        columns = [time, *(experiment.inputs[i.label] for i in self.plant.inputs)]
        table = np.column_stack(columns)
        if experiment.hold == "zero" and self.plant.kind == "ModelExchange":
            # The held value again at the end of its interval: two rows of one time are a step.
            held = np.empty((2 * len(table) - 1, table.shape[1]))
            held[::2], held[1::2] = table, table[:-1]
            held[1::2, 0] = time[1:]
            table = held
        names = [("time", float), *((i.name, float) for i in self.plant.inputs)]
        return np.array([tuple(row) for row in table], dtype=names)

    def _discard(self) -> None:
        if self._instance is not None:
            with contextlib.suppress(Exception), _silence():
                self._instance.freeInstance()
            self._instance = None
