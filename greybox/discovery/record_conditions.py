"""Several records as witnesses: which constants of an answer follow which condition of the records (a load, a temperature, a voltage)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from greybox.base.findings import Finding
from greybox.data.experiment import Experiment
from greybox.estimation import Fit, FitOptions
from greybox.estimation.findings import EstimationCode
from greybox.estimation.fit import fit as estimate
from greybox.estimation.record_trends import shared_conditions


def follow_conditions(fit: Fit, records: Sequence[Experiment], options: FitOptions) -> tuple[Finding, ...]:
    """What the constants of a model have in common over records that differ in a condition, one finding each.

    Parameters
    ----------
    fit
        The answer of a search.
    records
        Those that were fitted, and those that judged: for this question each is a witness.
    options
        How a fit is made.

    Returns
    -------
    tuple of Finding
        `EstimationCode.VALUES_BY_RECORD` for each constant; empty where the records have no condition in common that differs.
    """
    if len(records) < 2 or not shared_conditions(records):
        return ()
    # Shapes (a velocity, a time constant) stay common to all: one record alone seldom tells them, and the amplitude would take their place.
    shapes = {
        bound.model_names[q.name]
        for bound in fit.model.bound_effects
        for q in bound.effect.parameters
        if q.name not in bound.effect.amplitudes
    }
    given = {name for record in records for name in record.conditions}
    amplitudes = [q.name for q in fit.model.free_parameters if q.name not in shapes | given]
    if not amplitudes:
        return ()
    near = replace(options, progressive=False, other_starts=False, per_experiment=())
    each = estimate(fit.model, records, noise=fit.noise.given, per_experiment=amplitudes, options=near)
    return tuple(f for f in each.findings if f.code == EstimationCode.VALUES_BY_RECORD) if each.success else ()
