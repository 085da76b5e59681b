"""States given the whole record, what comes after them included: the fixed-interval smoother."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from greybox.filtering.batch_filter import BatchFilter
from greybox.filtering.kalman_filter import KalmanFilter
from greybox.kernel import Record


@dataclass(frozen=True, eq=False)
class SmootherRun:
    """States of each of N rows."""

    filtered: np.ndarray
    """States (N, nx) given the measurements up to each row."""

    filtered_covariance: np.ndarray
    """Their covariance (N, nx, nx)."""

    mean: np.ndarray
    """States (N, nx) given all measurements."""

    covariance: np.ndarray
    """Their covariance (N, nx, nx)."""

    innovation: np.ndarray
    """Standardised innovations (N, ny), NaN in gaps."""

    log_likelihood: float
    """Of all measurements."""


def smooth_states(
    kalman: KalmanFilter, record: Record, pn: np.ndarray, x0: np.ndarray, covariance: np.ndarray | None = None
) -> SmootherRun:
    """Rauch, Tung and Striebel's smoother (AIAA Journal 3, 1965), in the form of Bryson and Frazier (1963; de Jong, JASA 84, 1989).

    Backwards along the record ``r = H' S^-1 v + L' F' r`` and ``N = H' S^-1 H + L' F' N F L`` with ``L = I - K H``, then ``x + P r`` and
    ``P - P N P``. It inverts no covariance of the states, so that states without noise, or known at the first row, are ordinary
    cases. For a nonlinear model ``F`` and ``H`` are the slopes along the filter's run.
    """
    run = kalman.run(record, pn, x0, covariance)
    batch = BatchFilter(kalman, record, pn)
    rows = np.arange(len(record.y))
    filtered, after = batch.correct(run.predicted, run.covariance)
    _, transitions = batch.move_with_slopes(filtered[:-1], rows[:-1])
    y, slopes = batch.outputs(run.predicted, rows)
    present = np.isfinite(record.y)
    innovation = np.where(present, record.y - y, 0.0)
    slopes = np.where(present[:, :, None], slopes, 0.0)
    noise = np.where(present, pn[-y.shape[1] :] ** 2, 1.0)
    variance = slopes @ run.covariance @ slopes.transpose(0, 2, 1) + noise[:, :, None] * np.eye(y.shape[1])
    weighted = np.linalg.solve(variance, slopes)
    weighted_innovation, curvature = np.einsum("tji,tj->ti", weighted, innovation), slopes.transpose(0, 2, 1) @ weighted
    correction = np.eye(len(x0)) - run.covariance @ curvature  # L, from the state before a measurement to that after it
    r, information = np.zeros(run.predicted.shape), np.zeros(run.covariance.shape)
    r_after, information_after = np.zeros(len(x0)), np.zeros((len(x0), len(x0)))
    for k in rows[::-1]:
        if k < rows[-1]:
            r_after, information_after = (
                transitions[k].T @ r_after,
                transitions[k].T @ information_after @ transitions[k],
            )
        r[k] = r_after = weighted_innovation[k] + correction[k].T @ r_after
        information[k] = information_after = curvature[k] + correction[k].T @ information_after @ correction[k]
    mean = run.predicted + np.einsum("tij,tj->ti", run.covariance, r)
    smoothed_covariance = run.covariance - run.covariance @ information @ run.covariance
    return SmootherRun(
        filtered,
        after,
        mean,
        (smoothed_covariance + smoothed_covariance.transpose(0, 2, 1)) / 2,
        run.innovation,
        run.log_likelihood,
    )
