"""What a reader should know about what was asked of a fit: priors, own and tied constants, a robust loss, sensors left out."""

from __future__ import annotations

from collections.abc import Mapping

from greybox.estimation.problem import EstimationProblem
from greybox.estimation.robust_estimation import OutlierSummary
from greybox.result import Estimate, PriorCheck
from greybox.units import format_unit

# A prior and the data that disagree by more standard deviations than this (one in a hundred) are worth a remark, ...
CONFLICT = 2.6
# ... and so is a prior from which the data took less than this share of its variance.
LITTLE = 0.2
# Share of a sensor's samples that may be outliers; more are no outliers.
MANY = 0.2


def find_option_issues(
    problem: EstimationProblem,
    constants: Mapping[str, Estimate],
    tied: Mapping[str, Estimate],
    per_experiment: Mapping[str, Mapping[str, Estimate]],
    priors: Mapping[str, PriorCheck],
    robust: OutlierSummary,
) -> tuple[str, ...]:
    """Sentences, the most important first."""
    result = [
        f"the prior of {name} and the data disagree by {abs(c.conflict):.2g} standard deviations: one of them, or the model, is wrong"
        for name, c in priors.items()
        if c.conflict is not None and abs(c.conflict) > CONFLICT
    ]
    held = [name for name, c in priors.items() if c.variance_reduction < LITTLE]
    if held:
        result.append(
            f"held by {'its prior' if len(held) == 1 else 'their priors'}: {', '.join(held)}; the data add little or nothing"
        )
    for name, e in tied.items():
        low, high = next(q.bounds for q in problem.model.stated_parameters if q.name == name)
        if not low <= e.value <= high:
            unit = format_unit(e.unit)
            result.append(
                f"{name}, which is tied, ends outside its bounds: {e.value:.5g} {unit}, bounds [{low:g}, {high:g}] {unit}"
            )
    if per_experiment:
        result.append(
            f"each experiment has its own {', '.join(per_experiment)}: the fitted model has the mean, which is what a validation uses"
        )
    if robust.loss:
        shares = [f"{100 * share:.2g} % of {name}" for name, share in robust.outliers.items() if share > 0]
        found = f"{', '.join(shares)} count as outliers" if shares else "no sample counts as an outlier"
        result.append(f"robust loss ({robust.loss}): {found}")
        many = [name for name, share in robust.outliers.items() if share > MANY]
        if many:
            result.append(
                f"so many samples of {', '.join(many)} are no outliers: the model lacks something, or the noise is larger"
            )
    return (*result, *find_excluded_outputs(problem))


def find_excluded_outputs(problem: EstimationProblem) -> tuple[str, ...]:
    """What to know of sensors that read the same in every row."""
    if not problem.still:
        return ()
    which, it, its = (", ".join(problem.still), *(("reads", "its") if len(problem.still) == 1 else ("read", "their")))
    return (
        f"left out: {which}, which {it} the same in every row and may be dead; {its} noise cannot be told, and if it is given the"
        " sensor counts",
    )
