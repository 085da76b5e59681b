"""Going on: further effects on measured records, where each may be small beside the first and nothing ever reaches the noise.

A search over simulated rigs ends at the noise. Measured records hardly do: what an electronic circuit or a tank does beyond its
first two effects lies a hundred times below the first misfit and still above the noise. Here an effect is demanded if it takes a
share of what is *left* on the records that are fitted, and on validation records, which none of its constants has seen. Where
several do, the validation records decide. They are thereby used for the choice: the figure to quote comes from a third record.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from greybox.discovery import decision
from greybox.discovery.effect_test import estimate_scales, finish_and_validate
from greybox.discovery.execution import RefitExecutor, RefitJournal
from greybox.discovery.holdout import score_holdout
from greybox.discovery.problem import CandidateFit, DiscoveryProblem, StartValues
from greybox.discovery.shape_correction import is_shape_correction
from greybox.discovery.starting_points import generate_starting_points
from greybox.effects import Scales, applicable_effects, tailor_to_record
from greybox.experiment import Experiment
from greybox.model import Effect, Model
from greybox.noise import AutoRegression
from greybox.result import Fit
from greybox.values import ReadOnly

# Share of the rms misfit that is left which a further effect must take away, on the fitted and on the validation records.
FITTED, HELD_OUT = 0.02, 0.05
# Models whose misfit is within this share of each other explain a measured record alike, whatever their likelihood.
ALIKE = 0.1
# Effects added at most, candidates refitted for each, starts of each.
MOST, PROMISING, KEPT = 5, 8, 2

Say = Callable[[str], None]


@dataclass(frozen=True)
class RefinementStep:
    """One further effect: its name, the share of the rms misfit that it takes away on the fitted and on the validation records, and
    what does nearly as well in its place (``alike``: with what share on the validation records)."""

    name: str
    fitted: float
    held_out: float
    alike: Mapping[str, float]

    def __str__(self) -> str:
        also = ", ".join(f"{name} {100 * share:.0f} %" for name, share in self.alike.items())
        text = f"{self.name}: takes {100 * self.fitted:.0f} % of the misfit, {100 * self.held_out:.0f} % of that on the validation records"
        return text + (f" (nearly as well: {also})" if also else "")


@dataclass(frozen=True, eq=False)
class Refinement(ReadOnly):
    """What `refine` found: the fit with all effects, its misfit on the validation records, and each step there."""

    fit: Fit
    steps: tuple[RefinementStep, ...]

    @property
    def story(self) -> str:
        """What comes after the named effects, in one sentence, and what the validation records are worth then."""
        if not self.steps:
            return "Nothing further: no other effect takes a share of what is left on records that its constants have not seen."
        return (
            f"Further, of what is left: {'; '.join(map(str, self.steps))}. The validation records have chosen them: quote the"
            " misfit on another record."
        )

    def __str__(self) -> str:
        return "\n".join([*map(str, self.steps), str(self.fit)]) if self.steps else f"nothing further\n{self.fit}"


def refine(
    fit: Fit,
    validation: Experiment | Sequence[Experiment],
    *,
    plain: Model | None = None,
    effects: Sequence[Effect] | None = None,
    most: int = MOST,
    say: Say | None = None,
    journal: str | Path | None = None,
    report: Callable[[int], None] | None = None,
) -> Refinement:
    """Effects that the model of ``fit`` still lacks, one at a time, ``most`` at most.

    ``fit``: of a model that already has its large effects, as `discover` gives them (``found.best``). It is refitted to the same
    records with white noise of the level of its own residual: what is left is structure, and the free run is to follow it.
    ``validation``: records that none of the constants has seen. ``plain``: a model whose catalogue of candidates counts, by default
    that of ``fit``; or ``effects``, the only candidates. Curves and second branches that refine the form of an effect are taken out first:
    here they would stand in the way of a name. ``say``, ``journal`` and ``report`` as in `discover`.

    Raises ModelError or DataError as `greybox.fit` does, DataError for a file that is no journal.
    """
    judges, tell = (validation,) if isinstance(validation, Experiment) else tuple(validation), say or _silent
    refits = RefitExecutor(journal=RefitJournal(Path(journal)) if journal else None, report=report)
    bench = replace(_white(DiscoveryProblem.of(fit), fit), refits=refits)
    start = bench.at(fit)
    model = _without_refinements(fit.model)
    chosen = (
        bench.best(model, [{n: v for n, v in fit.model.values.items() if n in model.values}], keep=1, like=start)
        or start
    )
    scales = estimate_scales(chosen)
    candidates = (
        [tailor_to_record(e, scales) for e in effects] if effects else applicable_effects(plain or fit.model, scales)
    )
    before, steps = score_holdout(bench, chosen, judges), list[RefinementStep]()
    tell(f"{chosen.model.title}: misfit on the validation records {before:.3g} times that of the fit")
    while len(steps) < most:
        gains = [
            g for t in _extended(bench, chosen, candidates, scales) if (g := _gain(bench, chosen, t, judges, before))
        ]
        if not gains:
            break
        least = min(t.per_sample for t, _, _ in gains) ** 0.5
        alike = sorted((g for g in gains if g[0].per_sample ** 0.5 <= (1 + ALIKE) * least), key=lambda g: g[1])
        best, after, share = alike[0]
        near = {_added(chosen, t): 1 - m / before for t, m, _ in alike[1:] if m <= (1 + ALIKE) * after}
        steps.append(RefinementStep(_added(chosen, best), share, 1 - after / before, near))
        tell(str(steps[-1]))
        chosen, before = best, after
    return Refinement(finish_and_validate(chosen, bench, judges), tuple(steps))


Gain = tuple[CandidateFit, float, float]


def _gain(
    bench: DiscoveryProblem, smaller: CandidateFit, larger: CandidateFit, judges: Sequence[Experiment], before: float
) -> Gain | None:
    """The larger model, its misfit on the judging records, and its share of the fitted misfit; None where it is not demanded."""
    share = 1 - (larger.cost / smaller.cost) ** 0.5
    if decision.criterion_gain(smaller, larger) <= decision.STRONG or share < FITTED:
        return None
    after = score_holdout(bench, larger, judges)
    return (larger, after, share) if after <= (1 - HELD_OUT) * before else None


def _extended(
    bench: DiscoveryProblem, chosen: CandidateFit, candidates: Sequence[Effect], scales: Scales
) -> list[CandidateFit]:
    """``chosen`` with each of the most promising further effects."""
    names = set(chosen.effects)
    inside = {parent for b in chosen.model.bound_effects for parent in b.effect.parents}
    room = [e for e in candidates if e.name not in names | inside and not names & set(e.parents)]
    starts = {e.name: _starts(chosen, e, scales) for e in room}
    hopes = {e.name: bench.promise(chosen.model + e, starts[e.name], chosen) for e in room}
    promising = sorted(room, key=lambda e: hopes[e.name])[:PROMISING]
    found = [bench.best(chosen.model + e, starts[e.name], KEPT, like=chosen) for e in promising]
    return [t for t in found if t is not None]


def _without_refinements(model: Model) -> Model:
    for name in [e.name for e in model.effects if is_shape_correction(e.name)]:
        model = model.without(name)
    return model


def _starts(chosen: CandidateFit, effect: Effect, scales: Scales) -> list[StartValues]:
    """Where the refit with a further effect begins: with nothing of it, and at the usual amplitudes and shapes."""
    model = chosen.model + effect
    return [model.values, *generate_starting_points(model, effect, chosen, chosen.model, scales)]


def _added(smaller: CandidateFit, larger: CandidateFit) -> str:
    return next(name for name in larger.effects if name not in smaller.effects)


def _white(bench: DiscoveryProblem, fit: Fit) -> DiscoveryProblem:
    """The same bench with white noise of the level of the residual."""
    noise = bench.problem(fit.model).noise
    outputs = [o.name for o in fit.model.outputs]
    std = np.array([fit.misfit[o].rmse if o in fit.misfit else s for o, s in zip(outputs, noise.std, strict=True)])
    return replace(bench, noise=replace(noise, std=std, colour=tuple(AutoRegression() for _ in outputs)))


def _silent(_: str) -> None:
    return None
