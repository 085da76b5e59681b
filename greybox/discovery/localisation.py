"""Where, when and as a function of what model and data disagree."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from greybox.discovery.decision import clean_cost_limit
from greybox.discovery.dependence import Dependence, rank_dependences
from greybox.discovery.disturbance_sites import (
    DisturbanceSite,
    LinearisedRun,
    SiteKind,
    are_indistinguishable,
    linearise_run,
    list_disturbance_sites,
    site_label,
    unwhitened_shooting,
)
from greybox.discovery.misfit_windows import MisfitTiming, MisfitWindow, divide_misfit, find_concentration
from greybox.discovery.policy import LocalisationPolicy, SelectionPolicy
from greybox.discovery.problem import CandidateFit, DiscoveryProblem
from greybox.discovery.signal_smoother import SignalSmoother, SmoothedSignal, absorbed_basis, whiten_columns
from greybox.model import Model
from greybox.result import Fit
from greybox.values import Printable, ReadOnly


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


@dataclass(frozen=True, eq=False)
class ResidualLocalisation(Printable, ReadOnly):
    """The signal that a fitted model does not explain: site, time and dependence. Empty if the model is complete.

    Parameters
    ----------
    misfit, threshold
        Rms over noise on the records that it was fitted to, and the largest that chance explains.
    sites
        Sites, likeliest first.
    sets
        Their labels in sets that the sensors cannot separate.
    windows
        When the misfit happens.
    signal
        The unexplained signal at the likeliest site.
    dependences
        The signal as a function of each variable, best first.
    policy
        The numbers that decided.
    """

    misfit: float
    threshold: float
    sites: tuple[RankedSite, ...] = ()
    sets: tuple[tuple[str, ...], ...] = ()
    windows: tuple[MisfitWindow, ...] = ()
    signal: ResidualSignal | None = None
    dependences: tuple[Dependence, ...] = ()
    policy: LocalisationPolicy = field(default_factory=LocalisationPolicy)

    @classmethod
    def without_sites(
        cls, candidate: CandidateFit, policy: LocalisationPolicy, selection: SelectionPolicy
    ) -> ResidualLocalisation:
        """The misfit alone, where its site cannot be estimated."""
        misfit, threshold = candidate.per_sample**0.5, clean_cost_limit(candidate.count, selection) ** 0.5
        return cls(misfit, threshold, policy=policy)

    @property
    def is_missing(self) -> bool:
        """Whether more than noise is left."""
        return self.misfit > self.threshold

    @property
    def likeliest(self) -> tuple[str, ...]:
        """The likeliest site with those that cannot be told from it; empty where none explains anything."""
        return self.sets[0] if self.sets and self.sites[0].gain > self.policy.site_lead else ()

    @property
    def timing(self) -> MisfitTiming | None:
        """In which stretches of time most of the misfit happens; None where there is none."""
        return find_concentration(self.windows, self.policy)


def localise_residual(
    fit: Fit | CandidateFit,
    *,
    policy: LocalisationPolicy | None = None,
    selection: SelectionPolicy | None = None,
) -> ResidualLocalisation:
    """Where, when and as a function of what ``fit`` leaves something unexplained.

    At each balance, input and sensor in turn an unknown slowly varying signal is estimated in the stretch where the misfit varies
    most, with the fitted parameters and the initial state projected out, and the sites are ranked by likelihood (G. Wahba 1990,
    Spline models for observational data). The model is linearised along its run.

    Parameters
    ----------
    fit
        A finished fit, or a candidate of a discovery.
    policy
        The numbers of the localisation.
    selection
        From which misfit something is missing.

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
    candidate = to_candidate_fit(fit) if isinstance(fit, Fit) else fit
    policy, selection = policy or LocalisationPolicy(), selection or SelectionPolicy()
    residuals = normalised_residuals(candidate)
    experiments = candidate.problem.experiments
    misfit, threshold = candidate.per_sample**0.5, clean_cost_limit(candidate.count, selection) ** 0.5
    if misfit <= threshold:
        return ResidualLocalisation(misfit, threshold, policy=policy)
    names, times = [e.name for e in experiments], [e.time for e in experiments]
    windows = divide_misfit(names, times, residuals, policy.windows)
    line = linearise_run(candidate, *find_worst_stretch(residuals, policy.most_rows))
    ranked = _rank_sites(candidate, line, policy)
    if not ranked:
        return ResidualLocalisation(misfit, threshold, windows=windows, policy=policy)
    sites = tuple(
        RankedSite(site.name, site.kind, smoothed.gain, float(np.sqrt(np.mean(smoothed.value**2))), site.unit)
        for site, smoothed in ranked
    )
    signal = _to_signal(candidate, line, *ranked[0], policy)
    variables = {name: (values, signal.units[name]) for name, values in signal.variables.items()}
    run = np.column_stack([line.x, line.u])[ranked[0][1].rows]
    dependences = tuple(rank_dependences(signal.time, signal.value, variables, policy, run))
    return ResidualLocalisation(
        misfit, threshold, sites, _group_sites(sites, policy), windows, signal, dependences, policy
    )


def to_candidate_fit(fit: Fit) -> CandidateFit:
    """A finished fit as a candidate: the same records, noise and options, at its parameters."""
    return DiscoveryProblem.from_fit(fit).to_candidate(fit)


def estimate_site_signals(candidate: CandidateFit, policy: LocalisationPolicy) -> dict[str, ResidualSignal]:
    """The unexplained signal as it would be at each site, in the stretch where the misfit varies most; likeliest first."""
    line = linearise_run(candidate, *find_worst_stretch(normalised_residuals(candidate), policy.most_rows))
    ranked = _rank_sites(candidate, line, policy)
    return {site.label: _to_signal(candidate, line, site, smoothed, policy) for site, smoothed in ranked}


def normalised_residuals(candidate: CandidateFit) -> list[np.ndarray]:
    """Residual over noise (N, ny) of each record."""
    return [r for r, _ in unwhitened_shooting(candidate).residuals(candidate.variables.here)]


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


def _rank_sites(
    candidate: CandidateFit, line: LinearisedRun, policy: LocalisationPolicy
) -> list[tuple[DisturbanceSite, SmoothedSignal]]:
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
            smoother = SignalSmoother.at_site(line, site, 1 / noise.std, noise.colour, basis, present, policy)
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


def _group_sites(sites: Sequence[RankedSite], policy: LocalisationPolicy) -> tuple[tuple[str, ...], ...]:
    """Labels of sites in sets within a lead of their first, likeliest first."""
    groups: list[list[RankedSite]] = []
    for site in sites:
        lead = max(policy.site_lead, policy.site_lead_share * groups[-1][0].gain) if groups else 0.0
        if groups and groups[-1][0].gain - site.gain <= lead:
            groups[-1].append(site)
        else:
            groups.append([site])
    return tuple(tuple(s.label for s in group) for group in groups)


def _to_signal(
    candidate: CandidateFit,
    line: LinearisedRun,
    site: DisturbanceSite,
    smoothed: SmoothedSignal,
    policy: LocalisationPolicy,
) -> ResidualSignal:
    model, rows = candidate.model, smoothed.rows
    names = [*model.system.state_names, *(i.name for i in model.inputs)]
    values = np.column_stack([line.x, line.u])[rows]
    if site.kind != SiteKind.SENSOR:
        _replace_by_readings(candidate, line, rows, values, policy.measured_ratio)
    return ResidualSignal(
        site.label,
        site.unit,
        candidate.problem.experiments[line.record].name,
        line.time[rows],
        smoothed.value,
        smoothed.std,
        dict(zip(names, values.T, strict=True)),
        signal_units(model),
    )


def _replace_by_readings(
    candidate: CandidateFit, line: LinearisedRun, rows: np.ndarray, values: np.ndarray, ratio: float
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
