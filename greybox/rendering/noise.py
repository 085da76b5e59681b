"""Where the noise is known from, and its colour, in a few words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from greybox.noise import BoundDirection, NoiseSource
from greybox.rendering.registry import renders

if TYPE_CHECKING:
    from greybox.noise import AutoRegression, NoiseModel

SOURCES: Mapping[NoiseSource, str] = {
    NoiseSource.GIVEN: "given",
    NoiseSource.QUIET_RECORD: "a quiet record",
    NoiseSource.REPEATED_PERIODS: "repeated periods",
    NoiseSource.REPEATED_EXPERIMENTS: "repeated experiments",
    NoiseSource.FLAT_PIECES: "flat pieces of the records",
    NoiseSource.SPECTRUM: "the frequencies without signal",
    NoiseSource.DIFFERENCES: "differences of the records",
    NoiseSource.RESIDUAL: "the residual of the fit",
    NoiseSource.INNOVATIONS: "the innovations",
}
# What a level bounds, and why it may be larger than the noise.
_AT_MOST = {
    NoiseSource.FLAT_PIECES: "the loudest flat pieces of the records",
    NoiseSource.SPECTRUM: "what no linear response explains of the records, nonlinear motion included",
    NoiseSource.DIFFERENCES: "differences of the records, if the noise is white",
    NoiseSource.RESIDUAL: "the residual of the fit, which holds what the model lacks (too few samples for another source)",
}


@renders("AutoRegression")
def write_autoregression(process: AutoRegression) -> str:
    """``white``, or order and correlation."""
    if not process.order:
        return "white"
    return f"AR({process.order}), correlation {process.autocorrelation(2)[1]:.2g} from sample to sample"


@renders("NoiseModel")
def write_noise_model(noise: NoiseModel) -> str:
    """``given``, or ``x: estimated from a quiet record (AR(2), ...); i: ...``."""
    colours = dict(zip(noise.outputs, noise.colour, strict=True))
    groups: dict[str, list[str]] = {}
    for name, source in noise.sources.items():
        bound = noise.bound(name)
        text = describe_source(source, colours[name], source.direction if bound is None else bound.direction)
        groups.setdefault(text, []).append(name)
    if len(groups) == 1:
        return next(iter(groups))
    return "; ".join(f"{', '.join(names)}: {text}" for text, names in groups.items())


def describe_source(source: NoiseSource, colour: AutoRegression, direction: BoundDirection | None = None) -> str:
    """Where the noise of one output is known from, with its colour, or what it is at most."""
    direction = direction or source.direction
    if direction is BoundDirection.AT_MOST:
        return f"at most {_AT_MOST.get(source, SOURCES[source])}"
    says_colour = source not in (NoiseSource.GIVEN, NoiseSource.DIFFERENCES, NoiseSource.RESIDUAL)
    with_colour = f" ({colour})" if says_colour or colour.order else ""
    if source is NoiseSource.GIVEN:
        return f"given{with_colour}"
    kind = "at least that of" if direction is BoundDirection.AT_LEAST else "estimated from"
    return f"{kind} {SOURCES[source]}{with_colour}"
