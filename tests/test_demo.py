"""The demonstration keeps its promise: the constants of a rig it did not share code with come back."""

from __future__ import annotations

import json

import pytest

from greybox import read_csv
from greybox.demo import KNOWN, NOISE, Demo, demo
from models.micro_actuator import micro_actuator


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Demo:
    return demo(tmp_path_factory.mktemp("demo"))


def test_the_constants_come_back_from_a_start_forty_percent_off(found: Demo) -> None:
    assert found.fit.status == "converged"
    assert found.truth == {n: v for n, v in micro_actuator.values.items() if n not in KNOWN}
    for name, truth in found.truth.items():
        assert abs(found.start[name] / truth - 1) == pytest.approx(0.4)
        assert abs(found.fit.parameters[name].value / truth - 1) < 0.02
        assert abs(found.deviations[name]) < 3.5
    assert max(abs(d) for d in found.deviations.values()) > 0.05  # an error of nothing would be no measurement


def test_only_noise_is_left_on_both_records(found: Demo) -> None:
    for misfit in (found.fit.misfit, found.fit.validation):
        assert set(misfit) == set(NOISE)
        for output, m in misfit.items():
            assert m.noise_ratio == pytest.approx(1, abs=0.04)
            assert m.rmse == pytest.approx(NOISE[output], rel=0.04)
    assert found.fit.notes == ()


def test_the_records_are_there_to_repeat_it(found: Demo) -> None:
    train, test = (read_csv(path, micro_actuator) for path in found.records)
    assert (train.rows, test.rows) == (6000, 3000)
    assert train.sampling_time == pytest.approx(2.5e-4)
    assert train.fingerprint == found.fit.traces[0].fingerprint
    assert json.loads(found.result.read_text())["success"] is True


def test_the_figures_are_drawn_and_small(found: Demo) -> None:
    assert [path.name for path in found.figures] == ["fit-multisine.png", "validation-sweep.png"]
    for path in found.figures:
        assert path.read_bytes().startswith(b"\x89PNG")
        assert 20_000 < path.stat().st_size < 600_000


def test_the_text_puts_found_beside_true(found: Demo) -> None:
    line = next(line for line in str(found).splitlines() if line.split()[:1] == ["K"])
    assert f"{micro_actuator.values['K']:.6g}" in line
    assert " std " in line
