"""Intervals that do not lean on the curvature at the optimum: profile likelihood and the block bootstrap."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from greybox.base import DataError, FileKind, FitError, Interval, Matrix, from_json_data, pseudo_inverse, read_json
from greybox.estimation.optimum import restore_residuals
from greybox.estimation.options import FitOptions
from greybox.estimation.profile_pairs import ProfilePair, load_profile_pair, profile_pair
from greybox.estimation.profiles import IntervalFile, Profile, ProfilePolicy, ProfileShape, load_profile, profile
from greybox.estimation.result import Fit
from greybox.estimation.sandwich import estimate_residual_colour

__all__ = [
    "Bootstrap",
    "Profile",
    "ProfilePair",
    "ProfilePolicy",
    "ProfileShape",
    "bootstrap",
    "load_bootstrap",
    "load_profile",
    "load_profile_pair",
    "profile",
    "profile_pair",
]

# Block bootstrap: what the constants would have been had the residual fallen otherwise.


@dataclass(frozen=True)
class BootstrapPolicy:
    """How long the blocks of a bootstrap are.

    Parameters
    ----------
    correlation_times
        A block covers so many correlation times of the residual, and at least the cube root of the record (Kunsch 1989).
    least_blocks
        Blocks in a record at least: fewer cannot be drawn in enough different orders.
    """

    correlation_times: float = 5.0
    least_blocks: int = 5


DEFAULT_BOOTSTRAP_POLICY = BootstrapPolicy()


@dataclass(frozen=True, eq=False)
class Bootstrap(IntervalFile):
    """The constants that other draws of the residual would have given.

    Attributes
    ----------
    names
        The constants.
    samples
        For each draw the constants in that order (B, nf).
    std, interval
        Standard deviation and 95 % interval by name.
    block
        Rows of a block.
    policy
        How long blocks are.
    """

    names: tuple[str, ...]
    samples: Matrix
    std: dict[str, float]
    interval: dict[str, Interval]
    block: int
    policy: BootstrapPolicy = DEFAULT_BOOTSTRAP_POLICY

    FILE: ClassVar[FileKind] = FileKind("a bootstrap", "file that a bootstrap was saved to")


def load_bootstrap(path: str | Path) -> Bootstrap:
    """Read a bootstrap that `Bootstrap.save` wrote.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    Bootstrap
        The bootstrap as it was saved.

    Raises
    ------
    DataError
        If the file is not a bootstrap.
    """
    data = read_json(path, Bootstrap)
    names = data["names"]
    if any(len(row) != len(names) for row in data["samples"]) or not {*names} == {*data["std"]} == {*data["interval"]}:
        raise DataError(f"{path}: its samples, deviations and intervals are not those of its constants; save it again")
    return from_json_data(Bootstrap, data)


def bootstrap(
    fit: Fit,
    generator: np.random.Generator,
    *,
    replicates: int = 1000,
    block: int | None = None,
    policy: BootstrapPolicy = DEFAULT_BOOTSTRAP_POLICY,
) -> Bootstrap:
    """Moving-block bootstrap of the residual (Kunsch 1989), each replicate refitted by one Gauss-Newton step from the optimum.

    Blocks of the residual, all outputs together, are drawn with replacement from the same record and put in place of the residual;
    ``J+ r*`` moves the parameters and the initial states. One step is the whole refit where the model is nearly linear over the
    interval, which a `profile` can tell. Priors are drawn anew in each replicate. The interval is the basic one (reflected
    percentiles), on the logarithm of positive parameters, within their bounds. As every block bootstrap it falls short by some per
    cent where the record is only tens of blocks long. Of a fit with process noise the innovations are drawn anew (Stoffer and Wall,
    JASA 86, 1991), and one step of scoring moves the parameters.

    Parameters
    ----------
    fit
        A fit that succeeded, with its inputs.
    generator
        Where the draws come from.
    replicates
        How many.
    block
        Rows of a block; five correlation times of the residual where it is left out.
    policy
        How long the blocks are.

    Returns
    -------
    Bootstrap
        Samples (replicates, nf), standard deviations and 95 % intervals. A parameter that each experiment has for itself stands with
        each of its values, as ``B (day 1)``.

    Raises
    ------
    FitError
        For a fit that did not succeed, or a block that leaves fewer than five to a record.

    Examples
    --------
    >>> bootstrap(fit, np.random.default_rng(0)).interval["K"]  # doctest: +SKIP
    (6987.5, 7012.6)
    """
    objective, residuals = restore_residuals(fit)
    v, size = objective.variables, objective.variables.size
    shortest = min(len(r) for r, _ in residuals.rows)
    if block is None:
        estimation = FitOptions.from_data(fit.provenance.options).policy
        colour = estimate_residual_colour(residuals.rows, size, True, noise_policy=estimation.noise)
        time = max((t for t, _ in colour.times), default=1.0)
        # Longer than the residual remembers, and growing with the cube root of the rows (Hall, Horowitz, Jing 1995); yet several of them.
        block = max(
            1,
            min(
                int(np.ceil(max(policy.correlation_times * time, shortest ** (1 / 3)))), shortest // policy.least_blocks
            ),
        )
    if not 1 <= block <= shortest // policy.least_blocks:
        raise FitError(
            f"bootstrap: blocks of {block} rows from a record of {shortest}; give 1 to {shortest // policy.least_blocks} rows"
        )
    count = sum(int(np.isfinite(r).sum()) for r, _ in residuals.rows)
    gradient = np.zeros((replicates, size))
    prior = np.pad(v.penalty(v.here)[2] / 2, (0, size - len(v.which)))
    for e, (r, slopes) in enumerate(residuals.rows):
        loudness = residuals.log_variance[e] if residuals.log_variance else None
        gradient[:, v.columns(e)] += _draw_scores(r, slopes, loudness, replicates, block, generator)
    # Fitted residuals are too small by the unknowns: N / (N - p) of the variance is given back.
    gradient *= np.sqrt(count / max(count - size, 1))
    # A prior is one more measurement: in each replicate it has an error of its own.
    gradient += np.sqrt(prior) * generator.normal(size=gradient.shape)
    inside = np.ones(size, bool)
    inside[: len(v.which)] = ~v.active
    steps = np.zeros((replicates, size))
    information = residuals.compute_information(v) + np.diag(prior)
    # z* = -(J'J + P)^-1 J'r*
    steps[:, inside] = -gradient[:, inside] @ pseudo_inverse(information[np.ix_(inside, inside)])
    samples, std, interval = np.empty((replicates, len(v.which))), {}, {}
    for k, name in enumerate(v.names):

        def place(step: np.ndarray, k: int = k) -> np.ndarray:
            # value + scale z, or value exp(z), as the decision vector has it
            linear, factor = v.base[k] + v.scale[k] * step, np.exp(np.clip(step, -300, 300))
            return np.clip(v.base[k] * factor if v.logarithmic[k] else linear, v.low[k], v.high[k])

        samples[:, k] = place(steps[:, k])
        std[name] = float(samples[:, k].std(ddof=1))
        upper, lower = np.quantile(steps[:, k], [0.025, 0.975])
        # Basic interval: the error of the estimate is that of the replicates, so that the quantiles change sides.
        ends = place(np.array([-lower, -upper]))
        interval[name] = (float(ends[0]), float(ends[1]))
    return Bootstrap(v.names, samples, std, interval, block, policy)


def _draw_scores(
    r: np.ndarray,
    jacobian: np.ndarray,
    loudness: np.ndarray | None,
    replicates: int,
    block: int,
    generator: np.random.Generator,
) -> np.ndarray:
    """``J' r*`` (B, L) of residuals made of random blocks of ``r`` (N, ny), each output's mean removed; gaps stay gaps.

    Of innovations ``J' r* + L'(s^2 - r*^2) / 2``, ``L`` the slopes of the logarithm of their variance and ``s^2`` their mean square.
    """
    n = len(r)
    measured = np.isfinite(r)
    slopes = np.where(measured[:, :, None], jacobian, 0.0).reshape(-1, jacobian.shape[2])
    with np.errstate(invalid="ignore"):
        centred = r - (np.where(measured, r, 0.0).sum(axis=0) / np.maximum(measured.sum(axis=0), 1))
    # A gap that falls on a measured row is filled by the block's neighbour: no residual must vanish.
    filled = centred.copy()
    for column in filled.T:
        known = np.flatnonzero(np.isfinite(column))
        place = np.searchsorted(known, np.arange(n), side="right") - 1
        # The last value before a gap, or the first after; nothing where nothing was measured.
        column[:] = column[known[np.maximum(place, 0)]] if len(known) else 0.0
    squares = 0.5 * ((filled**2).mean(axis=0) - filled**2)
    louder = None if loudness is None else np.where(measured[:, :, None], loudness, 0.0).reshape(-1, jacobian.shape[2])
    places = np.arange(block)
    result = np.empty((replicates, jacobian.shape[2]))
    for b in range(replicates):
        # Blocks may overlap, and begin anywhere (Kunsch 1989).
        starts = generator.integers(0, n - block + 1, size=-(-n // block))
        chosen = (starts[:, None] + places).ravel()[:n]
        result[b] = filled[chosen].ravel() @ slopes
        if louder is not None:
            result[b] += squares[chosen].ravel() @ louder
    return result
