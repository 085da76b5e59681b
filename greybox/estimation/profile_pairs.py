"""The profile of two constants: the region that the records leave to both, everything else estimated anew."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np

from greybox.base import DataError, ModelError, Printable, nearest, read_json
from greybox.base.json_shape import FileKind, Finite, FiniteArray, Null, UnboundedArray, from_json_data
from greybox.estimation.optimum import restore_objective, restore_options
from greybox.estimation.profiles import (
    DEFAULT_PROFILE_POLICY,
    IntervalFile,
    ProfilePolicy,
    ProfileSearch,
    ProfileShape,
    find_scale,
)
from greybox.estimation.result import Fit


@dataclass(frozen=True, eq=False)
class ProfilePair(Printable, IntervalFile):
    """The 95 % region of two constants, everything else estimated anew: for values of the first where the second may lie.

    Attributes
    ----------
    first, second
        The two constants.
    units, best
        Their units, and where the cost is least.
    values
        Where the first was held (k,), increasing, from end to end of the region.
    increase
        Least rise of the cost over its scale there (k,).
    ridge
        The second where that is (k,).
    lower, upper
        Between them the rise stays below the threshold (k,); an end that is never reached is the bound of the second, or infinite.
    threshold
        Rise at the edge of the region: the 95 % point for two constants.
    open_sides
        Whether the first is open downwards and upwards.
    correlation
        That of the two by the covariance.
    policy
        How it was followed.
    """

    first: str
    second: str
    units: tuple[str, str]
    best: tuple[Finite, Finite]
    values: FiniteArray
    increase: UnboundedArray
    ridge: FiniteArray
    lower: Annotated[np.ndarray, Null(-np.inf)]
    upper: UnboundedArray
    threshold: Finite
    open_sides: tuple[bool, bool]
    correlation: Finite
    policy: ProfilePolicy = DEFAULT_PROFILE_POLICY

    FILE: ClassVar[FileKind] = FileKind(
        "a profile of two constants", "file that a profile of two constants was saved to"
    )
    KEYS: ClassVar[str] = "kind! * shape narrowing"

    @property
    def shape(self) -> ProfileShape:
        """Bounded, one-sided or flat: closed, open towards some side, or open towards all sides of both constants."""
        at_ends = self.lower[[0, -1]], self.upper[[0, -1]]
        is_closed = np.isfinite(at_ends).all() and not any(self.open_sides)
        middle = int(np.argmin(self.increase))
        is_open = all(self.open_sides) and not np.isfinite([self.lower[middle], self.upper[middle]]).any()
        return ProfileShape.BOUNDED if is_closed else ProfileShape.FLAT if is_open else ProfileShape.ONE_SIDED

    @property
    def narrowing(self) -> float:
        """By what factor the second is known better where the first is known; infinite where it is open alone."""
        widths = self.upper - self.lower
        return (
            float((self.upper.max() - self.lower.min()) / widths.max())
            if np.isfinite(widths).all() and widths.max() > 0
            else np.inf
        )


def load_profile_pair(path: str | Path) -> ProfilePair:
    """Read a profile of two constants that `ProfilePair.save` wrote.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    ProfilePair
        As it was saved.

    Raises
    ------
    DataError
        If the file is none.
    """
    data = read_json(path, ProfilePair)
    lengths = {len(data[name]) for name in ("values", "increase", "ridge", "lower", "upper")}
    if len(lengths) > 1 or 0 in lengths:
        raise DataError(f"{path}: its values, rises and limits are not of one length; save it again")
    return from_json_data(ProfilePair, data)


# Values of the first constant from end to end of the region.
PAIR_VALUES = 11


def profile_pair(fit: Fit, first: str, second: str, *, policy: ProfilePolicy = DEFAULT_PROFILE_POLICY) -> ProfilePair:
    """The 95 % region of two constants by profile likelihood.

    The first is held at values across its own range, and from the best fit there the second is followed either way to where the cost has
    risen to the threshold, everything else estimated anew. A region that is long, thin and curved is followed along its length. Takes some
    100 to 150 refits.

    Parameters
    ----------
    fit
        A fit that succeeded, with its inputs.
    first, second
        Two of its constants that all records share.
    policy
        How it is followed.

    Returns
    -------
    ProfilePair
        The region, slice by slice.

    Raises
    ------
    ModelError
        For a constant that was not fitted, or twice the same.
    FitError
        For a fit that did not succeed.

    Examples
    --------
    >>> profile_pair(fit, "k1", "E1").narrowing  # doctest: +SKIP
    41.7
    """
    objective = restore_objective(fit)
    v, free = objective.variables, fit.uncertainty.free
    shared = [name for name in v.names if name in free]
    for name in (first, second):
        if name not in shared:
            raise ModelError(
                f"profile of {name!r}: not a fitted parameter that all records share; {nearest(name, shared)}"
            )
    if first == second:
        raise ModelError(f"profile of {first!r} and itself: give two constants")
    places = [v.names.index(first), v.names.index(second)]
    options, scales = restore_options(fit), [find_scale(fit, objective, k) for k in places]
    # One unit for both: the larger one claims less.
    unit, threshold = max(scale.unit for scale in scales), scales[0].threshold_of_two
    search = ProfileSearch(objective, places[0], scales[0].least, scales[0].std, unit, threshold, options, policy)
    quantity, best = v.quantities[places[0]], float(v.base[places[0]])
    low, below = search.follow(quantity.bounds[0], -1, farther=False)
    high, above = search.follow(quantity.bounds[1], +1, farther=False)
    sides = not any(rise > threshold for _, rise in below), not any(rise > threshold for _, rise in above)
    # An open side ends where it was followed to.
    ends = [float(end if np.isfinite(end) else points[-1][0]) for end, points in ((low, below), (high, above))]
    spaced = np.geomspace if quantity.positive and ends[0] > 0 else np.linspace
    tried = np.unique(np.append(spaced(ends[0], ends[1], PAIR_VALUES), best))
    rows = [free.index(first), free.index(second)]
    stated = np.asarray(fit.uncertainty.covariance)[np.ix_(rows, rows)]
    with np.errstate(invalid="ignore", divide="ignore"):
        # The second beside a known first: s_b sqrt(1 - rho^2).
        beside = float(np.sqrt(stated[1, 1] - stated[0, 1] ** 2 / stated[0, 0]))
        correlation = float(stated[0, 1] / np.sqrt(stated[0, 0] * stated[1, 1]))
    mean, std = v.prior[places[0]]
    slices: dict[float, tuple[float, float, float, float]] = {}
    # From the best value outwards, so that each refit begins at its neighbour.
    for values in (tried[tried <= best][::-1], tried[tried > best]):
        near = None
        for value in map(float, values):
            rise, near = search.rise(value, near)
            k = near.names.index(second)
            lower = upper = ridge = float(near.base[k])
            if rise < threshold:
                along = ProfileSearch(
                    objective.at(near),
                    k,
                    search.least,
                    beside if beside > 0 else None,
                    unit,
                    threshold,
                    options,
                    policy,
                    ground=max(rise, 0.0),
                    lost_prior=float(((value - mean) / std) ** 2),
                )
                lower, _ = along.follow(near.quantities[k].bounds[0], -1, farther=False)
                upper, _ = along.follow(near.quantities[k].bounds[1], +1, farther=False)
            slices[value] = rise, ridge, lower, upper
    held_at = np.array(sorted(slices))
    increase, ridges, lowers, uppers = np.array([slices[value] for value in held_at]).T
    return ProfilePair(
        first,
        second,
        (quantity.unit, v.quantities[places[1]].unit),
        (best, float(v.base[places[1]])),
        held_at,
        increase,
        ridges,
        lowers,
        uppers,
        threshold,
        sides,
        correlation if np.isfinite(correlation) else 0.0,
        policy,
    )
