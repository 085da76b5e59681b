"""Linear black boxes on measured benchmark records: near the published linear errors. Skipped where the records are missing."""

import pytest

import greybox as gb
from fits.studies import measured_baselines as study


@pytest.fixture(scope="module")
def silverbox(shared_data):
    train, tests = study.silverbox_records(shared_data)
    return train.window(0, 10000), tests


@pytest.mark.rest
@pytest.mark.parametrize(
    "fit",
    [
        lambda r: gb.blackbox.arx(r, na=2, nb=3, nk=0, offset=True),
        lambda r: gb.blackbox.armax(r, na=2, nb=3, nc=1, nk=0, offset=True),
        lambda r: gb.blackbox.output_error(r, nb=3, nf=2, nk=0, offset=True),
    ],
    ids=["arx", "armax", "output error"],
)
def test_the_silverbox_is_at_the_published_linear_errors(silverbox, fit):
    train, tests = silverbox
    errors = study.black(fit(train), tests).errors
    for name, published in study.PUBLISHED_SILVERBOX.items():
        assert errors[name] == pytest.approx(published, rel=0.04), name


def test_the_tanks_are_near_the_published_linear_error(shared_data):
    train, tests = study.tank_records(shared_data)
    models = (
        gb.blackbox.arx(train, na=2, nb=1, nk=0, offset=True, focus="simulation"),
        gb.blackbox.armax(train, na=2, nb=2, nc=1, offset=True),
        gb.blackbox.output_error(train, nb=1, nf=2, nk=1, offset=True),
    )
    errors = [study.black(model, tests).errors["test"] / study.PUBLISHED_TANKS["test"] for model in models]
    assert max(errors) < 1.15 and min(errors) < 1.05
    assert min(errors) > 0.9  # an error far below it would be a mistake in the judging


@pytest.mark.slow
def test_physics_stands_beside_them(shared_data, tmp_path):
    study.main(shared_data, tmp_path, lambda text: None)  # asserts its verdict
    assert "published, linear" in (tmp_path / "real_data.md").read_text(encoding="utf-8")
