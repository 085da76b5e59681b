"""Golden texts of noise sources and colours."""

import numpy as np
import pytest

from greybox.data.noise.noise_model import AutoRegression, BoundDirection, NoiseBound, NoiseModel, NoiseSource

WHITE, COLOURED = AutoRegression(), AutoRegression((0.9,))
GOLDEN = [
    (NoiseSource.GIVEN, WHITE, "given"),
    (NoiseSource.GIVEN, COLOURED, "given (AR(1), correlation 0.9 from sample to sample)"),
    (NoiseSource.QUIET_RECORD, WHITE, "estimated from a quiet record (white)"),
    (
        NoiseSource.QUIET_RECORD,
        COLOURED,
        "estimated from a quiet record (AR(1), correlation 0.9 from sample to sample)",
    ),
    (NoiseSource.REPEATED_PERIODS, WHITE, "estimated from repeated periods (white)"),
    (NoiseSource.REPEATED_EXPERIMENTS, WHITE, "estimated from repeated experiments (white)"),
    (NoiseSource.FLAT_PIECES, WHITE, "estimated from flat pieces of the records (white)"),
    (
        NoiseSource.SPECTRUM,
        WHITE,
        "at most what no linear response explains of the records, nonlinear motion included",
    ),
    (NoiseSource.DIFFERENCES, WHITE, "at most differences of the records, if the noise is white"),
    (
        NoiseSource.RESIDUAL,
        WHITE,
        "at most the residual of the fit, which holds what the model lacks (too few samples for another source)",
    ),
    (NoiseSource.INNOVATIONS, WHITE, "estimated from the innovations (white)"),
]


@pytest.mark.parametrize(("source", "colour", "text"), GOLDEN)
def test_each_source_has_its_words(source, colour, text):
    assert str(NoiseModel(("x",), np.ones(1), {"x": source}, (colour,), True)) == text


@pytest.mark.parametrize(
    ("direction", "source", "text"),
    [
        (
            BoundDirection.ABOUT,
            NoiseSource.SPECTRUM,
            "estimated from the frequencies without signal (AR(1), correlation 0.9 from sample to sample)",
        ),
        (BoundDirection.AT_MOST, NoiseSource.FLAT_PIECES, "at most the loudest flat pieces of the records"),
    ],
)
def test_a_bound_has_its_direction(direction, source, text):
    bounds = {"x": NoiseBound(1.0, direction, source)}
    assert str(NoiseModel(("x",), np.ones(1), {"x": source}, (COLOURED,), True, bounds)) == text


def test_outputs_with_one_source_share_its_words():
    sources = {"x": NoiseSource.GIVEN, "y": NoiseSource.QUIET_RECORD, "z": NoiseSource.GIVEN}
    noise = NoiseModel(("x", "y", "z"), np.ones(3), sources, (WHITE, WHITE, WHITE), True)
    assert str(noise) == "x, z: given; y: estimated from a quiet record (white)"


@pytest.mark.parametrize("source", NoiseSource)
def test_every_source_has_words(source):
    assert source in [each for each, _, _ in GOLDEN]


def test_the_phrases_of_older_files_are_read():
    assert NoiseSource("the records' differences") is NoiseSource.DIFFERENCES
    assert NoiseSource("quiet record") is NoiseSource.QUIET_RECORD
    with pytest.raises(ValueError, match="a guess"):
        NoiseSource("a guess")
