"""Optimal weights of given pieces of information: which sampling times, which lines of a spectrum, which of many small experiments.

For the sum of information matrices ``M(w) = sum w_i M_i`` with ``w >= 0`` and ``sum w = 1`` the D-optimal weights follow from the
multiplicative algorithm ``w_i <- w_i trace(M(w)^-1 M_i) / p`` (Silvey, Titterington and Torsney 1978), which climbs at every step; at the
optimum no trace exceeds ``p`` (Kiefer and Wolfowitz 1960).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from greybox.base.errors import DataError
from greybox.base.numerics import TINY
from greybox.extensions.design.plant import make_plant
from greybox.extensions.design.problem import DesignProblem


@dataclass(frozen=True)
class SamplingTimes:
    """When to sample.

    Parameters
    ----------
    times
        In seconds, ascending.
    weights
        Share of all samples that belongs there.
    efficiency
        Determinant per constant over that of sampling evenly, as a factor: how many times fewer samples do as well.
    """

    times: tuple[float, ...]
    weights: tuple[float, ...]
    efficiency: float


def weigh_optimally(information: np.ndarray, iterations: int = 2000, tolerance: float = 1e-6) -> np.ndarray:
    """The D-optimal weights of information matrices.

    Parameters
    ----------
    information : array (K, p, p)
        What each piece brings.
    iterations, tolerance
        The algorithm ends where no trace exceeds ``p`` by this share, or after so many steps.

    Returns
    -------
    array (K,)
        Weights that add up to one.

    Raises
    ------
    DataError
        Where all pieces together do not determine every constant.
    """
    count, p, _ = information.shape
    weights = np.full(count, 1 / count)
    scale = np.sqrt(np.maximum(np.diagonal(information.sum(axis=0)), TINY))
    # D-optimal weights do not depend on units; the inverse does not have to either.
    scaled = information / scale[:, None] / scale
    if np.linalg.cond(scaled.mean(axis=0)) > 1e13:
        raise DataError(
            "optimal weights: the pieces together do not determine every constant; fix one, or add a sensor"
        )
    for _ in range(iterations):
        inverse = np.linalg.inv(np.tensordot(weights, scaled, 1))
        # trace(M(w)^-1 M_i) / p: above one a piece brings more than its share, and gets more weight.
        gain = np.einsum("ij,kji->k", inverse, scaled) / p
        weights = weights * gain
        weights /= weights.sum()
        if gain.max() < 1 + tolerance:
            break
    return weights


def choose_sampling_times(
    question: DesignProblem, inputs: Mapping[str, np.ndarray], *, least_weight: float = 0.02
) -> SamplingTimes:
    """The D-optimal times at which to sample a run, in the approximate theory: a share of all samples for each.

    Parameters
    ----------
    question
        Its sampling time is the grid of the times that are considered; earlier records are not counted.
    inputs
        Name -> array (N,) over that grid.
    least_weight
        Neighbouring times are merged, and those of less weight left out.

    Returns
    -------
    SamplingTimes
        Times and weights.

    Raises
    ------
    DataError
        Where the run does not determine every constant.
    """
    plant = make_plant(question, question.model)
    run = plant.run(inputs)
    rows = np.nan_to_num(run.slopes)[:, :, : plant.count]
    information = np.einsum("kip,kiq->kpq", rows, rows)
    weights = weigh_optimally(information)
    active = weights > least_weight / 10
    edges = np.flatnonzero(np.diff(active.astype(int))) + 1
    # Weights on neighbouring grid points stand for one time between them.
    groups = [g for g in np.split(np.arange(len(weights)), edges) if active[g[0]] and weights[g].sum() >= least_weight]
    times = tuple(float(np.average(question.time[g], weights=weights[g])) for g in groups)
    shares = np.array([weights[g].sum() for g in groups])
    best = np.linalg.slogdet(np.tensordot(weights, information, 1))[1]
    even = np.linalg.slogdet(information.mean(axis=0))[1]
    return SamplingTimes(times, tuple((shares / shares.sum()).tolist()), float(np.exp((best - even) / plant.count)))
