"""Noise of each output from the most trustworthy source there is: given, quiet record, repetition, differences, residual."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from greybox.errors import DataError, ModelError, nearest
from greybox.experiment import Experiment
from greybox.experiment.sampling import find_time_gaps
from greybox.model import Model
from greybox.noise.autoregression import AutoRegression, fit_autoregression, join_series
from greybox.noise.differences import estimate_noise_of_records, estimate_spread, is_constant_signal
from greybox.noise.repeats import deviations_between_periods, deviations_between_repeats

# Where the noise is not given and the record shows none (a simulation), misfits are judged against this share of the signal.
LEAST_NOISE = 1e-6
# An input that moves in a quiet record by more than this share of its movement in the other records is not at rest.
AT_REST = 0.05
# Sampling times that differ by more than this share of themselves do not share a colour.
SAME_PACE = 0.01
LEAST_SAMPLES = 20

WHITE = AutoRegression()
GIVEN, QUIET = "given", "quiet record"
PERIODS, REPEATS = "repeated periods", "repeated experiments"
DIFFERENCES, RESIDUAL = "the records' differences", "the residual of the fit"


@dataclass(frozen=True)
class NoiseModel:
    """Noise of each output in the order of the model's outputs.

    ``std`` (ny,) in the model's units; ``source`` in words, ``sources`` by name of each measured output; ``colour`` (ny,): an
    autoregression of order zero where the noise is white or its colour unknown. ``given``: no value was estimated from the
    records that are fitted. An output with too few samples for any of it has ``the residual of the fit`` as its source; until there
    is a fit its ``std`` is the spread of the measurement.
    """

    std: np.ndarray
    source: str
    given: bool
    sources: Mapping[str, str]
    colour: tuple[AutoRegression, ...]

    @property
    def coloured(self) -> bool:
        """Whether the noise of any output is known to be coloured."""
        return any(a.order for a in self.colour)


@dataclass(frozen=True)
class _Level:
    std: float
    source: str
    colour: AutoRegression = WHITE


def estimate_noise(
    model: Model,
    experiments: Sequence[Experiment],
    given: Mapping[str, float],
    quiet: Experiment | Sequence[Experiment] = (),
    *,
    robust: bool = False,
    alike: bool = True,
) -> NoiseModel:
    """Noise of each output of ``model``: as ``given`` (standard deviations), else from ``quiet``, repetition, or differences.

    ``quiet``: records with the input at rest; they also tell the colour, of given noise as well. Repetition is looked for in the
    experiments themselves: a periodic input, or several experiments with the same input, unless they are not ``alike`` (constants of
    their own). ``robust`` estimates are not moved by a few outliers. An output that reads the same in every row has no source: nothing
    tells its noise. Raises ModelError for noise of an unknown output, DataError for a quiet record whose input moves or that lacks
    an output it should tell about.
    """
    silent = (quiet,) if isinstance(quiet, Experiment) else tuple(quiet)
    _check_given(model, given)
    _check_quiet(model, experiments, silent)
    levels: dict[str, _Level] = {}
    std, colour = np.ones(len(model.outputs)), [AutoRegression()] * len(model.outputs)
    for j, output in enumerate(model.outputs):
        columns = [e.outputs[output.name] for e in experiments if output.name in e.outputs]
        if any(np.isfinite(c).any() for c in columns):
            level = _level(model, experiments, silent, output.name, given, robust, alike)
            std[j], colour[j] = level.std, level.colour
            levels[output.name] = level
    for name in _silent(levels, experiments):
        del levels[name]
    sources = {name: level.source for name, level in levels.items()}
    estimated = [name for name, source in sources.items() if source not in (GIVEN, QUIET)]
    return NoiseModel(std, _words(levels), not estimated, sources, tuple(colour))


def _level(
    model: Model, experiments: Sequence[Experiment], silent: Sequence[Experiment], name: str, given: Mapping[str, float],
    robust: bool, alike: bool,
) -> _Level:  # fmt: skip
    inputs = [i.name for i in model.inputs]
    hushed = [
        e.outputs[name] - np.nanmean(e.outputs[name]) for e in silent if np.isfinite(e.outputs.get(name, np.nan)).any()
    ]
    colour = AutoRegression()
    if hushed:
        found = join_series(hushed)
        if _same_pace(experiments, silent):
            colour = fit_autoregression(found)
        if name not in given and np.isfinite(found).sum() >= LEAST_SAMPLES and not is_constant_signal(found):
            return _Level(estimate_spread(found, robust=robust), QUIET, colour)
    if name in given:
        return _Level(given[name], GIVEN, colour)
    for source, groups in (
        (PERIODS, [d for e in experiments if (d := deviations_between_periods(e, name, inputs))]),
        (REPEATS, deviations_between_repeats(experiments, name, inputs) if alike else []),
    ):
        if groups and estimate_spread(everything := join_series([d for group in groups for d in group])) > 0:
            # K repeats less their mean hold the information of K - 1
            copies = sum(map(len, groups)) / sum(len(group) - 1 for group in groups)
            return _Level(
                estimate_spread(everything, robust=robust), source, fit_autoregression(everything, copies=copies)
            )
    values = np.concatenate([e.outputs[name] for e in experiments if name in e.outputs])
    movement = float(np.nanstd(values)) or float(np.nanmax(np.abs(values))) or 1.0
    # the signal jumps across a gap in time: no difference may reach over it
    columns = [np.insert(e.outputs[name], find_time_gaps(e.time) + 1, np.nan) for e in experiments if name in e.outputs]
    estimate = estimate_noise_of_records(columns, robust=robust)
    if not np.isfinite(estimate):
        return _Level(movement, RESIDUAL)
    return _Level(max(estimate, LEAST_NOISE * movement), DIFFERENCES)


def _silent(levels: Mapping[str, _Level], experiments: Sequence[Experiment]) -> list[str]:
    """Outputs that read the same in every row while another one moves, and whose noise nobody gave: nothing tells it.

    A handful of samples may be equal by chance; those have the residual of the fit as their source.
    """
    columns = {name: [e.outputs[name] for e in experiments if name in e.outputs] for name in levels}
    resting = [name for name, found in columns.items() if all(map(is_constant_signal, found))]
    if len(resting) == len(levels):
        return []
    return [name for name in resting if levels[name].source == DIFFERENCES]


def _check_given(model: Model, given: Mapping[str, float]) -> None:
    names = [o.name for o in model.outputs]
    if not isinstance(given, Mapping):
        raise ModelError(
            f"noise: {given!r} belongs to no output; give a standard deviation for each, as in {{{names[0]!r}: 1e-6}}"
        )
    for name, value in given.items():
        if name not in names:
            raise ModelError(f"noise of {name!r}: the model has no such output; {nearest(name, names)}")
        if not (np.isfinite(value) and value > 0):
            unit = model.outputs[names.index(name)].unit
            raise ModelError(f"noise of {name!r}: {value} is not a positive standard deviation; give it in {unit}")


def _check_quiet(model: Model, experiments: Sequence[Experiment], silent: Sequence[Experiment]) -> None:
    for record in silent:
        for signal in model.inputs:
            if signal.name not in record.inputs:
                raise DataError(
                    f"quiet record {record.name!r} has no input {signal.name!r}; {nearest(signal.name, record.inputs)}"
                )
            moved = float(np.ptp(record.inputs[signal.name]))
            range_of = max((float(np.ptp(e.inputs[signal.name])) for e in experiments), default=0.0)
            if moved > AT_REST * range_of:
                raise DataError(
                    f"quiet record {record.name!r}: input {signal.name!r} moves by {moved:.4g} {signal.unit}, and by {range_of:.4g}"
                    f" {signal.unit} in the fitted records; give a record with the input at rest"
                )
        if not any(o.name in record.outputs for o in model.outputs):
            raise DataError(
                f"quiet record {record.name!r} has none of the model's outputs; it needs the columns of the fitted records"
            )


def _same_pace(experiments: Sequence[Experiment], silent: Sequence[Experiment]) -> bool:
    paces = [float(np.median(e.intervals)) for e in (*experiments, *silent)]
    return max(paces) - min(paces) <= SAME_PACE * max(paces)


def _words(levels: Mapping[str, _Level]) -> str:
    """``given``, or ``x from quiet record (AR(2), ...), i from ...``."""
    groups: dict[str, list[str]] = {}
    for name, level in levels.items():
        text = (
            level.source
            if level.source in (GIVEN, DIFFERENCES, RESIDUAL) and not level.colour.order
            else f"{level.source} ({level.colour})"
        )
        text = text if level.source == GIVEN else f"estimated from {text}"
        groups.setdefault(text, []).append(name)
    remarks = {DIFFERENCES: " (too small if the noise is coloured)", RESIDUAL: " (too few samples to tell otherwise)"}
    texts = [t + next((remark for end, remark in remarks.items() if t.endswith(end)), "") for t in groups]
    if len(texts) == 1:
        return texts[0]
    return "; ".join(f"{', '.join(names)}: {text}" for names, text in zip(groups.values(), texts, strict=True))
