"""Numbers that steer a minimisation: how long a step may be shortened, how damping adapts, how a kink is searched around."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class TerminationPolicy:
    """When a minimisation has nothing left to gain that matters.

    The unit of a sum of ``count`` squares is the residual's variance, ``cost / count``; that of minus twice a log-likelihood is one. A
    predicted decrease of ``k^2`` units is a step of ``k`` standard deviations of the unknowns.
    """

    negligible_decrease: float = 1e-4
    """Predicted decrease, in that unit, below which a search has converged: the unknowns are within 1 % of their standard deviations."""

    perfect_noise_ratio: float = 1e-7
    """A predicted decrease of the misfit over noise below this is negligible too: data without noise end at rounding errors."""

    patience: int = 12
    """Iterations over which the gain is looked at. A cost with kinks (dry friction) never meets the rules above."""

    little_gain: float = 1e-5
    """A search ends as acceptable when it gained less than this within its patience: a share of the cost, or of one for a likelihood."""

    def negligible(self, cost: float, count: int | None) -> float:
        """Largest decrease of ``cost`` that changes nothing that matters; ``count``: number of squares, None for a likelihood."""
        if count is None:
            return self.negligible_decrease
        return self.negligible_decrease * cost / max(count, 1) + self.perfect_noise_ratio**2 * count


@dataclass(frozen=True)
class GaussNewtonPolicy:
    """How damped Gauss-Newton steps adapt and when they give up."""

    initial_damping: float = 1e-6
    """Damping of the first step, as a share of the curvature: nearly a full Gauss-Newton step, which is right near a smooth optimum."""

    damping_growth: float = 2.0
    """Factor on the damping after a step that gained nothing; it doubles with each further one in a row (Nielsen 1999)."""

    max_steps: int = 50
    """Steps in all; a smooth cost needs ten to twenty from a lost start."""

    max_rejections: int = 8
    """Steps in a row that gain nothing: by then the damping has grown by ten decades, and no direction is left to try."""

    max_kink_steps: int = 6
    """Steps in a row below ``kink_share`` after which the cost counts as kinked."""


@dataclass(frozen=True)
class GradientSamplingPolicy:
    """How gradients are sampled around a point where the cost has a kink."""

    radii: tuple[float, ...] = (1e-2, 1e-3, 1e-4)
    """Distances of the sampled points, in turn: where a smooth cost would rise by these shares of itself."""


@dataclass(frozen=True)
class MinimisationPolicy:
    """When a search by IPOPT counts as stalled, and how it goes on from there."""

    max_shortenings: int = 10
    """Times that a step is shortened without any gain before the search counts as stalled: IPOPT halves it each time, so a direction
    that gains nothing at a thousandth of its length points the wrong way, or the gradient is that of one side of a kink."""

    hand_overs: int = 3
    """Times that IPOPT hands over to damped Gauss-Newton steps because the quadratic model predicted its last iteration well; each
    time it goes on where a step gains little of what was predicted. 0: IPOPT goes on to the end."""

    damped: GaussNewtonPolicy = field(default_factory=GaussNewtonPolicy)
    """The damped Gauss-Newton steps that follow IPOPT once it has come close, or has stalled."""

    sampling: GradientSamplingPolicy = field(default_factory=GradientSamplingPolicy)
    """The search around a kink, where damped steps gain nothing either."""


DEFAULT_POLICY = MinimisationPolicy()

DEFAULT_TERMINATION = TerminationPolicy()
