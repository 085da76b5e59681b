"""How often a signal without meaning would have been established here in the place of an effect: a false-name rate for these records.

A signal is made from the record itself: what an effect of the answer adds at its place, shifted in time by some correlation lengths and run
backwards, or with the phases of its spectrum drawn at random (J. Theiler and others 1992, Testing for nonlinearity in time series: the
method of surrogate data, Physica D 58). It keeps size and spectrum and says nothing of the plant. As a knockoff does for a
regression (R. F. Barber, E. J. Candes 2015, Controlling the false discovery rate via knockoffs, Ann. Statist. 43) it runs the course of a
physical effect: as many as there were candidates are screened by one Gauss-Newton step, and the one that promises most stands on the table
with all sets but those of the effect and its family. Is it established there, the records would have borne out a name for nothing.

It is screened by the response of the run of the answer without the effect, linearised. What promises to take less of the error than any
claim must take is out, and so is what would leave too much beside the answer; the others are fitted as rivals are, each as an input of its
own beside those of the records.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from typing import Any, ClassVar

import numpy as np

from greybox.base.numerics import TINY
from greybox.base.values import ReadOnly
from greybox.data.noise.noise_model import fit_autoregression
from greybox.discovery.claims import (
    ESTABLISHED_FROM,
    LEAST_SHARE,
    Claim,
    Depth,
    Weights,
    describe_effect,
    name_claim,
    weigh_claim,
    weigh_claims,
)
from greybox.discovery.decision import Grade
from greybox.discovery.disturbance_sites import (
    DisturbanceSite,
    SiteKind,
    linearise_run,
    list_disturbance_sites,
    respond,
)
from greybox.discovery.effect_signal import EffectSignal
from greybox.discovery.execution import SearchStage
from greybox.discovery.holdout import HoldoutScores, measure_structure
from greybox.discovery.linear import promise_decrease
from greybox.discovery.problem import FittedCandidate
from greybox.discovery.search import HOPELESS_COST
from greybox.discovery.surrogate_effects import SOURCE
from greybox.discovery.table import FitTable, FittedSet, LinearisedSet, draw_sets, linearise_set
from greybox.model import Effect, Model
from greybox.model.effects.catalogue import AT
from greybox.model.signals import Expression, Input, NamedValues, Parameter

# Contests at first: of eleven that nothing wins the rate is below 24 % with 95 % confidence, less than an established claim may be wrong.
FIRST_CONTESTS = 11
# ...and in all, where these leave open whether nonsense is established more often.
CONTESTS = 20
# Signals of a contest at most, of which the one that promises most takes part: as many as effects were candidates.
MOST_SIGNALS = 40
# Values of signals that are screened side by side: 24 MB.
SCREENED_VALUES = 3e6
# A shift by less than so many correlation lengths leaves some of the meaning in.
LEAST_SHIFT = 3.0
# ...but a signal that remembers itself for long is shifted by this share of it: more is hardly possible on a circle.
MOST_SHIFT = 0.25
# Correlation with the effect's own signal from which a draw is repeated, and how often: it would be the effect under another name.
MOST_ALIKE, REDRAWS = 0.5, 20
# Share of its rms that varies, and samples, from which an effect's signal can lose its meaning.
LEAST_VARIATION, LEAST_KNOTS = 0.1, 8
# Seed of the signals: the same records give the same answer.
SEED = 2
# Confidence of the bound on the rate.
CONFIDENCE = 0.95
# Effects of an answer that are tried, those of which most is claimed: each costs as much as its rivals.
MOST_EFFECTS = 2
# Iterations of the refit of a signal, as of a rival.
SIGNAL_ITERATIONS = 30
# The name of a signal without meaning as an effect, of its size, and of the input that carries its course.
MEANINGLESS, SIZE, COURSE = "meaningless_signal", "size", "course"


@dataclass(frozen=True)
class FalseNameRate(ReadOnly):
    """How often signals without meaning would have been established in the place of one effect.

    Parameters
    ----------
    effect
        The effect of the answer whose place they took.
    depth
        Of the claim that they competed for: the deepest about the effect that is at least probable.
    tried, established
        Contests, and how many of them a signal won so clearly that its claim is established.
    among
        Signals of each contest, of which the one that promised most took part.
    """

    effect: str
    depth: Depth
    tried: int
    established: int
    among: int

    KEYS: ClassVar[str] = "effect depth tried established among rate upper"

    @property
    def rate(self) -> float:
        """Share of the contests in which a signal was established."""
        return self.established / self.tried

    @property
    def upper(self) -> float:
        """The largest rate that goes with this, one-sided, with 95 % confidence (C. J. Clopper, E. S. Pearson 1934)."""
        from scipy.special import betaincinv

        if self.established == self.tried:
            return 1.0
        # P(X <= k) = 1 - I_p(k + 1, n - k).
        return float(betaincinv(self.established + 1, self.tried - self.established, CONFIDENCE))

    @property
    def is_common(self) -> bool:
        """Whether nonsense is established more often than an established claim may be wrong."""
        return self.rate > 1 - ESTABLISHED_FROM


@dataclass(frozen=True, eq=False)
class ContestTable:
    """What signals without meaning compete with.

    Parameters
    ----------
    table, candidates
        The sets that were fitted, and those of them that take part.
    answer
        The one whose effects they take the places of.
    alike_sites
        Labels of sites in groups that the sensors cannot tell apart.
    tried
        How many effects were candidates.
    """

    table: FitTable
    candidates: Sequence[FittedCandidate]
    answer: FittedCandidate
    alike_sites: Sequence[Sequence[str]]
    tried: int


def measure_false_names(
    contests: ContestTable,
    without: Mapping[str, FittedCandidate],
    signals: Sequence[EffectSignal],
    claims: Sequence[Claim],
) -> tuple[FalseNameRate, ...]:
    """The rate of the effects of the answer of which most is claimed, where more than the place is at least probable.

    Parameters
    ----------
    contests
        The table with all that takes part.
    without
        By effect, the answer without it.
    signals
        The signals of the effects of the answer.
    claims
        What is claimed.

    Returns
    -------
    tuple of FalseNameRate
        None for an effect whose signal or place is not known, and for one that the end of the time cut short.
    """
    rates, failures = [], contests.table.scores.problem.failures
    usable = [s for s in signals if s.effect in without and _varies(s)]
    depths = {s.effect: _deepest_claim(contests.answer.model, s, claims) for s in usable}
    deepest = sorted((s for s in usable if depths[s.effect]), key=lambda s: depths[s.effect] or 0, reverse=True)
    for number, signal in enumerate(deepest[:MOST_EFFECTS]):
        depth = depths[signal.effect]
        if depth is not None:
            hold = partial(_hold_contests, contests, without[signal.effect], signal, depth, number)
            rates.append(failures.attempt(SearchStage.FALSE_NAMES, (signal.effect,), hold, None))
    return tuple(rate for rate in rates if rate is not None)


def list_nonsense_sites(rates: Sequence[FalseNameRate], model: Model) -> frozenset[str]:
    """Labels of the sites at which nonsense would earn an effect's claims as well.

    An established claim may be wrong in one case of four. Where signals without meaning are established more often than that, being
    established says nothing there: neither of the name, nor of the family and the variables, which a signal over time has not.
    """
    common = {rate.effect for rate in rates if rate.is_common}
    return frozenset(describe_effect(model, b).site for b in model.bound_effects if b.effect.name in common)


def _deepest_claim(model: Model, signal: EffectSignal, claims: Sequence[Claim]) -> Depth | None:
    """The depth of what says most of an effect and is at least probable; None where that is no more than its place."""
    bound = next(b for b in model.bound_effects if b.effect.name == signal.effect)
    form = describe_effect(model, bound)
    likely = [c for c in claims if c.grade in (Grade.ESTABLISHED, Grade.PROBABLE) and form.site in c.sites]
    made = {
        Depth.VARIABLES: [c for c in likely if c.depth is Depth.VARIABLES and c.variables == form.variables],
        Depth.FAMILY: [c for c in likely if c.depth is Depth.FAMILY and c.family == form.family],
        Depth.NAME: [c for c in likely if c.depth is Depth.NAME and c.name == form.name],
    }
    return max((depth for depth, each in made.items() if each), default=None)


def _hold_contests(
    contests: ContestTable, rest: FittedCandidate, signal: EffectSignal, depth: Depth, number: int
) -> FalseNameRate | None:
    """The contests for the place of one effect; None where it cannot be said what a signal does there."""
    table, among = contests.table, min(contests.tried, MOST_SIGNALS)
    sites = list_disturbance_sites(rest.model, [o.name for o in rest.model.outputs])
    site = next((s for s in sites if s.label == signal.site), None)
    slopes = table.slopes(rest)
    if site is None or slopes is None:
        return None
    model = contests.answer.model
    bound = next(b for b in model.bound_effects if b.effect.name == signal.effect)
    # The name of the effect without its place, and those of its family.
    relatives = {signal.effect.partition(AT)[0], *describe_effect(model, bound).family}
    others = [c for c in contests.candidates if not relatives & {name.partition(AT)[0] for name in c.effects}]
    sets = [FittedSet(c, sums) for c in others if (sums := table.sums(c)) is not None]
    # What promises less than any claim must take is out, and so is what would leave too much to come near the answer.
    enough = max(LEAST_SHARE, 1 - HOPELESS_COST * contests.answer.cost / max(rest.cost, TINY))
    starts, established, tried = _screen(slopes, site, signal, among, number), 0, 0
    for count in (FIRST_CONTESTS, CONTESTS - FIRST_CONTESTS):
        drawn = list(islice(starts, count))
        scores, fits = _refit(table.scores, rest, site, [start for start in drawn if start.promised >= enough])
        if fits is None:
            return None
        tried += len(drawn)
        for fit in fits:
            made = linearise_set(scores, fit, table.blocks)
            sums = None if made is None else made.sum_blocks()
            if sums is None:
                continue
            draws = draw_sets([*sets, FittedSet(fit, sums)])
            leading = draws.sets[Weights.of(draws).leading].candidate
            left = measure_structure(scores if leading is fit else table.scores, leading, only_visible=True)
            named = name_claim(weigh_claims(draws, contests.alike_sites, fit.given, left), MEANINGLESS)
            # Its name is its family and its variable as well: the same sets win, and the map of that depth says what that is worth.
            established += named is not None and weigh_claim(replace(named, depth=depth)) >= ESTABLISHED_FROM
        # Settled: none, or more already than may be of all.
        if not established or established > (1 - ESTABLISHED_FROM) * CONTESTS:
            break
    return FalseNameRate(signal.effect, depth, tried, established, among)


@dataclass(frozen=True, eq=False)
class _Start:
    """The best signal of a contest: its ``courses`` (N,) over all records, and the share of the cost that it promises to take."""

    courses: Sequence[np.ndarray]
    promised: float


def _screen(
    slopes: LinearisedSet, site: DisturbanceSite, signal: EffectSignal, among: int, number: int
) -> Iterator[_Start]:
    """For one contest after the other the signal that promises most in one Gauss-Newton step."""
    candidate, rng = slopes.candidate, np.random.default_rng([SEED, number])
    records = candidate.problem.experiments
    lines = [linearise_run(candidate, e, 0, record.rows) for e, record in enumerate(records[: slopes.fitted])]
    cost = sum(float((r**2).sum()) for r in slopes.residuals[: slopes.fitted])
    # Side by side, as the model is stepped along the records once for all of them.
    at_once = int(np.clip(SCREENED_VALUES // (among * sum(line.rows for line in lines)), 1, FIRST_CONTESTS))
    while True:
        drawn = [[_draw_signals(signal, record.time, among, rng) for record in records] for _ in range(at_once)]
        responses = [
            respond(line, site, np.concatenate(courses, axis=1)) / candidate.problem.noise.std[:, None]
            for line, courses in zip(lines, zip(*drawn, strict=True), strict=False)
        ]
        promised = promise_decrease(slopes, responses).decrease.reshape(at_once, -1)
        for courses, each in zip(drawn, promised, strict=True):
            best = int(np.argmax(each))
            yield _Start([w[:, best] for w in courses], float(each[best]) / max(cost, TINY))


def _refit(
    scores: HoldoutScores, rest: FittedCandidate, site: DisturbanceSite, starts: Sequence[_Start]
) -> tuple[HoldoutScores, list[FittedCandidate] | None]:
    """Each signal fitted as a rival is, and the records that hold them; None where the time was over before the last."""
    problem, executor = scores.problem, scores.problem.executor
    courses = [f"{COURSE}_{k}" for k in range(len(starts))]
    records = tuple(
        replace(r, inputs={**r.inputs, **{name: start.courses[e] for name, start in zip(courses, starts, strict=True)}})
        for e, r in enumerate((*problem.experiments, *scores.validation.records))
    )
    fitted, judging = records[: len(problem.experiments)], records[len(problem.experiments) :]
    # Nonsense is on no table but its own, and where it is not reached no rival of the answer was left out.
    noise, options, skipped = problem.noise_model, problem.refit_options, executor.skipped
    wide = replace(problem, experiments=fitted, noise=noise, options=options, quiet=(), fitted=[])
    models = [
        replace(rest.model, inputs=(*rest.model.inputs, Input(course, site.unit))) + _make_effect(site, course)
        for course in courses
    ]
    jobs = [wide.plan_refit(m, [m.values], 1, SIGNAL_ITERATIONS, rest, refines=False) for m in models]
    fits = wide.refit_all(jobs)
    is_cut, executor.skipped = executor.skipped > skipped, skipped
    within = HoldoutScores(wide, replace(scores.validation, records=judging))
    return within, None if is_cut else [fit for fit in fits if fit is not None]


def _draw_signals(signal: EffectSignal, time: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Signals (N, ``count``) without meaning at ``time`` (N,): half of random phase, half shifted, and half of these backwards.

    They are as large as what varies of the effect: a constant says the same wherever it is shifted to, and is a rival of its own.
    """
    grid, values = _even_out(signal)
    period = np.ptp(grid) * len(grid) / (len(grid) - 1)
    # sum_k |rho_k|: samples over which a series remembers itself.
    correlation = fit_autoregression(values).autocorrelation(len(values) // 2)
    memory = float(np.abs(correlation).sum()) * period / len(values)
    least = min(LEAST_SHIFT * memory, MOST_SHIFT * period)
    amplitude = np.abs(np.fft.rfft(values))
    passed, since = time - time[0], grid - grid[0]
    signals = np.empty((len(time), count))
    for k in range(count):
        for _ in range(REDRAWS):
            if k % 2:
                phases = np.exp(2j * np.pi * rng.random(len(amplitude)))
                drawn = np.fft.irfft(amplitude * phases, len(values))
            else:
                drawn = values[::-1] if k % 4 else values
            shift = rng.uniform(least, period - least)
            again = np.interp(since + shift, since, drawn, period=period)
            # A signal that repeats comes back to itself.
            if abs(again @ values) <= MOST_ALIKE * (values @ values):
                break
        signals[:, k] = np.interp(passed + shift, since, drawn, period=period)
    return signals


def _even_out(signal: EffectSignal) -> tuple[np.ndarray, np.ndarray]:
    """What varies of an effect's signal on the fitted run, at even times: these and its values (K,)."""
    added = signal.modelled if np.isfinite(signal.modelled).all() else signal.value
    grid = np.linspace(signal.time[0], signal.time[-1], len(signal.time))
    values = np.interp(grid, signal.time, added)
    return grid, values - values.mean()


def _varies(signal: EffectSignal) -> bool:
    """Whether an effect adds more than a constant."""
    rms = float(np.sqrt(np.mean(signal.modelled**2)))
    return len(signal.time) > LEAST_KNOTS and float(np.std(_even_out(signal)[1])) > LEAST_VARIATION * rms


def _make_effect(site: DisturbanceSite, course: str) -> Effect:
    """The signal of the input ``course`` as an effect at ``site``; its size is its one constant."""

    def term(x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
        return p[SIZE] * u[course]

    def with_term(value: Expression, x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
        return value + term(x, u, p)

    options: dict[str, Any] = {"terms": term}
    if site.kind is not SiteKind.BALANCE:
        options = {"on_input" if site.kind is SiteKind.INPUT else "on_output": with_term}
    parameter = Parameter(
        SIZE, "1", 0.0, source=SOURCE, description="size over that of the effect in whose place it is"
    )
    return Effect(MEANINGLESS, site.name, [parameter], amplitudes=(SIZE,), source=SOURCE, **options)
