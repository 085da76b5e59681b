"""Noise of each output from the most trustworthy source there is: given, quiet record, repetition, differences, residual."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from greybox.errors import DataError, ModelError, nearest
from greybox.experiment import Experiment
from greybox.experiment.problems import is_constant
from greybox.experiment.sampling import find_time_gaps
from greybox.model import Model
from greybox.noise.autoregression import AutoRegression, fit_autoregression, join_series
from greybox.noise.differences import estimate_noise_of_records, estimate_spread
from greybox.noise.policy import NOISE_POLICY, NoisePolicy
from greybox.noise.repeats import deviations_between_periods, deviations_between_repeats
from greybox.values import Printable

WHITE = AutoRegression()


class NoiseSource(StrEnum):
    """Where the noise of an output is known from, the most trustworthy first."""

    GIVEN = "given"
    QUIET_RECORD = "quiet_record"
    REPEATED_PERIODS = "repeated_periods"
    REPEATED_EXPERIMENTS = "repeated_experiments"
    DIFFERENCES = "differences"
    RESIDUAL = "residual"
    INNOVATIONS = "innovations"

    @classmethod
    def _missing_(cls, value: object) -> NoiseSource | None:
        """The source that an older file names by a phrase."""
        phrases = {
            "quiet record": cls.QUIET_RECORD,
            "repeated periods": cls.REPEATED_PERIODS,
            "repeated experiments": cls.REPEATED_EXPERIMENTS,
            "the records' differences": cls.DIFFERENCES,
            "the residual of the fit": cls.RESIDUAL,
            "the innovations": cls.INNOVATIONS,
        }
        return phrases.get(str(value))

    @property
    def is_independent(self) -> bool:
        """Whether it does not use the records that are fitted."""
        return self in (NoiseSource.GIVEN, NoiseSource.QUIET_RECORD)


@dataclass(frozen=True)
class NoiseModel(Printable):
    """Level and colour of the noise of each output.

    Parameters
    ----------
    outputs
        Names of the model's outputs, in their order (ny).
    std : array (ny,)
        Standard deviations in the model's units. Of an output with too few samples for any source it is the spread of the
        measurement, until there is a fit with a residual.
    sources
        Where each is known from, by name of the measured outputs. An output that reads the same in every row has none.
    colour
        An autoregression for each output (ny), of order zero where the noise is white or its colour unknown.
    known
        Whether no level was estimated from the records that are fitted.
    """

    outputs: tuple[str, ...]
    std: np.ndarray
    sources: Mapping[str, NoiseSource]
    colour: tuple[AutoRegression, ...]
    known: bool

    @property
    def coloured(self) -> bool:
        """Whether the noise of any output is known to be coloured."""
        return any(a.order for a in self.colour)


@dataclass(frozen=True)
class _Level:
    std: float
    source: NoiseSource
    colour: AutoRegression = WHITE


def estimate_noise(
    model: Model,
    experiments: Sequence[Experiment],
    given: Mapping[str, float],
    quiet: Experiment | Sequence[Experiment] = (),
    *,
    robust: bool = False,
    alike: bool = True,
    policy: NoisePolicy = NOISE_POLICY,
) -> NoiseModel:
    """Noise of each output: as given, else from quiet records, from repetition, or from differences.

    Repetition is looked for in the experiments themselves: a periodic input, or several experiments with the same input.

    Parameters
    ----------
    model
        Its outputs are the sensors.
    experiments
        The records that are to be fitted.
    given
        Standard deviations by output, in the model's units.
    quiet
        Records with the input at rest; they also show the colour, of given noise as well.
    robust
        Estimates that a few outliers do not move.
    alike
        Whether experiments with the same input repeat one another; not where they have constants of their own.
    policy
        When a record is quiet, when inputs are the same, how high the order of the colour may be.

    Returns
    -------
    NoiseModel
        Level, source and colour of each output.

    Raises
    ------
    ModelError
        For noise of an unknown output.
    DataError
        For a quiet record whose input moves, or that lacks an output it should show.
    """
    quiet_records = (quiet,) if isinstance(quiet, Experiment) else tuple(quiet)
    _check_given(model, given)
    _check_quiet(model, experiments, quiet_records, policy)
    levels: dict[str, _Level] = {}
    std, colour = np.ones(len(model.outputs)), [WHITE] * len(model.outputs)
    for j, output in enumerate(model.outputs):
        columns = [e.outputs[output.name] for e in experiments if output.name in e.outputs]
        if any(np.isfinite(c).any() for c in columns):
            level = _estimate_level(model, experiments, quiet_records, output.name, given, robust, alike, policy)
            std[j], colour[j] = level.std, level.colour
            levels[output.name] = level
    for name in _find_silent_outputs(levels, experiments):
        del levels[name]
    sources = {name: level.source for name, level in levels.items()}
    known = all(source.is_independent for source in sources.values())
    return NoiseModel(tuple(o.name for o in model.outputs), std, sources, tuple(colour), known)


def _estimate_level(
    model: Model,
    experiments: Sequence[Experiment],
    quiet: Sequence[Experiment],
    name: str,
    given: Mapping[str, float],
    robust: bool,
    alike: bool,
    policy: NoisePolicy,
) -> _Level:
    inputs = [i.name for i in model.inputs]
    at_rest = [
        e.outputs[name] - np.nanmean(e.outputs[name]) for e in quiet if np.isfinite(e.outputs.get(name, np.nan)).any()
    ]
    colour = WHITE
    if at_rest:
        series = join_series(at_rest)
        if _have_same_pace(experiments, quiet, policy):
            colour = fit_autoregression(series, policy=policy)
        enough = np.isfinite(series).sum() >= policy.quiet_min_samples and not is_constant(series)
        if name not in given and enough:
            return _Level(estimate_spread(series, robust=robust), NoiseSource.QUIET_RECORD, colour)
    if name in given:
        return _Level(given[name], NoiseSource.GIVEN, colour)
    periods = [d for e in experiments if (d := deviations_between_periods(e, name, inputs, policy))]
    for source, sets in (
        (NoiseSource.REPEATED_PERIODS, periods),
        (
            NoiseSource.REPEATED_EXPERIMENTS,
            deviations_between_repeats(experiments, name, inputs, policy) if alike else [],
        ),
    ):
        if sets and estimate_spread(series := join_series([d for each in sets for d in each])) > 0:
            # K repeats less their mean hold the information of K - 1.
            copies = sum(map(len, sets)) / sum(len(each) - 1 for each in sets)
            level_colour = fit_autoregression(series, copies=copies, policy=policy)
            return _Level(estimate_spread(series, robust=robust), source, level_colour)
    values = np.concatenate([e.outputs[name] for e in experiments if name in e.outputs])
    movement = float(np.nanstd(values)) or float(np.nanmax(np.abs(values))) or 1.0
    # The signal jumps across a gap in time: no difference may reach over it.
    columns = [np.insert(e.outputs[name], find_time_gaps(e.time) + 1, np.nan) for e in experiments if name in e.outputs]
    level = estimate_noise_of_records(columns, robust=robust, policy=policy)
    if not np.isfinite(level):
        return _Level(movement, NoiseSource.RESIDUAL)
    return _Level(max(level, policy.min_relative_level * movement), NoiseSource.DIFFERENCES)


def _find_silent_outputs(levels: Mapping[str, _Level], experiments: Sequence[Experiment]) -> list[str]:
    """Outputs that read the same in every row while another one moves, and whose noise nobody gave: nothing shows it.

    A handful of samples may be equal by chance; those have the residual of the fit as their source.
    """
    columns = {name: [e.outputs[name] for e in experiments if name in e.outputs] for name in levels}
    resting = [name for name, each in columns.items() if all(map(is_constant, each))]
    if len(resting) == len(levels):
        return []
    return [name for name in resting if levels[name].source is NoiseSource.DIFFERENCES]


def _check_given(model: Model, given: Mapping[str, float]) -> None:
    names = [o.name for o in model.outputs]
    if not isinstance(given, Mapping):
        raise ModelError(
            f"noise: {given!r} is not assigned to an output; give a standard deviation for each, as in {{{names[0]!r}: 1e-6}}"
        )
    for name, value in given.items():
        if name not in names:
            raise ModelError(f"noise of {name!r}: the model has no such output; {nearest(name, names)}")
        if not (np.isfinite(value) and value > 0):
            unit = model.outputs[names.index(name)].unit
            raise ModelError(f"noise of {name!r}: {value} is not a positive standard deviation; give it in {unit}")


def _check_quiet(
    model: Model, experiments: Sequence[Experiment], quiet: Sequence[Experiment], policy: NoisePolicy
) -> None:
    for record in quiet:
        for signal in model.inputs:
            if signal.name not in record.inputs:
                raise DataError(
                    f"quiet record {record.name!r} has no input {signal.name!r}; {nearest(signal.name, record.inputs)}"
                )
            moved = float(np.ptp(record.inputs[signal.name]))
            range_of = max((float(np.ptp(e.inputs[signal.name])) for e in experiments), default=0.0)
            if moved > policy.quiet_input_share * range_of:
                raise DataError(
                    f"quiet record {record.name!r}: input {signal.name!r} moves by {moved:.4g} {signal.unit}, and by {range_of:.4g}"
                    f" {signal.unit} in the estimation records; give a record with the input at rest"
                )
        if not any(o.name in record.outputs for o in model.outputs):
            raise DataError(
                f"quiet record {record.name!r} has none of the model's outputs; it needs the columns of the estimation records"
            )


def _have_same_pace(experiments: Sequence[Experiment], quiet: Sequence[Experiment], policy: NoisePolicy) -> bool:
    paces = [float(np.median(e.intervals)) for e in (*experiments, *quiet)]
    return max(paces) - min(paces) <= policy.same_pace * max(paces)
