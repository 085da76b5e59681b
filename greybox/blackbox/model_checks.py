"""Checks of a fitted black-box model: weak excitation, instability, an unfinished search."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from greybox.blackbox.findings import BlackBoxFinding
from greybox.findings import Finding, Severity

if TYPE_CHECKING:
    from greybox.blackbox.polynomial import PolynomialModel
    from greybox.blackbox.sampled_data import SampledData


def find_weak_excitation(data: SampledData, needed: int, nb: Sequence[int]) -> tuple[Finding, ...]:
    """A finding for each input whose order of persistent excitation is below the ``needed`` number of coefficients.

    The order is 1 for a constant or a step and 2 for each sine; each carries one coefficient. Several inputs share the
    ``needed`` coefficients, so that each is compared with its own ``nb`` there.
    """
    from greybox.identifiability import analyse_excitation  # which loads a solver that a black-box model does not need

    analyses = [analyse_excitation(experiment) for experiment in data.experiments]
    findings = []
    for i, name in enumerate(data.inputs):
        required = min(needed if len(data.inputs) == 1 else nb[i], max(a.limit for a in analyses))
        order = max(a.orders[name] for a in analyses)
        if order < required:
            values = {"order": order, "required": required}
            findings.append(Finding(BlackBoxFinding.WEAK_EXCITATION, Severity.WARNING, name, values))
    return tuple(findings)


def find_instability(model: PolynomialModel) -> tuple[Finding, ...]:
    """A finding with the outermost pole of an unstable model and the samples in which a free run grows by a factor of e."""
    if model.stable:
        return ()
    outermost = float(np.abs(model.poles[0]))
    growth = np.inf if outermost == 1 else 1 / np.log(outermost)
    values = {"pole": outermost, "growth_samples": float(growth), "equation_error": len(model.a) > 1}
    return (Finding(BlackBoxFinding.UNSTABLE, Severity.WARNING, model.output, values),)


def find_unfinished_search(converged: bool, iterations: int) -> tuple[Finding, ...]:
    """A finding where the search ended at its limit of iterations."""
    if converged:
        return ()
    return (Finding(BlackBoxFinding.SEARCH_UNFINISHED, Severity.WARNING, values={"iterations": iterations}),)
