"""Where, when and as a function of what model and data disagree."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from greybox.base.errors import DataError, nearest
from greybox.base.values import Printable, ReadOnly
from greybox.data.noise.noise_model import AutoRegression
from greybox.discovery.curve_shape import Dependence, rank_dependences
from greybox.discovery.disturbance_sites import (
    DisturbanceSite,
    LinearisedRun,
    SignalSmoother,
    SiteKind,
    SmoothedSignal,
    absorbed_basis,
    are_indistinguishable,
    linearise_run,
    list_disturbance_sites,
    site_label,
    unwhitened_shooting,
    whiten_columns,
)
from greybox.discovery.problem import DiscoveryProblem, FittedCandidate, clean_cost_limit
from greybox.estimation.result import Fit
from greybox.model.model import Model

# When model and data disagree: windows of time with their share of the misfit.


@dataclass(frozen=True)
class MisfitWindow:
    """A stretch of a record, with the misfit there.

    Parameters
    ----------
    record
        Its name.
    start, end
        Seconds.
    share
        Share of the misfit beyond noise.
    misfit
        Misfit over noise there.
    """

    record: str
    start: float
    end: float
    share: float
    misfit: float


@dataclass(frozen=True)
class MisfitTiming:
    """The windows in which most of the misfit is concentrated: stretches of time as (record, start, end) in seconds.

    ``share`` of the misfit happens in ``time_share`` of the windows. Without stretches it happens throughout the records.
    """

    share: float
    time_share: float
    stretches: tuple[tuple[str, float, float], ...]


def divide_misfit(
    names: Sequence[str], times: Sequence[np.ndarray], residuals: Sequence[np.ndarray], count: int
) -> tuple[MisfitWindow, ...]:
    """Every record in ``count`` windows of equal length; ``residuals`` (N, ny) are over the noise, NaN in gaps."""
    rows = []
    for name, time, r in zip(names, times, residuals, strict=True):
        edges = np.linspace(0, len(time), min(count, len(time)) + 1).astype(int)
        for first, last in pairwise(edges):
            part = r[first:last]
            is_measured = np.isfinite(part)
            samples, squares = is_measured.sum(), float(np.sum(part[is_measured] ** 2))
            excess = max(squares - samples, 0.0)
            rows.append((name, float(time[first]), float(time[last - 1]), excess, squares, samples))
    total = sum(row[3] for row in rows) or 1.0
    return tuple(
        MisfitWindow(name, start, end, excess / total, float(np.sqrt(squares / max(samples, 1))))
        for name, start, end, excess, squares, samples in rows
    )


# Share of the misfit that is concentrated...
CONCENTRATED_MISFIT = 0.6
# ...if it happens in at most this share of the windows.
CONCENTRATED_TIME = 0.25


def find_concentration(windows: Sequence[MisfitWindow]) -> MisfitTiming | None:
    """In which stretches most of the misfit happens; None where there is none beyond noise."""
    if not windows or not any(w.share for w in windows):
        return None
    ranked = sorted(windows, key=lambda w: -w.share)
    shares = np.cumsum([w.share for w in ranked])
    needed = int(np.searchsorted(shares, CONCENTRATED_MISFIT)) + 1
    if needed > CONCENTRATED_TIME * len(windows):
        return MisfitTiming(1.0, 1.0, ())
    stretches: list[tuple[str, float, float]] = []
    for w in sorted(ranked[:needed], key=lambda w: (w.record, w.start)):
        adjoins = stretches and stretches[-1][0] == w.record and w.start - stretches[-1][2] <= 0.5 * (w.end - w.start)
        if adjoins:
            stretches[-1] = (w.record, stretches[-1][1], w.end)
        else:
            stretches.append((w.record, w.start, w.end))
    return MisfitTiming(float(shares[needed - 1]), needed / len(windows), tuple(stretches))


# The residual of a fit by frequency, beside the noise.


@dataclass(frozen=True, eq=False)
class ResidualSpectrum(ReadOnly):
    """Amplitude density of the free-run error of ``output``, and of its noise ``floor``: ``frequency`` (F,) in Hz, both (F,) in ``unit``.

    The square, summed over the frequencies, is the mean square of the error.
    """

    output: str
    frequency: np.ndarray
    density: np.ndarray
    floor: np.ndarray
    unit: str


def estimate_residual_spectrum(
    fit: Fit, output: str, *, coloured: bool = True, segment: int = 512, stretches: int = 8
) -> ResidualSpectrum:
    """Spectrum of the residual of one output, by Welch's method; gaps count as zero.

    Parameters
    ----------
    fit
        Its validation records count, or the estimation records where there are none.
    output
        A measured output.
    coloured
        Whether the floor has the colour that the fit took the noise for; a missing effect may have passed for it.
    segment
        Samples of one stretch at most.
    stretches
        Stretches that a record gives at least.

    Returns
    -------
    ResidualSpectrum
        Frequencies (F,) in Hz, the density of the residual and that of the noise (F,) in the unit of the output.

    Raises
    ------
    DataError
        For an output that was not measured.
    """
    traces = [t for t in (fit.validation.traces or fit.traces) if output in t.measured]
    if not traces:
        raise DataError(f"spectrum of {output!r}: not measured; {nearest(output, list(fit.misfit))}")
    period = float(np.median(np.diff(traces[0].time)))
    shortest = min(len(t.time) for t in traces)
    length = min(segment, max(shortest // stretches * 2, 8), shortest)
    powers = [estimate_power_density(np.nan_to_num(t.residual(output)), period, length) * len(t.time) for t in traces]
    power = sum(powers) / sum(len(t.time) for t in traces)
    frequency = np.fft.rfftfreq(length, period)
    step = frequency[1] - frequency[0]
    std, reflection = fit.noise.std.get(output, np.nan), fit.noise.colour.get(output, ()) if coloured else ()
    floor = std**2 * 2 * period * _noise_shape(AutoRegression(tuple(reflection)), frequency * period)
    unit = next(o.unit for o in fit.model.outputs if o.name == output)
    return ResidualSpectrum(output, frequency[1:], np.sqrt(power * step)[1:], np.sqrt(floor * step)[1:], unit)


def estimate_power_density(values: np.ndarray, period: float, length: int) -> np.ndarray:
    """One-sided power density (length // 2 + 1,) of ``values`` (N,), sampled every ``period`` seconds, by Welch's method.

    The mean over stretches of ``length`` samples that overlap by half, each under a Hann window; what is constant stays in.
    """
    # As `scipy.signal.welch` without detrending: that takes half a second to import.
    stretches = np.lib.stride_tricks.sliding_window_view(values, length)[:: length - length // 2]
    window = np.hanning(length + 1)[:-1]
    power = (np.abs(np.fft.rfft(window * stretches)) ** 2).mean(axis=0) * period / (window @ window)
    # A frequency stands for its negative too, but for zero and half the sampling rate.
    power[1 : None if length % 2 else -1] *= 2
    return np.asarray(power)


def _noise_shape(colour: AutoRegression, cycles: np.ndarray) -> np.ndarray:
    """Power spectrum of noise of this colour and unit variance over that of white noise, at ``cycles`` per sample."""
    lags = np.arange(1, colour.order + 1)
    response = 1 - np.exp(-2j * np.pi * np.outer(cycles, lags)) @ colour.coefficients
    return colour.innovation_variance / np.abs(response) ** 2


@dataclass(frozen=True)
class RankedSite:
    """A site of the model and how much likelier the residual is with an unknown signal there.

    Parameters
    ----------
    name, kind
        The balance, input or output, and which of these it is.
    gain
        Log-likelihood over no signal, in nats.
    size
        Rms of the signal that is needed there, in ``unit``.
    unit
        Unit of the signal.
    """

    name: str
    kind: SiteKind
    gain: float
    size: float
    unit: str

    @property
    def label(self) -> str:
        """The name by which the site is known in results."""
        return site_label(self.kind, self.name)


@dataclass(frozen=True, eq=False)
class ResidualSignal(ReadOnly):
    """The unexplained signal at one site in a stretch of one record.

    What is constant or proportional to what the model's parameters already multiply is not in it: the fit has absorbed that.

    Parameters
    ----------
    site, unit, record
        Label of the site, unit of the signal, name of the record.
    time, value, std
        Seconds, signal and its standard deviation (K,).
    variables, units
        Name -> values (K,) of every state and input there, and their units; for a measured state that the model misses, the readings.
    """

    site: str
    unit: str
    record: str
    time: np.ndarray
    value: np.ndarray
    std: np.ndarray
    variables: Mapping[str, np.ndarray]
    units: Mapping[str, str]


# Log-likelihood in nats by which a site must lead, over no signal and over the next site.
SITE_LEAD = 10.0
# Share of the leading site's gain that this lead is at least, over the next site.
SITE_LEAD_SHARE = 0.001


@dataclass(frozen=True, eq=False)
class ResidualLocalisation(Printable, ReadOnly):
    """The signal that a fitted model does not explain: site, time and dependence. Empty if the model is complete.

    Parameters
    ----------
    misfit, threshold
        Misfit over noise on the records that it was fitted to (`FittedCandidate.noise_ratio`), and from which on something is missing.
    sites
        Sites, likeliest first.
    sets
        Their labels in sets that the sensors cannot separate.
    windows
        When the misfit happens.
    signals
        The unexplained signal as it would be at each site, in the stretch where the misfit varies most; likeliest first.
    dependences
        The signal as a function of each variable, best first.
    is_noise_bounded
        Whether the noise is only known to be no larger, so that the misfit is at least so many times the noise.
    """

    misfit: float
    threshold: float
    sites: tuple[RankedSite, ...] = ()
    sets: tuple[tuple[str, ...], ...] = ()
    windows: tuple[MisfitWindow, ...] = ()
    signals: tuple[ResidualSignal, ...] = ()
    dependences: tuple[Dependence, ...] = ()
    is_noise_bounded: bool = False

    @classmethod
    def without_sites(cls, candidate: FittedCandidate) -> ResidualLocalisation:
        """The misfit alone, where its site cannot be estimated."""
        misfit, weighed = candidate.noise_ratio, candidate.per_sample**0.5
        # The limit is one of the cost that the search weighs: on the scale of the misfit.
        scale = misfit / weighed if 0 < weighed < np.inf else 1.0
        threshold = scale * clean_cost_limit(candidate.count) ** 0.5
        return cls(misfit, threshold, is_noise_bounded=candidate.is_noise_bounded)

    @property
    def signal(self) -> ResidualSignal | None:
        """The unexplained signal at the likeliest site."""
        return next(iter(self.signals), None)

    @property
    def is_missing(self) -> bool:
        """Whether more than noise is left."""
        return self.misfit > self.threshold

    @property
    def likeliest(self) -> tuple[str, ...]:
        """The likeliest site with those that cannot be told from it; empty where none explains anything."""
        return self.sets[0] if self.sets and self.sites[0].gain > SITE_LEAD else ()

    @property
    def timing(self) -> MisfitTiming | None:
        """In which stretches of time most of the misfit happens; None where there is none."""
        return find_concentration(self.windows)


# Rows of the stretch in which the signal is estimated: where the misfit varies most.
LOCALISATION_MOST_ROWS = 1200
# Windows of time in which each record is divided.
LOCALISATION_WINDOWS = 20


def localise_residual(fit: Fit | FittedCandidate) -> ResidualLocalisation:
    """Where, when and as a function of what ``fit`` leaves something unexplained.

    At each balance, input and sensor in turn an unknown slowly varying signal is estimated in the stretch where the misfit varies
    most, with the fitted parameters and the initial state projected out, and the sites are ranked by likelihood (G. Wahba 1990,
    Spline models for observational data). The model is linearised along its run.

    Parameters
    ----------
    fit
        A finished fit, or a candidate of a discovery.

    Returns
    -------
    ResidualLocalisation
        Sites in sets that the sensors cannot separate, windows of time, and the signal as a function of each variable.

    Examples
    --------
    >>> fit = gb.fit(model, record, noise={"x": 2e-7})  # doctest: +SKIP
    >>> gb.discovery.localise_residual(fit).likeliest  # doctest: +SKIP
    ('balance force',)
    """
    fit.model.require_equations("a localisation of the residual")
    candidate = to_candidate_fit(fit) if isinstance(fit, Fit) else fit
    residuals = normalised_residuals(candidate)
    experiments = candidate.problem.experiments
    alone = ResidualLocalisation.without_sites(candidate)
    # A run that has gone astray says no more than that something is missing.
    if not alone.is_missing or any(np.any(np.abs(r) == ASTRAY_RESIDUAL) for r in residuals):
        return alone
    names, times = [e.name for e in experiments], [e.time for e in experiments]
    windows = divide_misfit(names, times, residuals, LOCALISATION_WINDOWS)
    line = linearise_run(candidate, *find_worst_stretch(residuals, LOCALISATION_MOST_ROWS))
    ranked = _rank_sites(candidate, line)
    if not ranked:
        return replace(alone, windows=windows)
    sites = tuple(
        RankedSite(site.name, site.kind, smoothed.gain, float(np.sqrt(np.mean(smoothed.value**2))), site.unit)
        for site, smoothed in ranked
    )
    signals = tuple(_to_signal(candidate, line, *one) for one in ranked)
    signal = signals[0]
    variables = {name: (values, signal.units[name]) for name, values in signal.variables.items()}
    run = np.column_stack([line.x, line.u])[ranked[0][1].rows]
    dependences = tuple(rank_dependences(signal.time, signal.value, variables, run))
    return replace(
        alone, sites=sites, sets=_group_sites(sites), windows=windows, signals=signals, dependences=dependences
    )


def to_candidate_fit(fit: Fit) -> FittedCandidate:
    """A finished fit as a candidate: the same records, noise and options, at its parameters."""
    return DiscoveryProblem.from_fit(fit).to_candidate(fit)


# Residual over noise beyond which a run has gone astray: how far it went says nothing, and the square of this is still a number.
ASTRAY_RESIDUAL = 1e100


def normalised_residuals(candidate: FittedCandidate) -> list[np.ndarray]:
    """Residual over noise (N, ny) of each record, no larger than `ASTRAY_RESIDUAL`."""
    residuals = (r for r, _ in unwhitened_shooting(candidate).residuals(candidate.variables.here))
    return [np.clip(r, -ASTRAY_RESIDUAL, ASTRAY_RESIDUAL) for r in residuals]


def find_worst_stretch(residuals: Sequence[np.ndarray], most_rows: int) -> tuple[int, int, int]:
    """Record, first row and rows of the stretch in which the misfit varies most.

    A misfit that stands still, as at an end of the range, is the same at every site and over every variable.
    """
    largest, stretch = -1.0, (0, 0, 1)
    for e, r in enumerate(residuals):
        rows = min(most_rows, len(r))
        within = []
        for values in (np.nan_to_num(r) ** 2, np.nan_to_num(r), np.isfinite(r).astype(float)):
            sums = np.vstack([np.zeros((1, r.shape[1])), np.cumsum(values, axis=0)])
            within.append(sums[rows:] - sums[:-rows])
        squares, total, count = within
        varying = np.maximum(squares - total**2 / np.maximum(count, 1), 0.0).sum(axis=1)  # rounding may go below
        if varying.max() > largest:
            largest, stretch = float(varying.max()), (e, int(np.argmax(varying)), rows)
    return stretch


def _rank_sites(candidate: FittedCandidate, line: LinearisedRun) -> list[tuple[DisturbanceSite, SmoothedSignal]]:
    """Every site with the signal that the residual asks for there, likeliest first."""
    r, jacobian = unwhitened_shooting(candidate).residuals(candidate.variables.here)[line.record]
    stretch = slice(line.first, line.first + line.rows)
    r, jacobian = r[stretch], jacobian[stretch]
    present = np.isfinite(r)
    noise = candidate.problem.noise
    white = whiten_columns(r[:, :, None], noise.colour, present)[present][:, 0]
    absorbing = whiten_columns(np.nan_to_num(jacobian), noise.colour, present)
    basis = absorbed_basis(line, 1 / noise.std, noise.colour, absorbing, present)
    outputs = zip(candidate.model.outputs, present.any(axis=0), strict=True)
    measured = [o.name for o, is_measured in outputs if is_measured]
    ranked: list[tuple[DisturbanceSite, SmoothedSignal]] = []
    for site in list_disturbance_sites(candidate.model, measured):
        same = next(((s, w) for s, w in ranked if are_indistinguishable(line.gamma[s], line.gamma[site])), None)
        if same is None:
            smoother = SignalSmoother.at_site(line, site, 1 / noise.std, noise.colour, basis, present)
            signal = smoother.smooth(white)
        else:  # the same signal in another unit
            ratio = float(np.linalg.norm(line.gamma[same[0]]) / np.linalg.norm(line.gamma[site]))
            signal = replace(same[1], value=ratio * same[1].value, std=ratio * same[1].std)
        ranked.append((site, signal))
    # Of sites that cannot be told apart the balance comes first: that is where most physics is. Their gains differ by rounding.
    return sorted(ranked, key=lambda one: (-float(f"{one[1].gain:.6g}"), one[0].kind == SiteKind.INPUT))


def signal_units(model: Model) -> dict[str, str]:
    """Unit of each state and input by name."""
    return {s.name: s.unit for s in model.all_states} | {i.name: i.unit for i in model.inputs}


def _group_sites(sites: Sequence[RankedSite]) -> tuple[tuple[str, ...], ...]:
    """Labels of sites in sets within a lead of their first, likeliest first."""
    groups: list[list[RankedSite]] = []
    for site in sites:
        lead = max(SITE_LEAD, SITE_LEAD_SHARE * groups[-1][0].gain) if groups else 0.0
        if groups and groups[-1][0].gain - site.gain <= lead:
            groups[-1].append(site)
        else:
            groups.append([site])
    return tuple(tuple(s.label for s in group) for group in groups)


# A reading replaces the simulated state where the two differ by more than this many standard deviations of the noise.
MEASURED_RATIO = 2.0


def _to_signal(
    candidate: FittedCandidate,
    line: LinearisedRun,
    site: DisturbanceSite,
    smoothed: SmoothedSignal,
) -> ResidualSignal:
    model, rows = candidate.model, smoothed.rows
    names = [*model.system.state_names, *(i.name for i in model.inputs)]
    values = np.column_stack([line.x, line.u])[rows]
    if site.kind != SiteKind.SENSOR:
        _replace_by_readings(candidate, line, rows, values, MEASURED_RATIO)
    return ResidualSignal(
        site.label,
        site.unit,
        candidate.problem.experiments[line.record].name,
        line.time[rows],
        smoothed.value,
        smoothed.std,
        {name: column for name, column in zip(names, values.T, strict=True) if name not in model.auxiliary},
        signal_units(model),
    )


def _replace_by_readings(
    candidate: FittedCandidate, line: LinearisedRun, rows: np.ndarray, values: np.ndarray, ratio: float
) -> None:
    """Put the readings of measured states into ``values`` (K, nx + nu) where the model's run is farther off than ``ratio`` noises."""
    model, experiment = candidate.model, candidate.problem.experiments[line.record]
    for j, output in enumerate(model.outputs):
        equation = model.system.outputs[j]
        if output.name not in experiment.outputs or not equation.is_symbolic():
            continue
        reading = experiment.outputs[output.name][line.first + rows]
        if equation.name() in model.system.state_names and np.isfinite(reading).all():
            column = model.system.state_names.index(equation.name())
            difference = float(np.sqrt(np.mean((reading - values[:, column]) ** 2)))
            if difference > ratio * candidate.problem.noise.std[j]:
                values[:, column] = reading
