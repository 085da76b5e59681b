"""Result files are as their schema says, older ones are read, and the first offence of another one is named."""

from __future__ import annotations

import copy
import json

import numpy as np
import pytest
from jsonschema import Draft202012Validator

import greybox as gb
from greybox.base.errors import DataError
from greybox.base.json_file import parse_json, read_json
from greybox.comparison.result import Comparison
from greybox.data.noise.noise_model import NoiseSource
from greybox.discovery.execution import RefitEntry
from greybox.discovery.result import Discovery
from greybox.estimation.check import ModelCheck, check
from greybox.estimation.result import Fit, load_fit
from greybox.estimation.uncertainty import Bootstrap, Profile
from greybox.extensions.changes.result import ChangeDetection
from greybox.extensions.design.campaign import Campaign
from greybox.extensions.design.problem import Design
from greybox.extensions.export.linear_files import LinearFile
from greybox.shell.answers import FitAnswer
from greybox.shell.printed import ComparisonAnswer
from models.silverbox import silverbox
from tests.oracles.independent import linear_record, multisine
from tests.support.result_schema import find_schema, strict_offences

KINDS = (
    *(
        Discovery,
        RefitEntry,
        Fit,
        FitAnswer,
        Profile,
        Bootstrap,
        Comparison,
        ComparisonAnswer,
        Design,
        Campaign,
        ChangeDetection,
    ),
    *(ModelCheck, LinearFile),
)

RECORD = linear_record(silverbox, multisine(np.random.default_rng(1), 120, 1.6384e-3, 5, 200, 0.1), 1.6384e-3)


@pytest.fixture(scope="module")
def fit():
    free = [q.name for q in silverbox.free_parameters]
    start = silverbox.start(**{name: 1.3 * silverbox.values[name] for name in free})
    return gb.fit(start, RECORD, noise={"y": 1e-4}, validation=RECORD)


@pytest.fixture(scope="module")
def saved(fit, tmp_path_factory):
    return fit.save(tmp_path_factory.mktemp("saved") / "fit.json")


@pytest.fixture
def changed(saved, tmp_path):
    """Writes the fit with one change, and loads it."""

    def change(edit):
        data = json.loads(saved.read_text())
        edit(data)
        (tmp_path / "fit.json").write_text(json.dumps(data))
        return load_fit(tmp_path / "fit.json", silverbox)

    return change


# --- the schema


@pytest.mark.parametrize("kind", KINDS)
def test_the_schema_is_one_of_draft_2020_12(kind):
    Draft202012Validator.check_schema(find_schema(kind))


@pytest.mark.parametrize("kind", KINDS)
def test_every_value_of_the_schema_is_described(kind):
    schema = find_schema(kind)
    kinds = {"file": schema, **schema["$defs"]}
    bare = [
        f"{name}.{key}"
        for name, each in kinds.items()
        for key, value in each.get("properties", {}).items()
        if not value.get("description") and "$ref" not in value
    ]
    assert not bare


def test_a_fit_holds_what_the_schema_describes_and_nothing_else(saved):
    assert strict_offences(json.loads(saved.read_text()), Fit) == []


def test_a_linear_model_and_a_check_hold_what_the_schema_describes(fit, tmp_path):
    linear = gb.export.write_linear(fit, tmp_path / "linear.json", "json", samples=3)
    assert strict_offences(read_json(linear, LinearFile), LinearFile) == []
    assert strict_offences(json.loads(json.dumps(check(silverbox, RECORD).as_dict())), ModelCheck) == []


# --- older and newer files


def test_a_file_of_the_first_version_is_read(changed, saved):
    """The first files lacked keys that came later, and named the source of the noise in words."""
    keys = """findings status_details search noise_log_std noise_units noise_bounds interval_kind inflation reach tied ties own priors
        loss loss_scale outliers ends process_noise prediction log_likelihood noise_colour discretisation_shift"""
    younger = set(keys.split())

    def first_version(data):
        for key in younger:
            data.pop(key, None)
        data["noise_sources"] = {"y": "the records' differences"}
        for trace in data["traces"]:
            del trace["inputs"], trace["hold"], trace["conditions"]

    fit = changed(first_version)
    assert fit.noise.sources["y"] is NoiseSource.DIFFERENCES
    assert fit.parameters == load_fit(saved, silverbox).parameters


def test_keys_of_a_later_version_are_passed_over(changed, saved):
    def later(data):
        data["colour"] = "green"
        for group in (*data["parameters"].values(), *data["misfit"].values(), *data["traces"]):
            group["more"] = [1, 2]
        data["findings"] = [{"code": "sensor_upside_down", "severity": "warning", "subject": "y", "values": {}}]

    fit = changed(later)
    assert fit.parameters == load_fit(saved, silverbox).parameters
    assert "(sensor_upside_down)" in fit.notes[0]


def test_a_later_format_is_named(changed):
    with pytest.raises(
        DataError, match=r"fit\.json: a fit of format 2, written by a later version; this one reads up to 1"
    ):
        changed(lambda data: data.update(format=2))


# --- the first offence


def name_of(data):
    return next(iter(data["parameters"]))


OFFENCES = [
    (lambda d: d.pop("cost"), "it lacks the key 'cost'"),
    (lambda d: d["traces"][0].pop("time"), r"traces\[0\] lacks the key 'time'"),
    (lambda d: d["misfit"]["y"].update(rmse="small"), r'misfit\.y\.rmse is "small" and must be a number or null'),
    (lambda d: d["traces"][0]["inputs"].update(u="nan"), r'traces\[0\]\.inputs\.u is "nan" and must be a list'),
    (lambda d: d["traces"][0]["time"].__setitem__(3, None), r"traces\[0\]\.time\[3\] is null and must be a number"),
    (lambda d: d.update(success=1), "success is 1 and must be true or false"),
    (lambda d: d.update(interval_kind="guess"), 'interval_kind is "guess" and must be one of gauss_newton, '),
    (lambda d: d["parameters"][name_of(d)].update(interval=[1.0]), "is a list of 1 and must have at least 2 entries"),
    (lambda d: d["parameters"][name_of(d)].update(value=10**400), "is a number out of range and must be at most"),
    (lambda d: d.update(effects={}), "effects is an object and must be a list"),
    (lambda d: d["covariance"].pop(), "covariance is no matrix of"),
    (lambda d: d["covariance"][0].pop(), "covariance is no matrix of"),
    (lambda d: d["traces"][0]["simulated"]["y"].pop(), r"traces\[0\]\.simulated\.y has 119 rows, its time 120"),
    (lambda d: d["misfit"]["y"].update(unit="V!"), r"misfit\.y: unit 'V!' cannot be read"),
    (lambda d: d["free"].__setitem__(0, "nan"), "free names a parameter that parameters does not"),
    (lambda d: d.update(ties={"K": "B"}), "tied and ties do not name the same parameters"),
    (lambda d: d["traces"][0]["time"].__setitem__(3, 0.0), r"traces\[0\]: time goes back at row 4"),
    (lambda d: d["parameters"].update(extra=next(iter(d["parameters"].values()))), "extra"),
]


@pytest.mark.parametrize(("edit", "message"), OFFENCES, ids=[message[:40] for _, message in OFFENCES])
def test_the_first_offence_is_named(changed, edit, message):
    with pytest.raises(DataError, match=rf"fit\.json: .*{message}"):
        changed(edit)


TEXTS = {
    "empty": b"",
    "cut short": b'{"format": 1, "model": "x"',
    "no object": b"[]",
    "not a number": b'{"format": NaN}',
    "nested deeply": b'{"format": ' + b"[" * 20_000,
    "thousands of digits": b'{"format": ' + b"9" * 10_000 + b"}",
    "another encoding": '{"format": 1}'.encode("utf-16"),
    "half a character": rb'{"format": 1, "model": "\ud800"}',
    "bytes": bytes(range(256)),
}


@pytest.mark.parametrize("text", TEXTS.values(), ids=TEXTS)
@pytest.mark.parametrize("kind", KINDS)
def test_what_is_no_result_is_refused(tmp_path, text, kind):
    (tmp_path / "some.json").write_bytes(text)
    with pytest.raises(DataError, match=r"some\.json: not ") as error:
        read_json(tmp_path / "some.json", kind)
    assert len(str(error.value)) < 500


def test_what_is_no_file_is_refused(tmp_path):
    for path in (tmp_path / "missing.json", tmp_path):
        with pytest.raises(DataError, match="give the fit"):
            read_json(path, Fit)


def test_long_lists_of_numbers_are_checked_as_the_schema_says(saved):
    """The way around for long lists gives what the plain validator gives."""
    number = {"type": "array", "items": {"$ref": "#/$defs/number_or_null"}, "$defs": find_schema(Fit)["$defs"]}
    plain = Draft202012Validator(number)
    from greybox.base.json_file import _validator

    quick = _validator(Fit).evolve(schema=plain.schema)
    for values in ([1.0, None], [1.0, 2], [1.0, "x"], [True], [10**400], [float("inf")], [[1.0]], "x", [None, {}]):
        assert [e.json_path for e in quick.iter_errors(values)] == [e.json_path for e in plain.iter_errors(values)]


def test_json_is_read_by_the_letter():
    assert parse_json('{"a": "ü€𝄞"}'.encode()) == {"a": "ü€𝄞"}
    assert parse_json(rb'{"a": "\ud834\udd1e"}') == {"a": "𝄞"}
    data = {"a": [1.5, None]}
    assert parse_json(json.dumps(copy.deepcopy(data)).encode()) == data
