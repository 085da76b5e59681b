"""Result files that an earlier version has written: they are read, and the keys of each kind are what they were, in their order.

The records in them are cut to their first rows.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from greybox.base.json_file import read_json
from greybox.base.json_shape import iterate_json
from greybox.comparison.result import Comparison
from greybox.discovery.result import Discovery
from greybox.estimation.check import ModelCheck
from greybox.estimation.result import Fit, load_fit
from greybox.estimation.uncertainty import Bootstrap, Profile, load_bootstrap, load_profile
from greybox.extensions.changes.result import ChangeDetection
from greybox.extensions.design.campaign import Campaign
from greybox.extensions.design.problem import Design
from greybox.extensions.export.linear_files import LinearFile
from greybox.shell.answers import FitAnswer
from models.micro_actuator import micro_actuator
from models.silverbox import silverbox
from tests.support.result_schema import find_schema, strict_offences

GOLDEN = Path(__file__).parents[1] / "golden"
KINDS: dict[str, Any] = {
    "fit_answer": FitAnswer,
    "fit_multistart": Fit,
    "fit_process_noise": Fit,
    "fit_robust": Fit,
    "fit_tied": Fit,
    "fit_validated": Fit,
    "profile": Profile,
    "bootstrap": Bootstrap,
    "campaign": Campaign,
    "changed": ChangeDetection,
    "check": ModelCheck,
    "compare": Comparison,
    "design": Design,
    "discovery": Discovery,
    "linear_model": LinearFile,
}
MODELS = {
    "fit_multistart": silverbox,
    "fit_process_noise": silverbox,
    "fit_robust": micro_actuator,
    "fit_tied": micro_actuator,
    "fit_validated": silverbox,
}


@pytest.mark.parametrize("name", KINDS)
def test_a_file_is_as_its_schema_says(name):
    data = read_json(GOLDEN / f"{name}.json", KINDS[name])
    assert strict_offences(data, KINDS[name]) == []


@pytest.mark.parametrize("name", KINDS)
def test_keys_and_their_order_stay(name):
    schema = find_schema(KINDS[name])
    assert misplaced(json.loads((GOLDEN / f"{name}.json").read_text()), schema, schema["$defs"]) == []


def misplaced(data: Any, schema: dict[str, Any], definitions: dict[str, Any], place: str = "") -> list[str]:
    """Places of objects whose keys are not those that this version writes, in its order; optional ones may lack."""
    schema = definitions[schema["$ref"].rpartition("/")[2]] if "$ref" in schema else schema
    if isinstance(data, list):
        return [
            text
            for k, each in enumerate(data)
            for text in misplaced(each, schema.get("items", {}), definitions, f"{place}[{k}]")
        ]
    if not isinstance(data, dict):
        return []
    known = schema.get("properties")
    faults = [] if known is None or [*data] == [key for key in known if key in data] else [f"{place}: {[*data]}"]
    for key, each in data.items():
        inner = schema.get("additionalProperties", {}) if known is None else known.get(key, {})
        faults += misplaced(each, inner, definitions, f"{place}.{key}")
    return faults


@pytest.mark.parametrize("name", MODELS)
def test_a_fit_is_written_again_as_it_was(name):
    fit = load_fit(GOLDEN / f"{name}.json", MODELS[name])
    assert "".join(iterate_json(fit)) == (GOLDEN / f"{name}.json").read_text()


@pytest.mark.parametrize(("name", "load"), [("profile", load_profile), ("bootstrap", load_bootstrap)])
def test_intervals_are_written_again_as_they_were(name, load):
    # To the byte; keys that came later follow behind.
    before = (GOLDEN / f"{name}.json").read_text().removesuffix("\n}\n")
    assert "".join(iterate_json(load(GOLDEN / f"{name}.json"))).startswith(before)
