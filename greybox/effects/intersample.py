"""Between samples: what the input does there, as an effect of its own.

A record holds the input at its rows only. A computer holds it until the next row, which is what a model without one of these
effects assumes (or whatever the experiment says, see `greybox.Experiment.hold`); a measured input moves on. On a fast plant that
difference can outweigh every nonlinearity, so it is looked at before anything else.
"""

from __future__ import annotations

from greybox.model import Effect

TELLS_APART = (
    "Look at the input with an oscilloscope, or sample it ten times as fast: steps are held, straight lines and smooth curves are"
    " not. In the data a held input is late by half a sample and no more than that at every frequency, as a short delay is."
)

linear_input = Effect(
    "linear_input",
    site="input",
    parameters=[],
    hold="first",
    equation="u straight from sample to sample",
    parity="linear",
    tells_apart=TELLS_APART,
    source="first-order hold: Astrom, Wittenmark, Computer-Controlled Systems",
)

band_limited_input = Effect(
    "band_limited_input",
    site="input",
    parameters=[],
    hold="band-limited",
    equation="u without content above half the sampling rate",
    parity="linear",
    tells_apart=TELLS_APART,
    source="Pintelon, Schoukens, System Identification: A Frequency Domain Approach: the band-limited measurement setup",
)

BETWEEN_SAMPLES: tuple[Effect, ...] = (linear_input, band_limited_input)
