"""Candidate fits with chosen costs, for the rules of discovery: nothing is simulated and nothing is fitted."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace

from greybox.discovery.execution import FailureLog, RefitJob
from greybox.discovery.problem import FittedCandidate, noise_cost_limit
from greybox.model.effect import Effect
from greybox.model.model import Model
from greybox.model.signals import Parameter
from models.micro_actuator import micro_actuator

COUNT = 1000
# Where a fit ended that has converged: no further step promises anything.
CONVERGED = SimpleNamespace(predicted_decrease=lambda *_: 0.0, bounds=tuple)


def candidate(cost: float, *effects: str, count: int = COUNT, free: int = 0) -> FittedCandidate:
    """A fit of the plain model with these effects, of this cost."""
    model = SimpleNamespace(effects=[SimpleNamespace(name=name) for name in effects], values={})
    return FakeFit(model, cost, count, free or 5 + len(effects), None, CONVERGED, CONVERGED)


class FakeFit(FittedCandidate):
    """A fit without residuals: its misfit is its cost."""

    @property
    def noise_ratio(self) -> float:  # type: ignore[override]
        return self.per_sample**0.5

    @property
    def is_noise_bounded(self) -> bool:
        return False


@dataclass
class FakeProblem:
    """Stands in for a `DiscoveryProblem`: the cost of a model is looked up by the names of its effects.

    Sets that are not in ``costs`` cost as much as the best of their subsets, or as the plain model. ``refits`` counts the fits of
    each set.
    """

    costs: Mapping[frozenset[str], float]
    model: Model = micro_actuator
    refits: list[frozenset[str]] = field(default_factory=list)
    failures: FailureLog = field(default_factory=FailureLog)
    predicted: dict[object, float] = field(default_factory=dict)

    @property
    def baseline(self) -> FittedCandidate:
        return self._fit(self.model)

    def refit_all(self, jobs: Sequence[RefitJob]) -> list[FittedCandidate | None]:
        return [self._fit(job.model) for job in jobs]

    def refit_best(self, model: Model, starts: Iterable[object], *_: object, **__: object) -> FittedCandidate | None:
        return self._fit(model)

    def refit_without(self, candidate: FittedCandidate, name: str, *_: object, **__: object) -> FittedCandidate | None:
        return self.refit_best(candidate.model.without(name), [])

    def plan_refit(self, model: Model, starts: Iterable[object], *_: object, **__: object) -> RefitJob:
        return RefitJob(model, (), 1, 1)

    def converge(self, candidate: FittedCandidate) -> FittedCandidate:
        again = self.refit_best(candidate.model, [])
        return again if again is not None and again.cost < candidate.cost else candidate

    def predict_cost(self, model: Model, starts: Iterable[object], like: object = None) -> float:
        return self._cost(model)

    def _fit(self, model: Model) -> FittedCandidate:
        names = frozenset(e.name for e in model.effects)
        self.refits.append(names)
        free = 5 + sum(len(e.parameters) for e in model.effects)
        return FakeFit(model, self._cost(model), COUNT, free, None, CONVERGED, CONVERGED)

    def _cost(self, model: Model) -> float:
        names = frozenset(e.name for e in model.effects)
        return min(cost for known, cost in self.costs.items() if known <= names)


def costs(plain: float, **others: float) -> dict[frozenset[str], float]:
    """Costs by set of effects: ``costs(9000, coulomb_friction=1000, coulomb_friction__backlash=990)``."""
    return {frozenset(): plain} | {frozenset(names.split("__")): cost for names, cost in others.items()}


def toy_effect(name: str, *parents: str, constants: int = 1) -> Effect:
    """An effect on the force balance with constants of its own; nothing is ever simulated with it."""
    size = f"{name}_size"
    further = [f"{name}_{k}" for k in range(1, constants)]
    return Effect(
        name,
        "force",
        [Parameter(n, "N", 0.0, source="a test") for n in (size, *further)],
        terms=lambda x, u, p: p[size],
        parents=parents,
        amplitudes=(size,),
        probe=lambda scales: {size: 1.0},
        from_parent=lambda values, scales: [{size: 1.0}],
        source="a test",
    )


def leaves_noise(fit: FittedCandidate, lags: int = 0) -> float:
    """The autocorrelation of a residual: structure as long as more than noise is left."""
    return 0.0 if fit.per_sample <= noise_cost_limit(fit.count) else 1.0
