"""Where the noise is known from, and its colour, in a few words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from greybox.noise.noise_sources import NoiseSource
from greybox.rendering.registry import renders

if TYPE_CHECKING:
    from greybox.noise import AutoRegression, NoiseModel

SOURCES: Mapping[NoiseSource, str] = {
    NoiseSource.GIVEN: "given",
    NoiseSource.QUIET_RECORD: "a quiet record",
    NoiseSource.REPEATED_PERIODS: "repeated periods",
    NoiseSource.REPEATED_EXPERIMENTS: "repeated experiments",
    NoiseSource.DIFFERENCES: "differences of the records",
    NoiseSource.RESIDUAL: "the residual of the fit",
    NoiseSource.INNOVATIONS: "the innovations",
}
# What to hold against a source that cannot show the colour of the noise.
_CAVEATS = {
    NoiseSource.DIFFERENCES: " (too small if the noise is coloured)",
    NoiseSource.RESIDUAL: " (too few samples for a better estimate)",
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
        groups.setdefault(describe_source(source, colours[name]), []).append(name)
    if len(groups) == 1:
        return next(iter(groups))
    return "; ".join(f"{', '.join(names)}: {text}" for text, names in groups.items())


def describe_source(source: NoiseSource, colour: AutoRegression) -> str:
    """Where the noise of one output is known from, with its colour and what to hold against it."""
    says_colour = source not in (NoiseSource.GIVEN, NoiseSource.DIFFERENCES, NoiseSource.RESIDUAL)
    with_colour = f" ({colour})" if says_colour or colour.order else ""
    if source is NoiseSource.GIVEN:
        return f"given{with_colour}"
    return f"estimated from {SOURCES[source]}{with_colour}{_CAVEATS.get(source, '') if not with_colour else ''}"
