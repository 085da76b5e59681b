"""After a fit that left constants open: what would tell them."""

from __future__ import annotations

from greybox.errors import DataError
from greybox.identifiability.structural import analyse_structural_identifiability
from greybox.result import Fit


def recommend_after_fit(fit: Fit) -> tuple[str, ...]:
    """Sentences on what would determine the constants that the records of ``fit`` left open; none where none is, or it cannot be told.

    Another output of the model that was not measured, a sensor, a constant that is known, or a relation between two (tried one
    after the other, see `analyse_structural_identifiability`); or, where the measured outputs could tell them all, a richer record.
    """
    open_ = [n for n, e in fit.parameters.items() if not e.fixed and e.std is None and not e.at_bound]
    if not (fit.success and open_):
        return ()
    try:
        found = analyse_structural_identifiability(
            fit.model, list(fit.misfit), at_rest=bool(fit.provenance.options.get("at_rest", False))
        )
    except DataError:  # a nonlinear model that overflows wherever it is looked at
        return ()
    if found.complete:
        inputs = f": move {', '.join(found.inputs)} more, and faster and slower" if found.inputs else ""
        return (f"{found.verdict} by a record that is rich enough{inputs}",)
    return found.remedies
