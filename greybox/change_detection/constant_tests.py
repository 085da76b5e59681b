"""Have constants moved between two fits? A joint test, and a look at each that allows for the number of looks.

The difference of two independent estimates is normal with the sum of their covariances, or Student's where the noise was estimated. Two
statistics are computed: the largest standardised difference, which finds a change of one constant, and Wald's quadratic form, which
finds a change of a combination that the records determine better than any constant by itself. The p-value of the smaller of their two
p-values comes from its distribution under no change, drawn with the correlation of the estimates at hand (Westfall and Young,
Resampling-based multiple testing, 1993; Hothorn, Bretz and Westfall, Biometrical Journal 50, 2008), so that the rate of false alarms is
neither shared out nor exceeded. Each constant's own p-value is that of the largest of as many standardised differences, stepping down
from the largest (Holm's order).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import chdtrc, fdtrc, stdtr, stdtrit

from greybox.change_detection.fitted_constants import FittedConstants
from greybox.change_detection.policy import ChangeTestPolicy
from greybox.linear_algebra import decompose_symmetric
from greybox.numerics import NEARLY_NORMAL


@dataclass(frozen=True, eq=False)
class DifferenceTest:
    """The test of the differences of some constants.

    Parameters
    ----------
    names
        What was compared (k,).
    difference, std : array (k,)
        After less before, and its standard deviation, on the scale of the comparison.
    p : array (k,)
        Of each constant, corrected for looking at all of them.
    p_value
        Of all together.
    half_widths : array (k,)
        Of the intervals of the differences, which hold together.
    visible : array (k,)
        Difference of each that would be seen with the power of the policy.
    direction : array (k,)
        The combination that stands out most, each constant in its standard deviations, the largest entry one.
    """

    names: tuple[str, ...]
    difference: np.ndarray
    std: np.ndarray
    p: np.ndarray
    p_value: float
    half_widths: np.ndarray
    visible: np.ndarray
    direction: np.ndarray


def list_comparable(before: FittedConstants, after: FittedConstants) -> list[str]:
    """Constants that both fits have determined, off their bounds."""
    known = [set(np.array(c.names)[np.isfinite(c.variances)].tolist()) for c in (before, after)]
    return [name for name in before.names if name in known[0] & known[1] and name in after.names]


def compare_constants(
    before: FittedConstants,
    after: FittedConstants,
    names: Sequence[str],
    level: float,
    power: float,
    policy: ChangeTestPolicy,
) -> DifferenceTest:
    """The test whether ``names`` are the same in both fits, at the ``level`` of false alarms."""
    i, j = before.index(names), after.index(names)
    common = before.positive[i] & after.positive[j]
    one, other = _rescale(before, i, common), _rescale(after, j, common)
    difference = other[0] - one[0]
    covariance = one[1] + other[1]
    std = np.sqrt(np.diag(covariance))
    degrees = combine_degrees(np.diag(one[1]), np.diag(other[1]), before.degrees, after.degrees)
    correlation = covariance / np.outer(std, std)
    z = difference / std
    null = _NullDistribution.draw(correlation, degrees, policy)
    p, critical = null.step_down(np.abs(z)), null.quantile(1 - level)
    wide = null.quantile(policy.interval_level)
    direction = null.inverse @ z
    largest = np.abs(direction).max(initial=0.0)
    return DifferenceTest(
        tuple(names),
        difference,
        std,
        p,
        null.joint_p_value(z),
        wide * std,
        (critical + stdtrit(degrees, power)) * std,
        direction / largest if largest else direction,
    )


def combine_degrees(one: np.ndarray, other: np.ndarray, degrees_one: float, degrees_other: float) -> float:
    """Degrees of freedom of a sum of two estimated variances (Welch 1938, Satterthwaite 1946): the fewest of all constants."""
    inverse = (one**2 / degrees_one + other**2 / degrees_other) / (one + other) ** 2
    worst = float(inverse.max(initial=0.0))
    return 1 / worst if worst > 0 else float(np.inf)


def _rescale(constants: FittedConstants, places: list[int], common: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Estimates and covariance, logarithmic only where both fits allow it."""
    values = constants.values[places]
    scaled = np.where(common, np.log(np.where(common, values, 1.0)), values)
    back = np.where(constants.positive[places] & ~common, values, 1.0)
    return scaled, constants.covariance[np.ix_(places, places)] * np.outer(back, back)


@dataclass(frozen=True, eq=False)
class _NullDistribution:
    """Standardised differences (draws, k) of constants that have not changed, with the inverse of their correlation."""

    z: np.ndarray
    inverse: np.ndarray
    rank: int
    degrees: float
    policy: ChangeTestPolicy

    @classmethod
    def draw(cls, correlation: np.ndarray, degrees: float, policy: ChangeTestPolicy) -> _NullDistribution:
        decomposition = decompose_symmetric(correlation)
        inverse = decomposition.pseudo_inverse
        values, vectors = np.linalg.eigh(correlation)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        generator = np.random.default_rng(policy.seed)
        z = generator.standard_normal((policy.draws, len(correlation))) @ root.T
        if np.isfinite(degrees):
            z /= np.sqrt(generator.chisquare(degrees, (policy.draws, 1)) / degrees)
        rank = max(round(float(np.trace(inverse @ correlation))), 1)
        return cls(z, inverse, rank, degrees, policy)

    @cached_property
    def largest(self) -> np.ndarray:
        """The largest of the standardised differences of each draw (draws,)."""
        return np.abs(self.z).max(axis=1)

    @cached_property
    def ordered(self) -> np.ndarray:
        """Draws (draws,) by their ``largest``, ascending."""
        return np.argsort(self.largest)

    def quantile(self, level: float) -> float:
        """What the largest of the standardised differences stays below with this probability."""
        return float(self.largest[self.ordered[min(int(level * len(self.largest)), len(self.largest) - 1)]])

    def step_down(self, z: np.ndarray) -> np.ndarray:
        """p-values (k,) of each, corrected for the looks that are left when it has its turn."""
        p, left, worst = np.ones(len(z)), np.ones(len(z), bool), 0.0
        for k in np.argsort(-z):
            largest = self.largest if left.all() else np.abs(self.z[:, left]).max(axis=1)
            exceeding = int((largest >= z[k]).sum())
            worst = max(worst, self._share(exceeding, float(left.sum()) * self._tail(z[k])))
            p[k], left[k] = worst, False
        return p

    def joint_p_value(self, z: np.ndarray) -> float:
        """Probability that one of the two statistics is as unlikely as the less likely one at hand."""
        count = len(self.largest)
        of_largest = np.empty(count)
        of_largest[self.ordered] = 1 - np.arange(count) / count
        seen = float(np.abs(z).max(initial=0.0))
        of_form = float(self._form_tail(self._form(z[None]))[0])
        p_largest = self._share(int((self.largest >= seen).sum()), len(z) * self._tail(seen))
        smallest = min(p_largest, of_form)
        exceeding = int((np.minimum(of_largest, self._form_tail(self._form(self.z))) <= smallest).sum())
        return self._share(exceeding, 2 * smallest)

    def _form(self, z: np.ndarray) -> np.ndarray:
        return ((z @ self.inverse) * z).sum(axis=1)

    def _form_tail(self, form: np.ndarray) -> np.ndarray:
        if self.degrees >= NEARLY_NORMAL:
            return chdtrc(self.rank, form)
        return fdtrc(self.rank, self.degrees, form / self.rank)

    def _tail(self, z: float) -> float:
        return 2 * float(stdtr(min(self.degrees, NEARLY_NORMAL), -z))

    def _share(self, exceeding: int, bound: float) -> float:
        """A share of the draws, or where hardly any exceeds, a bound on the probability."""
        if exceeding >= self.policy.counted_draws:
            return exceeding / self.policy.draws
        return min(bound, max(exceeding, self.policy.counted_draws) / self.policy.draws)
