"""After a fit that left constants open: what would determine them."""

from __future__ import annotations

from greybox.errors import DataError
from greybox.findings import Finding
from greybox.identifiability.findings import IdentifiabilityCode
from greybox.identifiability.structural import analyse_structural_identifiability
from greybox.result import Fit


def recommend_after_fit(fit: Fit) -> tuple[Finding, ...]:
    """What would determine the constants that the records of a fit left open.

    Another output of the model that was not measured, a sensor, a constant that is known, or a relation between two (tried one
    after the other, see `analyse_structural_identifiability`); or, where the measured outputs could show them all, a richer record.

    Parameters
    ----------
    fit
        A fit, of which some free constants may have no standard deviation.

    Returns
    -------
    tuple of Finding
        The most effective first; empty where no constant is open, or nothing can be said.

    Examples
    --------
    >>> [finding.code for finding in recommend_after_fit(fit)]  # doctest: +SKIP
    ['measure_output', 'fix_constants']
    """
    undetermined = [n for n, e in fit.parameters.items() if not e.fixed and e.std is None and not e.at_bound]
    if not (fit.success and undetermined):
        return ()
    try:
        at_rest = bool(fit.provenance.options.get("at_rest", False))
        structure = analyse_structural_identifiability(fit.model, list(fit.misfit), at_rest=at_rest)
    except DataError:  # a nonlinear model that overflows wherever it is looked at
        return ()
    if structure.complete:
        figures = {
            "inputs": list(structure.inputs),
            "outputs": list(structure.outputs),
            "count": structure.count,
            "certain": structure.certain,
        }
        return (Finding(IdentifiabilityCode.RICHER_RECORD, values=figures),)
    return structure.recommendations
