"""Of a fit: what would tell the constants it left open, and the options for intervals that do not lean on the curvature at the optimum,
profile likelihood and the block bootstrap.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Annotated

import typer

from greybox.cli.options import Names
from greybox.errors import FitError, GreyboxError, nearest

if TYPE_CHECKING:
    from greybox.model import Model
    from greybox.result import Fit

# Of fewer replicates the ends of a 95 % interval are two or three single ones.
FEWEST = 100
SEED = 0

Profile = Annotated[
    Names,
    typer.Option(
        "--profile",
        metavar="NAME",
        default_factory=list,
        help="A constant whose interval is found by profile likelihood too, with 10 to 20 refits; may be repeated.",
    ),
]
Bootstrap = Annotated[
    int,
    typer.Option(
        "--bootstrap",
        metavar="N",
        min=0,
        help="Intervals of all constants by a block bootstrap with N replicates, too (1000 do).",
        show_default=False,
    ),
]


def check_intervals(model: Model, profiles: Iterable[str], replicates: int) -> tuple[str, ...]:
    """The constants to be profiled; refuses, before the fit, names that it will not find and too few replicates."""
    free = [q.name for q in model.free_parameters]
    names = tuple(dict.fromkeys(name for text in profiles for name in text.replace(",", " ").split()))
    for name in names:
        if name not in free:
            raise GreyboxError(f"--profile {name}: no constant that is fitted; {nearest(name, free)}")
    if 0 < replicates < FEWEST:
        raise GreyboxError(f"--bootstrap {replicates}: too few replicates for a 95 % interval; give {FEWEST} or more")
    return names


def describe_remedies(result: Fit) -> list[str]:
    """Lines on what would determine the constants that the records left open."""
    from greybox.identifiability import recommend_after_fit

    return [f"{'remedy' if k == 0 else 'or'}: {text}" for k, text in enumerate(recommend_after_fit(result))]


def further_intervals(result: Fit, profiles: Iterable[str], replicates: int) -> list[str]:
    """Lines with the intervals that were asked for; why there are none, where the fit has none to give."""
    lines: list[str] = []
    if not result.success:
        return lines
    try:
        if names := list(_labels(result, profiles)):
            lines += ["", "profile likelihood", *(f"  {line}" for line in _profiles(result, names))]
        if replicates:
            lines += ["", *_replicated(result, replicates)]
    except FitError as error:
        lines += ["", str(error)]
    return lines


def _labels(result: Fit, profiles: Iterable[str]) -> Iterable[str]:
    """A constant that each experiment has for itself is one for each of them."""
    for name in profiles:
        yield from (
            [f"{name} ({title})" for title in result.constraints.per_experiment[name]]
            if name in result.constraints.per_experiment
            else [name]
        )


def _profiles(result: Fit, names: Iterable[str]) -> Iterable[str]:
    from greybox.uncertainty import profile

    for name in names:
        zero = name in result.model.noise_parameters and result.model.values[name] == 0
        yield f"{name}: zero; its limit stands with the constants" if zero else str(profile(result, name))


def _replicated(result: Fit, replicates: int) -> Iterable[str]:
    import numpy as np

    from greybox.uncertainty import bootstrap

    found = bootstrap(result, np.random.default_rng(SEED), replicates=replicates)
    yield f"block bootstrap, {replicates} replicates in blocks of {found.block} rows"
    for name in found.names:
        low, high = found.interval[name]
        yield f"  {name}: standard deviation {found.std[name]:.3g}, 95 % [{low:.5g}, {high:.5g}]"
