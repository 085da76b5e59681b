"""Operating conditions: constants that an experiment brings itself, such as the supply pressure it was run at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from greybox.errors import ModelError, nearest
from greybox.model import Model


def resolve_conditions(
    model: Model, conditions: Sequence[Mapping[str, float]], per_experiment: Sequence[str] = ()
) -> tuple[dict[int, float], ...]:
    """For each experiment its conditions, as position in ``system.p`` -> value.

    A condition is a parameter of the model with a value of its own in that experiment, in the parameter's unit; experiments that
    do not name it keep the model's value. It is known, so it is not fitted.

    Parameters
    ----------
    model
        The model whose parameters are meant.
    conditions
        For each experiment name -> value.
    per_experiment
        Constants that each experiment has for itself: those may be given for some experiments only.

    Raises
    ------
    ModelError
        With all offenders: a name that the model does not have, a value that its bounds or the model's rules refuse, and a free
        constant that only some experiments give (for the others it would be fitted, and then it is no condition).
    """
    names = list(model.values)
    problems = []
    for e, given in enumerate(conditions):
        subject = f"experiment {e + 1} of {len(conditions)}"
        tied = {tie.name: tie for tie in model.ties}
        problems += [
            f"{subject}: condition {n!r} is tied in {model.title}, {tied[n]}; first untie({n!r})"
            for n in given
            if n in tied
        ]
        unknown = [n for n in given if n not in names and n not in tied]
        problems += [
            f"{subject}: condition {n!r} is not a parameter of {model.title}; {nearest(n, names)}" for n in unknown
        ]
        try:
            model.start(**{n: v for n, v in given.items() if n in names})
        except ModelError as error:
            problems.append(f"{subject}, its conditions: {error}")
    for q in model.free_parameters:
        missing = [str(e + 1) for e, given in enumerate(conditions) if q.name not in given]
        if 0 < len(missing) < len(conditions) and q.name not in per_experiment:
            problems.append(
                f"condition {q.name!r} is free in the model but not given for experiment {', '.join(missing)}; give it for every"
                f" experiment, or fix it: model.fix({q.name}=...)"
            )
    if problems:
        raise ModelError("; ".join(problems))
    return tuple({names.index(n): float(v) for n, v in given.items()} for given in conditions)


def check_own_constants(model: Model, per_experiment: Sequence[str], experiments: int) -> None:
    """Refuse constants that cannot be each experiment's own: ModelError with all offenders, why, and what to do."""
    problems = []
    for name in per_experiment:
        try:
            quantity = model.parameter(name)
        except ModelError as error:
            problems.append(str(error))
            continue
        if quantity.fixed:
            problems.append(f"{name!r} is fixed at {quantity.value:g} {quantity.unit}; first free({name!r})")
    twice = sorted({n for n in per_experiment if list(per_experiment).count(n) > 1})
    problems += [f"{name!r} is named twice; name it once" for name in twice]
    if per_experiment and experiments < 2:
        problems.append("there is one experiment; a separate value for each experiment needs several")
    if problems:
        raise ModelError(f"own parameters: {'; '.join(problems)}")


def apply_conditions(p: np.ndarray, conditions: Mapping[int, float]) -> np.ndarray:
    """The parameters (np,) with those that an experiment gives replaced; ``p`` itself is left alone."""
    p = p.copy()
    p[list(conditions)] = list(conditions.values())
    return p
