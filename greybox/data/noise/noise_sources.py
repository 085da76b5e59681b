"""Noise of each output from the most trustworthy source there is.

Given, a quiet record, repetition, the flat pieces of a record, the spectrum of what no linear response explains, differences. Never the
residual of a model that may lack something: it would call noise what is missing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from greybox.base import DataError, ModelError, nearest
from greybox.data.experiment import Experiment, as_records
from greybox.data.noise import repeats as repetition
from greybox.data.noise.growing import GrowingNoise
from greybox.data.noise.noise_model import (
    NOISE_POLICY,
    WHITE,
    AutoRegression,
    BoundDirection,
    NoiseBound,
    NoiseModel,
    NoisePolicy,
    NoiseSource,
    fit_autoregression,
    join_series,
)
from greybox.data.noise.spectrum import (
    ABOUT_RATIO,
    LeftoverSpectrum,
    estimate_noise_of_records,
    estimate_spread,
    is_smooth,
    leftover_spectrum,
    most_behind_a_filter,
    spectral_level,
)
from greybox.data.problems import is_constant
from greybox.data.sampling import find_time_gaps
from greybox.data.sensor_faults import compute_rounding_std, find_change_band
from greybox.model import Model


@dataclass(frozen=True)
class _Level:
    std: float
    source: NoiseSource
    colour: AutoRegression = WHITE
    direction: BoundDirection | None = None
    samples: float = np.inf
    weight: float = np.inf
    """Standard deviation to weigh with, where the level is only a ceiling and the noise most likely smaller."""
    is_hidden: bool = False
    """Whether the record was filtered, so that the weight is no more than a guess."""

    def to_bound(self, period: float) -> NoiseBound:
        """What it says, with samples ``period`` apart in s."""
        shows_colour = self.source not in (NoiseSource.GIVEN, NoiseSource.DIFFERENCES, NoiseSource.RESIDUAL)
        direction = self.direction or self.source.direction
        known = self.colour.order > 0 or (shows_colour and direction is BoundDirection.ABOUT)
        time = period * self.colour.memory if known else None
        return NoiseBound(self.std, direction, self.source, time, float(1 / np.sqrt(2 * self.samples)))


def estimate_noise(
    model: Model,
    experiments: Sequence[Experiment],
    given: Mapping[str, float | str | GrowingNoise],
    quiet: Experiment | Sequence[Experiment] = (),
    *,
    robust: bool = False,
    alike: bool = True,
    common: bool = False,
    policy: NoisePolicy = NOISE_POLICY,
) -> NoiseModel:
    """Noise of each output: as given (for all rows, or row by row), else from quiet records, from repetition, or from differences.

    Repetition is looked for in the experiments themselves: a periodic input, or several experiments with the same input.

    Parameters
    ----------
    model
        Its outputs are the sensors.
    experiments
        The records that are to be fitted.
    given
        Standard deviations by output, in the model's units, or how the noise grows with the signal (`GrowingNoise`). A text names a level
        that is estimated from the residual of all outputs with that name.
    quiet
        Records with the input at rest; they also show the colour, of given noise as well.
    robust
        Estimates that a few outliers do not move.
    alike
        Whether experiments with the same input repeat one another; not where they have constants of their own.
    common
        Whether outputs whose noise is neither given nor known from a quiet record have one level in common: that of their residual.
    policy
        When a record is quiet, when inputs are the same, how high the order of the colour may be.

    Returns
    -------
    NoiseModel
        Level, source and colour of each output.

    Raises
    ------
    ModelError
        For noise of an unknown output, and for noise in common of outputs with different units.
    DataError
        For a quiet record whose input moves, or that lacks an output it should show.
    """
    quiet_records = as_records(quiet)
    check_given_noise(model, given)
    growth = {name: noise for name, noise in given.items() if isinstance(noise, GrowingNoise)}
    _check_logarithms(growth, experiments)
    named = {name: level for name, level in given.items() if isinstance(level, str)}
    levels_given = {name: noise for name, noise in given.items() if isinstance(noise, (int, float))}
    levels_given |= _level_of_rows(model, experiments, given)
    _check_quiet(model, experiments, quiet_records)
    levels: dict[str, _Level] = {}
    std, colour = np.ones(len(model.outputs)), [WHITE] * len(model.outputs)
    for j, output in enumerate(model.outputs):
        columns = [e.outputs[output.name] for e in experiments if output.name in e.outputs]
        if any(np.isfinite(c).any() for c in columns):
            if output.name in growth:
                level = _level_of_growth(growth[output.name], np.concatenate(columns))
            else:
                level = _estimate_level(
                    model, experiments, quiet_records, output.name, levels_given, robust, alike, policy
                )
            colour[j], levels[output.name] = level.colour, level
    if common:
        untold = (n for n, level in levels.items() if not level.source.is_independent and n not in {*growth, *named})
        named |= dict.fromkeys(untold, "common noise")
    named = {name: level for name, level in named.items() if name in levels}
    for title in dict.fromkeys(named.values()):
        levels |= _share_level(model, {n: levels[n] for n in named if named[n] == title}, title)
    weights = _weigh_outputs(levels, experiments)
    for j, output in enumerate(model.outputs):
        std[j] = weights.get(output.name, 1.0)
    for name in _find_silent_outputs(levels, experiments):
        del levels[name]
    sources = {name: level.source for name, level in levels.items()}
    known = all(source.is_independent for source in sources.values())
    period = float(np.median(np.concatenate([e.intervals for e in experiments]))) if experiments else 1.0
    bounds = {name: level.to_bound(period) for name, level in levels.items()}
    return NoiseModel(tuple(o.name for o in model.outputs), std, sources, tuple(colour), known, bounds, named, growth)


def _level_of_growth(noise: GrowingNoise, readings: np.ndarray) -> _Level:
    """The rms of noise that grows with the signal, the readings standing for the run; their movement until there is a residual."""
    readings = readings[np.isfinite(readings)]
    if noise.unknown:
        return _Level(_measure_movement([readings]), NoiseSource.RESIDUAL)
    return _Level(float(np.sqrt(np.mean(noise.std(readings) ** 2))), NoiseSource.GIVEN)


def _check_logarithms(growth: Mapping[str, GrowingNoise], experiments: Sequence[Experiment]) -> None:
    """Refuse readings that have no logarithm where the noise is that of a logarithm. Raises DataError."""
    for name in (name for name, noise in growth.items() if noise.logarithmic):
        for e in experiments:
            values = e.outputs.get(name, np.empty(0))
            wrong = np.flatnonzero(np.isfinite(values) & ~(values > 0))
            if len(wrong):
                raise DataError(
                    f"experiment {e.name!r}: {name} is {values[wrong[0]]:g} in row {wrong[0] + 1}; its noise is that of log({name}), for"
                    " which all readings must be positive: tell a floor and a share of the noise instead, or leave the row empty"
                )


def _level_of_rows(model: Model, experiments: Sequence[Experiment], given: Mapping[str, object]) -> dict[str, float]:
    """The rms of the standard deviations that the records tell row by row, by output. Raises DataError where some do not."""
    levels = {}
    for name in (o.name for o in model.outputs):
        measured = [e for e in experiments if np.isfinite(e.outputs.get(name, np.nan)).any()]
        with_rows = [e for e in measured if name in e.noise]
        if not with_rows or name in given:
            continue
        if len(with_rows) < len(measured):
            other = next(e.name for e in measured if name not in e.noise)
            raise DataError(
                f"noise of {name!r}: experiment {with_rows[0].name!r} tells it row by row, {other!r} does not; tell it in all records, or"
                " give its usual size (noise) too"
            )
        squares = [e.noise[name][np.isfinite(e.outputs[name])] ** 2 for e in with_rows]
        levels[name] = float(np.sqrt(np.mean(np.concatenate(squares))))
    return levels


def _share_level(model: Model, levels: Mapping[str, _Level], named: str) -> dict[str, _Level]:
    """Outputs at one level, which is ``named``: their greatest movement, until there is a residual."""
    units = {o.name: o.unit for o in model.outputs if o.name in levels}
    if len(set(units.values())) > 1:
        shown = ", ".join(f"{name} in {unit}" for name, unit in units.items())
        raise ModelError(
            f"{named}: {shown}; outputs have one noise in common only in one unit. Give the noise of the others, or leave"
            " it out of what they have in common"
        )
    std = max(level.std for level in levels.values())
    return {
        name: replace(
            level, std=std, weight=std, source=NoiseSource.RESIDUAL, colour=WHITE, direction=None, is_hidden=False
        )
        for name, level in levels.items()
    }


def _weigh_outputs(levels: Mapping[str, _Level], experiments: Sequence[Experiment]) -> dict[str, float]:
    """The standard deviation that each output is weighed with.

    What a filter left of a noise is no reason to follow one output more closely than the others: over its movement it weighs as the
    output that is weighed least, unless its ceiling is lower.
    """
    weights = {name: min(level.std, level.weight) for name, level in levels.items()}
    movement = {name: _measure_movement([e.outputs[name] for e in experiments if name in e.outputs]) for name in levels}
    known = [name for name, level in levels.items() if level.source is not NoiseSource.RESIDUAL]
    share = max((weights[name] / movement[name] for name in known), default=0.0)
    hidden = {n: min(level.std, max(weights[n], share * movement[n])) for n, level in levels.items() if level.is_hidden}
    return weights | hidden


def _measure_movement(columns: Sequence[np.ndarray]) -> float:
    """Standard deviation of an output over its records; of one that stands still its size, or one."""
    values = np.concatenate(columns)
    return float(np.nanstd(values)) or float(np.nanmax(np.abs(values))) or 1.0


# Fewest samples of a quiet record from which the level is taken.
QUIET_MIN_SAMPLES = 20


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
        paces = [float(np.median(e.intervals)) for e in (*experiments, *quiet)]
        if max(paces) - min(paces) <= SAME_PACE * max(paces):  # a colour is one per sample
            colour = fit_autoregression(series, policy=policy)
        samples = int(np.isfinite(series).sum())
        if name not in given and samples >= QUIET_MIN_SAMPLES and not is_constant(series):
            return _Level(estimate_spread(series, robust=robust), NoiseSource.QUIET_RECORD, colour, samples=samples)
    if name in given:
        return _Level(given[name], NoiseSource.GIVEN, colour)
    measured = [e for e in experiments if name in e.outputs]
    columns = [e.outputs[name] for e in measured]
    movement = _measure_movement(columns)
    step = repetition.estimate_resolution(columns) or repetition.estimate_written_step(columns)
    rounding = compute_rounding_std(step)
    bands = (find_change_band(e.time, e.outputs[name]) for e in measured)
    rounding = max([rounding, *(band.std for band in bands if band is not None)])
    level = (
        _repeated_level(experiments, name, inputs, robust, alike, policy)
        or _level_of_records(measured, name, inputs, rounding, robust, policy)
        or _Level(movement, NoiseSource.RESIDUAL)
    )
    least = policy.min_relative_level * movement
    if max(level.std, rounding) < least:
        return replace(level, std=least, direction=BoundDirection.AT_MOST, weight=max(level.weight, least))
    # Noise is part of what a signal shows: whatever its source says, there is no more of it than of movement.
    std, weight = (min(size, movement) for size in (max(level.std, rounding), max(level.weight, rounding, least)))
    return replace(level, std=std, weight=weight)


def _level_of_records(
    experiments: Sequence[Experiment],
    name: str,
    inputs: Sequence[str],
    rounding: float,
    robust: bool,
    policy: NoisePolicy,
) -> _Level | None:
    """The noise from flat pieces or from the plant in motion; of two ceilings the lower one.

    A fit weighs with what differences show where that is less than the ceiling: of white noise on a slow signal they show it closely.
    """
    flat = _flat_level(experiments, name, inputs, robust, policy)
    moving = _moving_level(experiments, name, inputs, rounding, robust)
    levels = [level for level in (flat, moving) if level is not None]
    if not levels:
        return None
    ceiling = min(level.std for level in levels)
    about = [
        level for level in levels if level.direction is BoundDirection.ABOUT and level.std <= ABOUT_RATIO * ceiling
    ]
    if about:
        return about[0]
    lowest = min(levels, key=lambda level: level.std)
    # Where the noise is hidden in motion, so are the differences.
    is_hidden = moving is not None and moving.is_hidden
    at_most = replace(lowest, direction=BoundDirection.AT_MOST, colour=WHITE, is_hidden=is_hidden)
    differences = estimate_noise_of_records(_break_at_gaps(experiments, name), robust=robust)
    return replace(at_most, weight=differences) if np.isfinite(differences) else at_most


def _repeated_level(
    experiments: Sequence[Experiment], name: str, inputs: Sequence[str], robust: bool, alike: bool, policy: NoisePolicy
) -> _Level | None:
    """The noise from periods of a periodic input, or from experiments with the same input."""
    periods = [d for e in experiments if (d := repetition.deviations_between_periods(e, name, inputs))]
    repeats = repetition.deviations_between_repeats(experiments, name, inputs) if alike else []
    for source, sets in (NoiseSource.REPEATED_PERIODS, periods), (NoiseSource.REPEATED_EXPERIMENTS, repeats):
        if sets and estimate_spread(series := join_series([d for each in sets for d in each])) > 0:
            # K repeats less their mean hold the information of K - 1.
            copies = sum(map(len, sets)) / sum(len(each) - 1 for each in sets)
            colour = fit_autoregression(series, copies=copies, policy=policy)
            samples = np.isfinite(series).sum() / copies
            return _Level(estimate_spread(series, robust=robust), source, colour, samples=samples)
    return None


# Sum of autocorrelations, in samples, beyond which a series is no sensor's noise: something moves, or a model lacks something.
LONGEST_MEMORY = 20.0


def _flat_level(
    experiments: Sequence[Experiment], name: str, inputs: Sequence[str], robust: bool, policy: NoisePolicy
) -> _Level | None:
    """The noise from the flat pieces of the records, no larger than what their spectra allow."""
    flat = repetition.find_flat_pieces(experiments, name, inputs)
    if flat is None:
        return None
    series = join_series(flat.pieces)
    samples = int(np.isfinite(series).sum())
    if not flat.agree:
        return _Level(flat.most, NoiseSource.FLAT_PIECES, WHITE, BoundDirection.AT_MOST, samples)
    colour = fit_autoregression(series, policy=policy)
    if colour.memory > LONGEST_MEMORY:
        # What remembers for longer moves: the pieces had not settled, or something drifts.
        return _Level(flat.std, NoiseSource.FLAT_PIECES, WHITE, BoundDirection.AT_MOST, samples)
    level = max(estimate_spread(series, robust=True), flat.std) if robust else flat.std
    return _Level(level, NoiseSource.FLAT_PIECES, colour, BoundDirection.ABOUT, samples)


def _moving_level(
    experiments: Sequence[Experiment], name: str, inputs: Sequence[str], rounding: float, robust: bool
) -> _Level | None:
    """The noise while the plant moves: from what is left of the spectrum, or from differences where records are short or broken."""
    spectra = [] if robust else _leftover_spectra(experiments, name, inputs)
    if spectra:
        level = spectral_level(spectra, rounding)
        if level.is_noise:
            return _Level(level.std, NoiseSource.SPECTRUM, level.colour, BoundDirection.ABOUT, level.freedom / 2)
        ceiling = _Level(level.most, NoiseSource.SPECTRUM, WHITE, BoundDirection.AT_MOST, level.freedom / 2)
        return replace(ceiling, is_hidden=level.is_filtered)
    columns = _break_at_gaps(experiments, name)
    differences = estimate_noise_of_records(columns, robust=robust)
    if not np.isfinite(differences):
        return None
    if all(map(is_smooth, columns)):
        most = min(most_behind_a_filter(columns), _measure_movement(columns))
        return _Level(most, NoiseSource.DIFFERENCES, weight=differences, is_hidden=True)
    return _Level(differences, NoiseSource.DIFFERENCES)


def _break_at_gaps(experiments: Sequence[Experiment], name: str) -> list[np.ndarray]:
    """An output of each record with NaN at the gaps in time: the signal jumps there, and no difference may reach over it."""
    return [np.insert(e.outputs[name], find_time_gaps(e.time) + 1, np.nan) for e in experiments]


def _leftover_spectra(experiments: Sequence[Experiment], name: str, inputs: Sequence[str]) -> list[LeftoverSpectrum]:
    """What no linear response explains, in every stretch of evenly sampled rows without a gap that is long enough."""
    spectra = []
    for record in experiments:
        values = record.outputs[name]
        if is_constant(values):
            continue
        driven = np.column_stack([record.inputs[n] for n in inputs]) if inputs else np.zeros((record.rows, 0))
        missing = ~np.isfinite(values)
        breaks = np.union1d(find_time_gaps(record.time) + 1, np.flatnonzero(np.diff(missing.astype(int))) + 1)
        if not record.regular and not len(find_time_gaps(record.time)):
            continue
        edges = np.concatenate([[0], breaks, [record.rows]]).astype(int)
        for start, stop in pairwise(edges):
            if missing[start]:
                continue
            spectrum = leftover_spectrum(driven[start:stop], values[start:stop])
            if spectrum is not None:
                spectra.append(spectrum)
    return spectra


def _find_silent_outputs(levels: Mapping[str, _Level], experiments: Sequence[Experiment]) -> list[str]:
    """Outputs that read the same in every row while another one moves, and whose noise nobody gave: nothing shows it.

    A handful of samples may be equal by chance; those have the residual of the fit as their source.
    """
    columns = {name: [e.outputs[name] for e in experiments if name in e.outputs] for name in levels}
    resting = [name for name, each in columns.items() if all(map(is_constant, each))]
    if len(resting) == len(levels):
        return []
    return [name for name in resting if levels[name].source in (NoiseSource.SPECTRUM, NoiseSource.DIFFERENCES)]


def check_given_noise(model: Model, given: Mapping[str, float | str | GrowingNoise]) -> None:
    """Refuse noise of an output that the model has not, and what is no standard deviation. Raises ModelError."""
    names = [o.name for o in model.outputs]
    if not isinstance(given, Mapping):
        raise ModelError(
            f"noise: {given!r} is not assigned to an output; give a standard deviation for each, as in {{{names[0]!r}: 1e-6}}"
        )
    for name, value in given.items():
        if name not in names:
            raise ModelError(f"noise of {name!r}: the model has no such output; {nearest(name, names)}")
        if isinstance(value, GrowingNoise) or (isinstance(value, str) and value.isidentifier()):
            continue
        if isinstance(value, str):
            raise ModelError(
                f"noise of {name!r}: {value!r} is neither a number nor the name of a level; write a name, such as 'a', for outputs that"
                " share one"
            )
        if not (np.isfinite(value) and value > 0):
            unit = model.outputs[names.index(name)].unit
            raise ModelError(f"noise of {name!r}: {value} is not a positive standard deviation; give it in {unit}")


# Largest movement of an input in a quiet record, over its movement in the other records, for it to be at rest.
QUIET_INPUT_SHARE = 0.05


def _check_quiet(model: Model, experiments: Sequence[Experiment], quiet: Sequence[Experiment]) -> None:
    for record in quiet:
        for signal in model.inputs:
            if signal.name not in record.inputs:
                raise DataError(
                    f"quiet record {record.name!r} has no input {signal.name!r}; {nearest(signal.name, record.inputs)}"
                )
            moved = float(np.ptp(record.inputs[signal.name]))
            range_of = max((float(np.ptp(e.inputs[signal.name])) for e in experiments), default=0.0)
            if moved > QUIET_INPUT_SHARE * range_of:
                raise DataError(
                    f"quiet record {record.name!r}: input {signal.name!r} moves by {moved:.4g} {signal.unit}, and by {range_of:.4g}"
                    f" {signal.unit} in the estimation records; give a record with the input at rest"
                )
        if not any(o.name in record.outputs for o in model.outputs):
            raise DataError(
                f"quiet record {record.name!r} has none of the model's outputs; it needs the columns of the estimation records"
            )


# Sampling times that differ by more than this share of the longest do not share a colour.
SAME_PACE = 0.01
