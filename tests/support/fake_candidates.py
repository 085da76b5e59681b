"""Candidate fits with chosen costs, for the rules of discovery: nothing is simulated and nothing is fitted."""

from __future__ import annotations

from types import SimpleNamespace

from greybox.discovery.problem import FittedCandidate
from greybox.model.effect import Effect
from greybox.model.signals import Parameter

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
