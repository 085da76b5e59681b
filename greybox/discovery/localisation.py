"""`localise_residual`: where, when and in which region model and data disagree."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from greybox.discovery import decision
from greybox.discovery.dependence import WORTH, Dependence, rank_dependences
from greybox.discovery.disturbance_sites import (
    INPUT,
    SENSOR,
    DisturbanceSite,
    LinearisedRun,
    are_indistinguishable,
    linearise_run,
    list_disturbance_sites,
    unwhitened_shooting,
)
from greybox.discovery.misfit_windows import MisfitWindow, divide_misfit, told
from greybox.discovery.problem import CandidateFit, DiscoveryProblem
from greybox.discovery.signal_smoother import SignalSmoother, SmoothedSignal, absorbed_basis, whiten_columns
from greybox.model import Model
from greybox.result import Fit
from greybox.values import ReadOnly

# Rows of the stretch in which the signal is estimated: where the misfit is largest.
MOST_ROWS = 1200
# A place leads only if its log-likelihood is this far ahead, or this share of what it gained.
LEAD, LEAD_SHARE = 10.0, 0.001
# A reading takes the place of the model's run from so many noise deviations between them.
READ = 2.0


@dataclass(frozen=True)
class RankedSite:
    """A place of the model and how much likelier the residual is with an unknown signal there.

    ``kind``: ``balance``, ``input`` or ``sensor``; ``gain`` in nats; ``size``: rms of the signal that is needed there, in ``unit``.
    """

    name: str
    kind: str
    gain: float
    size: float
    unit: str

    def __str__(self) -> str:
        return f"{self.kind} {self.name}" if self.kind != "sensor" else f"sensor of {self.name}"


@dataclass(frozen=True, eq=False)
class ResidualSignal(ReadOnly):
    """The unexplained signal at ``site`` in a stretch of ``record``: ``time``, ``value`` and ``std`` (K,) in ``unit``.

    ``variables``: name -> values (K,) of every state and input there, ``units`` theirs; of a measured state that the model misses the
    readings. What is constant or proportional to what the
    model's constants already multiply is not in it: the fit has absorbed that.
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
class ResidualLocalisation(ReadOnly):
    """What a fitted model leaves over.

    ``misfit``: rms over noise on the records it was fitted to, ``threshold`` the largest that chance explains, ``missing`` whether
    something is. ``sites``: likeliest first; ``sets``: the same in sets that the sensors cannot separate. ``windows``: when. ``signal``:
    at the likeliest site, with ``regions``: as a function of what, best first. Without anything missing the last four are empty.
    """

    misfit: float
    threshold: float
    sites: tuple[RankedSite, ...]
    sets: tuple[tuple[str, ...], ...]
    windows: tuple[MisfitWindow, ...]
    signal: ResidualSignal | None
    dependences: tuple[Dependence, ...]

    @property
    def missing(self) -> bool:
        """Whether more than noise is left."""
        return self.misfit > self.threshold

    @property
    def where(self) -> tuple[str, ...]:
        """The likeliest site with those that cannot be told from it; empty where none explains anything."""
        return self.sets[0] if self.sets and self.sites[0].gain > LEAD else ()

    def __str__(self) -> str:
        lines = [f"misfit {self.misfit:.4g} times the noise; noise alone stays below {self.threshold:.4g}"]
        if not self.missing:
            return "\n".join([*lines, "nothing is missing"])
        lines.append(f"when:  {told(self.windows)}")
        if self.where:
            size = f", {self.sites[0].size:.3g} {self.sites[0].unit} rms" if self.sites[0].unit else ""
            lines.append(f"where: {describe_likeliest_site(self)}{size}")
        worth = [r for r in self.dependences if r.share + r.loop > WORTH][:3]
        lines.append(f"as:    {'; '.join(map(str, worth)) if worth else 'no function of any one variable'}")
        return "\n".join(lines)


def describe_likeliest_site(found: ResidualLocalisation) -> str:
    """The likeliest set in words."""
    if len(found.where) > 1:
        return f"{' or '.join(found.where)} (the sensors cannot tell)"
    return found.where[0] if found.where else "no place in particular"


def localise_residual(fit: Fit) -> ResidualLocalisation:
    """Look at what ``fit`` leaves over: the first of the three steps by hand (look, `try_effect`, ``model + effect``).

    At each balance, input and sensor in turn an unknown slowly varying signal is estimated in the stretch where the misfit is
    largest, with the fitted constants and the initial state projected out, and the places are ranked by likelihood. Says also when
    the misfit happens, and as a function of what. The model is linearised along its run.
    """
    return localise_candidate_residual(to_candidate_fit(fit))


def to_candidate_fit(fit: Fit) -> CandidateFit:
    """A fit as a trial: the same records, noise and options, at its constants."""
    return DiscoveryProblem.of(fit).at(fit)


def localise_candidate_residual(trial: CandidateFit) -> ResidualLocalisation:
    """`localise_residual` for a refitted model."""
    residuals = normalised_residuals(trial)
    experiments = trial.problem.experiments
    misfit, threshold = trial.per_sample**0.5, decision.clean_cost_limit(trial.count) ** 0.5
    if misfit <= threshold:
        return ResidualLocalisation(misfit, threshold, (), (), (), None, ())
    when = divide_misfit([e.name for e in experiments], [e.time for e in experiments], residuals)
    line = linearise_run(trial, *find_worst_stretch(residuals))
    ranked = _ranked(trial, line)
    if not ranked:
        return ResidualLocalisation(misfit, threshold, (), (), when, None, ())
    sites = tuple(RankedSite(p.name, p.kind, s.gain, float(np.sqrt(np.mean(s.value**2))), p.unit) for p, s in ranked)
    signal = _signal(trial, line, *ranked[0])
    variables = {name: (values, signal.units[name]) for name, values in signal.variables.items()}
    run = np.column_stack([line.x, line.u])[ranked[0][1].rows]
    return ResidualLocalisation(
        misfit,
        threshold,
        sites,
        _sets(sites),
        when,
        signal,
        tuple(rank_dependences(signal.time, signal.value, variables, run)),
    )


def estimate_site_signals(trial: CandidateFit) -> dict[str, ResidualSignal]:
    """The unexplained signal as it would be at each place of the model, in the stretch with the largest misfit; likeliest first."""
    line = linearise_run(trial, *find_worst_stretch(normalised_residuals(trial)))
    return {str(place): _signal(trial, line, place, smoothed) for place, smoothed in _ranked(trial, line)}


def normalised_residuals(trial: CandidateFit) -> list[np.ndarray]:
    """Residual over noise (N, ny) of each record."""
    return [r for r, _ in unwhitened_shooting(trial).residuals(np.zeros(trial.variables.size))]


def find_worst_stretch(residuals: Sequence[np.ndarray]) -> tuple[int, int, int]:
    """Record, first row and rows of the stretch with the largest misfit."""
    best, found = -1.0, (0, 0, 1)
    for e, r in enumerate(residuals):
        rows = min(MOST_ROWS, len(r))
        sums = np.concatenate([[0.0], np.cumsum(np.nansum(r**2, axis=1))])
        inside = sums[rows:] - sums[:-rows]
        if inside.max() > best:
            best, found = float(inside.max()), (e, int(np.argmax(inside)), rows)
    return found


def _ranked(trial: CandidateFit, line: LinearisedRun) -> list[tuple[DisturbanceSite, SmoothedSignal]]:
    """Every place with the signal that the residual asks for there, likeliest first."""
    r, jacobian = unwhitened_shooting(trial).residuals(np.zeros(trial.variables.size))[line.record]
    stretch = slice(line.first, line.first + line.rows)
    r, jacobian = r[stretch], jacobian[stretch]
    present = np.isfinite(r)
    noise = trial.problem.noise
    seen = whiten_columns(r[:, :, None], noise.colour, present)[present][:, 0]
    absorbing = whiten_columns(np.nan_to_num(jacobian), noise.colour, present)
    basis = absorbed_basis(line, 1 / noise.std, noise.colour, absorbing, present)
    measured = [o.name for o, there in zip(trial.model.outputs, present.any(axis=0), strict=True) if there]
    found: list[tuple[DisturbanceSite, SmoothedSignal]] = []
    for place in list_disturbance_sites(trial.model, measured):
        same = next(((p, t) for p, t in found if are_indistinguishable(line.gamma[p], line.gamma[place])), None)
        if same is None:
            signal = SignalSmoother.of(line, place, 1 / noise.std, noise.colour, basis, present).smooth(seen)
        else:  # the same signal in another unit
            ratio = float(np.linalg.norm(line.gamma[same[0]]) / np.linalg.norm(line.gamma[place]))
            signal = replace(same[1], value=ratio * same[1].value, std=ratio * same[1].std)
        found.append((place, signal))
    # Of places that cannot be told apart the balance comes first: that is where most physics is. Their gains differ by rounding.
    return sorted(found, key=lambda one: (-float(f"{one[1].gain:.6g}"), one[0].kind == INPUT))


def signal_units(model: Model) -> dict[str, str]:
    """Unit of each state and input by name."""
    found = {s.name: s.unit for s in model.all_states}
    return found | {i.name: i.unit for i in model.inputs}


def _sets(sites: Sequence[RankedSite]) -> tuple[tuple[str, ...], ...]:
    """Sites in sets within a lead of their first, likeliest first."""
    found: list[list[RankedSite]] = []
    for site in sites:
        if found and found[-1][0].gain - site.gain <= max(LEAD, LEAD_SHARE * found[-1][0].gain):
            found[-1].append(site)
        else:
            found.append([site])
    return tuple(tuple(str(s) for s in group) for group in found)


def _signal(
    trial: CandidateFit, line: LinearisedRun, place: DisturbanceSite, smoothed: SmoothedSignal
) -> ResidualSignal:
    model, rows = trial.model, smoothed.rows
    names = [*model.system.state_names, *(i.name for i in model.inputs)]
    values = np.column_stack([line.x, line.u])[rows]
    if place.kind != SENSOR:
        _as_measured(trial, line, rows, values)
    units = signal_units(model)
    return ResidualSignal(
        str(place), place.unit, trial.problem.experiments[line.record].name, line.time[rows], smoothed.value, smoothed.std,
        dict(zip(names, values.T, strict=True)), units,
    )  # fmt: skip


def _as_measured(trial: CandidateFit, line: LinearisedRun, rows: np.ndarray, values: np.ndarray) -> None:
    """Put the readings of measured states into ``values`` (K, nx + nu) where the model's run is farther off than they are."""
    model, experiment = trial.model, trial.problem.experiments[line.record]
    for j, output in enumerate(model.outputs):
        equation = model.system.outputs[j]
        if output.name not in experiment.outputs or not equation.is_symbolic():
            continue
        read = experiment.outputs[output.name][line.first + rows]
        if equation.name() in model.system.state_names and np.isfinite(read).all():
            column = model.system.state_names.index(equation.name())
            off = float(np.sqrt(np.mean((read - values[:, column]) ** 2)))
            if off > READ * trial.problem.noise.std[j]:
                values[:, column] = read
