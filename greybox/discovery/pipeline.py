"""`discover`: a model, records to learn from and records to judge by in; a verdict with its evidence out."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from greybox.discovery import decision
from greybox.discovery.detection_limits import hidden
from greybox.discovery.discriminating_experiments import DiscriminatingExperiment, rank_discriminating_experiments
from greybox.discovery.effect_signal import estimate_effect_signals
from greybox.discovery.effect_test import estimate_scales, finish_and_validate
from greybox.discovery.execution import RefitExecutor, RefitJournal
from greybox.discovery.holdout import reject_on_validation
from greybox.discovery.holdout_error import HoldoutError, compare_holdout_errors
from greybox.discovery.localisation import ResidualLocalisation, localise_candidate_residual
from greybox.discovery.problem import CandidateFit, DiscoveryProblem
from greybox.discovery.recommendations import recommend_next_steps, recommend_noise_check
from greybox.discovery.residual_noise import (
    KNOWN,
    LEFT_OVER,
    estimate_residual_noise,
    excess_autocorrelation,
    is_noise_known,
)
from greybox.discovery.result import Discovery, RankedCandidate
from greybox.discovery.selection import Say, StepwiseSelection
from greybox.discovery.summary import summarise
from greybox.discovery.surrogate import Surrogate, fit_curve_surrogate
from greybox.discovery.tone_surrogate import fit_tone_surrogate
from greybox.effects import Scales, applicable_effects, tailor_to_record
from greybox.errors import DataError
from greybox.estimation import FitOptions
from greybox.experiment import Experiment
from greybox.model import Effect, Model
from greybox.noise import NoiseModel
from greybox.result import Fit

Records = Experiment | Sequence[Experiment]

# Times that the noise is looked at again, and sets of effects that are refitted then.
ROUNDS, CARRIED = 2, 8
# A curve beside a look-alike must close this much more of the gap than one in its place.
CLEARLY = 0.02
# A misfit shows elsewhere if it is this many times as far above the noise there.
ELSEWHERE = 2.0


@dataclass(frozen=True)
class SelectionEvidence:
    """A finished search: what was chosen, what explains the records as well, and both fits judged on other records.

    ``plain``: the model as the user came with it.
    """

    search: StepwiseSelection
    chosen: CandidateFit
    rivals: Sequence[CandidateFit]
    base: Fit
    best: Fit
    gap: Mapping[str, HoldoutError]
    judges: tuple[Experiment, ...]
    skip: int
    plain: Model

    @property
    def refined(self) -> CandidateFit:
        """The chosen model with the form of its effects corrected, where the records asked for that."""
        return self.search.form.get(frozenset(self.chosen.effects), self.chosen)

    @property
    def worst(self) -> HoldoutError:
        """The output that the plain model misses most, in units of its noise."""
        return max(self.gap.values(), key=lambda g: g.before / g.floor)

    @property
    def verdict(self) -> str:
        """``complete``, ``named``, ``ambiguous`` or ``unknown``."""
        base, chosen = self.search.base, self.refined
        if not chosen.effects:
            seen = base.per_sample > decision.clean_cost_limit(base.count) or self.shows_elsewhere
            return "unknown" if seen else "complete"
        if (
            not decision.is_residual_clean(base, chosen)
            or excess_autocorrelation(chosen) > LEFT_OVER
            or not self.closes
        ):
            return "unknown"
        return "ambiguous" if self.rivals else "named"

    @property
    def closes(self) -> bool:
        """Whether the chosen model closes the gap on the judging records, if there is one: all but a tenth, or down to what noise
        of this level and colour may leave by chance."""
        name, worst = max(self.gap.items(), key=lambda item: item[1].before / item[1].floor)
        if worst.before / worst.floor <= decision.VISIBLE or worst.explained_fraction >= decision.HELD_OUT:
            return True
        return worst.explained_fraction >= decision.PARTLY and worst.after / worst.floor <= self._chance(name)

    def _chance(self, output: str) -> float:
        """Rms over noise that the noise of an output hardly ever exceeds on the judging records."""
        noise = self.search.base.problem.noise
        number = [o.name for o in self.base.model.outputs].index(output)
        return decision.visible_rms_limit(self.base.validation.misfit[output].samples, noise.colour[number])

    @property
    def shows_elsewhere(self) -> bool:
        """Whether the plain model fails on the judging records only."""
        if self.chosen.effects:
            return False
        if self.worst.before / self.worst.floor - 1 < ELSEWHERE * (self.search.base.per_sample**0.5 - 1):
            return False
        return any(g.before / g.floor > self._chance(name) for name, g in self.gap.items())


def discover(
    model: Model,
    estimation: Records,
    *,
    validation: Records,
    noise: Mapping[str, float] | None = None,
    quiet: Records = (),
    effects: Sequence[Effect] | None = None,
    options: FitOptions | None = None,
    say: Say | None = None,
    executor: Executor | None = None,
    workers: int = 0,
    journal: str | Path | None = None,
    report: Callable[[int], None] | None = None,
) -> Discovery:
    """Find which effect, if any, ``model`` lacks.

    Refits the model with each effect of the catalogue that it has a place for (or of ``effects``) to the ``estimation`` records,
    keeps what the data demand, and judges it on the ``validation`` records, which no constant has seen. An effect that shows in
    the validation records only (a saturation that the estimation input never reaches) is learnt from their first half and
    judged on the second.

    ``executor``: where the refits run, for example ``Client.get_executor()`` of Dask; None for this machine, where a long search uses
    ``workers`` processes (0: one for each core). ``journal``: a file in which every finished refit is kept, so that the same call
    goes on where an earlier one was interrupted. ``say`` is called with a line about each step, ``report`` after each
    refit with the number of those that are done.

    Raises DataError where there is nothing to judge by, for records that do not go with the model, and for a file that is no journal.
    """
    began = time.perf_counter()
    options, say = options or FitOptions(), say or _silent
    judges = _several(validation)
    if not judges:
        raise DataError(
            "no validation record: a discovery is judged on data that no constant has seen; give at least one, another run or the"
            " end of this one (shell: --validate FILE)"
        )
    refits = RefitExecutor(executor, workers, RefitJournal(Path(journal)) if journal else None, report)
    with refits.open():
        bench = DiscoveryProblem(model, _several(estimation), dict(noise or {}), _several(quiet), options, refits)
        return _found(bench, judges, effects, say, began)


def _found(
    bench: DiscoveryProblem, judges: tuple[Experiment, ...], effects: Sequence[Effect] | None, say: Say, began: float
) -> Discovery:
    scales = estimate_scales(bench.base)
    candidates = [tailor_to_record(e, scales) for e in effects] if effects else applicable_effects(bench.plain, scales)
    found, notes = _evidence(bench, candidates, scales, judges, 0, say), []
    if found.shows_elsewhere and bench.options.at_rest:
        say("the plain model fails on the validation records only: learning from their first half")
        half = min(j.rows for j in judges) // 2
        wider = replace(bench, experiments=(*bench.experiments, *(j.window(0, half) for j in judges)))
        found = _evidence(wider, candidates, scales, judges, half, say)
        notes.append(
            "the effect does not show in the estimation records: it was learnt from the first half of the validation records"
        )
    return _discovery(found, notes, time.perf_counter() - began)


def _evidence(
    bench: DiscoveryProblem,
    candidates: Sequence[Effect],
    scales: Scales,
    judges: tuple[Experiment, ...],
    skip: int,
    say: Say,
) -> SelectionEvidence:
    say(f"plain model: misfit {bench.base.per_sample**0.5:.3g} times the noise")
    search = StepwiseSelection(bench, candidates, scales, say)
    if is_noise_known(bench.base.problem.noise, bool(bench.quiet)):
        chosen = search.run()
    else:
        search, chosen = _with_unknown_noise(search, say)
    if chosen.effects:
        chosen = reject_on_validation(search.bench, search.base, chosen, list(search.tried.values()), judges, skip)
    rivals = search.rivals(chosen) if chosen.effects else []
    final = search.form.get(frozenset(chosen.effects), chosen)
    base, best = (finish_and_validate(t, bench, judges, skip) for t in (search.base, final))
    return SelectionEvidence(
        search, chosen, rivals, base, best, compare_holdout_errors(base, best), judges, skip, bench.plain
    )


def _with_unknown_noise(search: StepwiseSelection, say: Say) -> tuple[StepwiseSelection, CandidateFit]:
    """The search with the noise that the best single effect leaves over, and again with the one that the chosen model leaves."""
    given = all(source in KNOWN for source in search.base.problem.noise.sources.values())
    chosen = search.run() if given else search.first()
    for _ in range(ROUNDS):
        noise = estimate_residual_noise(chosen)
        if _same(noise, chosen.problem.noise):
            if given:
                break
            say("the residual is white")
        else:
            say(f"noise as the residual of {chosen.model.title} shows it: {', '.join(map(str, noise.colour))}")
        bench = replace(search.bench, noise=noise, plain=search.base.model)
        search = StepwiseSelection(bench, _best(search), search.scales, say, search.tried)
        before, chosen = chosen, search.run()
        if before.effects == chosen.effects:
            break
    return search, chosen


def _same(noise: NoiseModel, before: NoiseModel) -> bool:
    """Whether a second look at the noise changes nothing: white as before, and of the same level."""
    level = np.allclose(noise.std, before.std, rtol=0.05)
    return level and all(a.reflection == b.reflection for a, b in zip(noise.colour, before.colour, strict=True))


def _best(search: StepwiseSelection) -> list[Effect]:
    """The candidates that did best, in catalogue order, with their parents and children: the others are out of the running."""
    ranked = sorted(search.tried.values(), key=lambda t: t.criterion)
    names = {name for t in ranked[:CARRIED] for name in t.effects}
    family = names | {parent for e in search.candidates if e.name in names for parent in e.parents}
    return [e for e in search.candidates if e.name in family]


def _discovery(found: SelectionEvidence, notes: Sequence[str], seconds: float) -> Discovery:
    verdict, chosen, search = found.verdict, found.chosen, found.search
    trials = sorted(search.tried.values(), key=lambda t: t.criterion)
    ranking = [RankedCandidate(t.effects, t.per_sample**0.5, t.criterion - trials[0].criterion) for t in trials]
    look = localise_candidate_residual(search.base)
    tests = [s[0] for rival in found.rivals if (s := rank_discriminating_experiments(search.bench, chosen, rival))]
    limits = hidden(search.singles) if verdict == "complete" else []
    curve = _stand_in(found) if verdict == "unknown" else None
    steps = (
        _next(found, look, curve)
        if verdict == "unknown"
        else recommend_noise_check(found.base)
        if verdict == "complete"
        else ()
    )
    signals = estimate_effect_signals(search.bench, chosen) if chosen.effects else ()
    if found.refined is not chosen and verdict != "unknown":
        added = " + ".join(e for e in found.refined.effects if e not in chosen.effects)
        notes = (
            *notes,
            f"the family is sure, its form is not quite that of {' + '.join(chosen.effects)}: {added} corrects it",
        )
    return Discovery(
        verdict, found.base, found.best, [t.effects for t in found.rivals], found.gap, ranking, look,
        summarise(verdict, chosen, found.rivals, found.gap, look, curve), (*notes, *map(_told, tests), *limits), seconds, signals, curve,
        next_steps=steps,
    )  # fmt: skip


def _stand_in(found: SelectionEvidence) -> Surrogate | None:
    """A tone or a smooth curve for all that the plain model lacks. Where that is not enough, and the nearest look-alike explains the
    larger part, one for what this leaves over, if the two together do clearly better. Nothing that closes less than the look-alike."""
    search, chosen = found.search, found.chosen
    helps = found.worst.explained_fraction > decision.PARTLY and chosen.effects
    bench, best = replace(search.bench, plain=found.plain), None
    for trial in (search.base, chosen) if helps else (search.base,):
        if best is not None and best.explained_fraction >= decision.HELD_OUT:
            break
        given = (bench, trial, localise_candidate_residual(trial), found.judges, found.base, found.skip)
        made = fit_tone_surrogate(*given) or fit_curve_surrogate(*given)
        if made is None or (helps and made.explained_fraction < found.worst.explained_fraction):
            continue
        if best is None or made.explained_fraction > best.explained_fraction + CLEARLY:
            best = made
    return best


def _next(found: SelectionEvidence, look: ResidualLocalisation, made: Surrogate | None) -> tuple[str, ...]:
    """What to do next about something unknown; a look-alike is gone on with where nothing that stands in does better."""
    close = found.worst.explained_fraction >= decision.HELD_OUT and (
        made is None or made.explained_fraction < decision.HELD_OUT
    )
    nearest = " + ".join(found.chosen.effects) if close else ""
    return recommend_next_steps(found.base, look, made, found.judges, nearest)


def _told(test: DiscriminatingExperiment) -> str:
    rival = " + ".join(test.rival)
    if test.cost < decision.TIE:
        return f"no experiment tried would tell {rival} apart with these sensors (at best chi-square {test.cost:.2g})"
    return str(test)


def _silent(_: str) -> None:
    return None


def _several(records: Records) -> tuple[Experiment, ...]:
    return (records,) if isinstance(records, Experiment) else tuple(records)
