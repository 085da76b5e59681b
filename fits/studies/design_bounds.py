"""How narrow no input can make intervals: an upper bound of the precision goal for plants that are linear in their input.

    python -m fits.studies.design_bounds "two masses" pneumatic

The sensitivities of such a plant are linear in the input, so that its information is ``M_ij = u' G_ij u``. The logarithm of a
determinant is concave: ``log det M <= tr(W M) - n - log det W`` for every positive W. Of all inputs within ``|u_k| <= a_k`` and outputs
within their limits only the sums of squares are kept, ``u' A_c u <= 1``, and for weights t that sum to one ``u' Q u`` is at most the
largest eigenvalue of Q in the metric ``sum t_c A_c``. The bound is the smallest over W and t (Boyd and Vandenberghe 2004, sections
5.2 and 7.5). It holds for every input that can be played, and is not tight: a signal with the largest sum of squares need not exist.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np
from scipy.linalg import cholesky, solve_triangular, toeplitz
from scipy.optimize import minimize
from scipy.sparse.linalg import eigsh

import greybox as gb
from fits.studies.design_study import PLANTS, REST, USUAL
from greybox.extensions.design.goals import make_precision
from greybox.extensions.design.inputs import envelope
from greybox.extensions.design.plant import GOAL_PRIOR_SPREAD, PlantScenario, make_plant
from greybox.extensions.design.problem import DesignProblem
from greybox.shell.project import find_model

PROBE = 1e-3  # height of the impulse, as a share of the input's limit


def bound_precision(question: DesignProblem, plant: PlantScenario) -> float:
    """What the value of the precision goal (D, all constants) cannot exceed at the plant's constants.

    Parameters
    ----------
    question
        With one input whose limits are symmetric about its rest.
    plant
        Linear in the input, without initial states that are estimated.

    Returns
    -------
    float
        In the goal's unit: e to a difference is a factor on widths.
    """
    (name,) = question.driven
    limit, rows, n = question.limits[name], question.rows, plant.count
    allowed = envelope(rows, question.policy)
    kept = np.flatnonzero(allowed > 1e-12)
    impulse = np.zeros(rows)
    impulse[0] = PROBE * limit.high
    struck, still = plant.run({name: impulse}), plant.run({name: np.zeros(rows)})

    def make_matrix(response: np.ndarray) -> np.ndarray:
        """From the allowed shares of the input (kept,) to a signal (rows,)."""
        return np.asarray(toeplitz(response / PROBE, np.zeros(rows))[:, kept] * allowed[kept])

    slopes = (struck.slopes - still.slopes)[:, plant.measured, :n]
    matrices = [[make_matrix(slopes[:, a, j]) for j in range(n)] for a in range(slopes.shape[1])]
    upper = {(i, j): sum(m[i].T @ m[j] for m in matrices) for i in range(n) for j in range(i, n)}
    grams = [[upper[i, j] if i <= j else upper[j, i].T for j in range(n)] for i in range(n)]
    sizes = [np.eye(len(kept)) / len(kept)]
    outputs = [o.name for o in plant.model.outputs]
    for signal, ends in question.limits.items():
        if signal in outputs and np.isfinite([ends.low, ends.high]).all():
            j = outputs.index(signal)
            room = max(ends.high - still.outputs[0, j], still.outputs[0, j] - ends.low)
            matrix = make_matrix((struck.outputs - still.outputs)[:, j] / room)
            sizes.append(matrix.T @ matrix / rows)
    return _smallest_bound(grams, sizes, np.eye(n) / GOAL_PRIOR_SPREAD**2)


def _smallest_bound(grams: Sequence[Sequence[np.ndarray]], sizes: Sequence[np.ndarray], prior: np.ndarray) -> float:
    n, lower = len(grams), np.tril_indices(len(grams))
    trace = np.array([[np.trace(g) for g in row] for row in grams]) / np.trace(sizes[0])
    scale = cholesky(np.linalg.inv(trace / len(sizes[0]) + prior), lower=True)

    def bound(v: np.ndarray) -> tuple[float, np.ndarray]:
        factor = np.zeros((n, n))
        factor[lower] = v[: len(lower[0])]
        root = scale @ factor
        weight = root @ root.T
        shares = np.exp(np.concatenate([[0.0], v[len(lower[0]) :]]))
        shares /= shares.sum()
        metric = cholesky(sum(t * a for t, a in zip(shares, sizes, strict=True)), lower=True)
        total = sum(weight[i, j] * grams[i][j] for i in range(n) for j in range(n))
        inner = solve_triangular(metric, solve_triangular(metric, total, lower=True).T, lower=True)
        values, vectors = eigsh((inner + inner.T) / 2, k=1, which="LA", tol=1e-8)
        u = solve_triangular(metric, vectors[:, 0], lower=True, trans="T")
        value = values[0] + np.trace(weight @ prior) - n - np.linalg.slogdet(weight)[1]
        along = np.array([[u @ g @ u for g in row] for row in grams]) + prior - np.linalg.inv(weight)
        moved = -values[0] * np.array([u @ a @ u for a in sizes])
        along_factor = 2 * (scale.T @ along @ root)
        return value, np.concatenate([along_factor[lower], (shares * (moved - shares @ moved))[1:]])

    start = np.concatenate([np.eye(n)[lower], np.zeros(len(sizes) - 1)])
    return float(0.5 * minimize(bound, start, jac=True, method="BFGS", options={"maxiter": 60}).fun / n)


def main() -> None:
    for name in sys.argv[1:]:
        title, fixed, limits, duration, step, noise = PLANTS[name]
        model = find_model(title).fix(*fixed)
        asked = {"limits": limits, "duration": duration, "sampling_time": step, "noise": noise, "options": REST}
        plan = gb.design(model, **asked)
        question = DesignProblem((model,), limits, duration, step, noise, options=REST)
        plant = make_plant(question, model)
        value = make_precision(question, 0).value([plant.run(plan.experiment.inputs)])
        least = np.exp(value - bound_precision(question, plant))
        best_other = max(a.gain for a in plan.alternatives if a.kind == "input" and a.name in USUAL)
        print(
            f"{name}: width {best_other:.2f} of the best other kind; no input makes it less than {least * best_other:.2f}"
            f" ({least:.2f} of the designed one)"
        )


if __name__ == "__main__":
    main()
