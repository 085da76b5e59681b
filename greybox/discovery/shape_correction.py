"""Is what an effect leaves over another effect, or its own form that the catalogue has not quite got?

A creep with three branches leaves something to a creep with one, and a rubbing that depends on speed something to dry friction: a
search that only adds effects then gives two or three wrong names. So before a further effect is accepted it has to beat a
refinement of those that are there: a second branch of the same kind, or a smooth curve at the same place over the same variable.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from greybox.discovery.curve_effects import NAME, make_curve_effect
from greybox.discovery.disturbance_sites import list_disturbance_sites
from greybox.discovery.effect_signal import estimate_effect_signals
from greybox.discovery.execution import RefitJob
from greybox.discovery.problem import CandidateFit, DiscoveryProblem
from greybox.discovery.starting_points import generate_starting_points
from greybox.effects import Scales
from greybox.model import Effect

# Appended to the name of an effect for a second branch of it; heights of a refining curve; iterations of a refinement.
AGAIN = "_second_branch"
HEIGHTS, ITERATIONS = 10, 20


def is_shape_correction(name: str) -> bool:
    """Whether an effect of this name only corrects the form of another one."""
    return name == NAME or name.endswith(AGAIN)


def fit_shape_correction(bench: DiscoveryProblem, trial: CandidateFit, scales: Scales) -> CandidateFit | None:
    """The best refinement of one effect of ``trial`` by Schwarz's criterion; None where there is none to try."""
    jobs = [*_branches(bench, trial, scales), *_curves(bench, trial)]
    found = [t for t in bench.every(jobs) if t is not None]
    return min(found, key=lambda t: t.criterion, default=None)


def _branches(bench: DiscoveryProblem, trial: CandidateFit, scales: Scales) -> Iterator[RefitJob]:
    """A second branch of every effect that remembers and has a shape: a spectrum of times in the place of one."""
    for effect in trial.model.effects:
        if effect.states and effect.balances and effect.terms and effect.grid:
            # As it came from the catalogue: a fitted one would begin on top of the first.
            branch = replace(effect, name=f"{effect.name}{AGAIN}", parents=())
            model = trial.model + branch
            yield RefitJob(
                model, tuple(generate_starting_points(model, branch, trial, trial.model, scales)), 1, ITERATIONS
            )


def _curves(bench: DiscoveryProblem, trial: CandidateFit) -> Iterator[RefitJob]:
    """A curve at the place of every effect, over the variable that its signal depends on most."""
    for m in estimate_effect_signals(bench, trial):
        plain: Effect | None = next((e for e in trial.model.effects if e.name == m.effect), None)
        if plain is None or plain.states or plain.hold:
            continue  # what remembers, or moves the input between samples, is no function of a variable
        place = next(
            p for p in list_disturbance_sites(trial.model, [o.name for o in trial.model.outputs]) if str(p) == m.site
        )
        curve, start = make_curve_effect(place, m.region, m.variable, m.value - m.modelled, m.std, HEIGHTS)
        model = trial.model + curve
        own = next(b.model_names for b in model.bound_effects if b.effect.name == NAME)
        starts = ({**trial.model.values, **{own[n]: v for n, v in start.items()}}, trial.model.values)
        yield RefitJob(model, starts, 1, ITERATIONS)
