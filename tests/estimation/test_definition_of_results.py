"""A saved result is joined with the model that it was fitted with: one that was edited since is refused, with both lines."""

from dataclasses import replace

import numpy as np
import pytest

from greybox import Balance, Experiment, Input, Model, Output, Parameter, State, fit, load_fit
from greybox.base import DataError
from greybox.estimation.result import ResultCode
from greybox.model import Block
from greybox.model.effects import effect
from greybox.model.equations import compare_definition, declare, equations_text, identify


def tank(
    drain="sqrt", unit="Pa", bounds=(0.1, 10.0), start=0.0, area=2.0, more=(), scale=1.0, high=np.inf, reading=1.0
):
    def balances(x, u, p):
        out = {"sqrt": -p.k * x.p, "square": -p.k * x.p * x.p, "twice": -2 * p.k * x.p}[drain]
        extra = {"leak": -p.leak * x.p} if more else {}
        return [Balance("volume", "m^3/s", p.A, "p", inflow=scale * u.q, outflow=out, **extra)]

    per = f"m^3/s/{unit}"
    return Model(
        "tank",
        states=[State("p", unit, start, (-np.inf, high))],
        inputs=[Input("q", "m^3/s")],
        outputs=[Output("y", unit, lambda x, u, p: reading * x.p)],
        parameters=[
            Parameter("A", f"m^3/{unit}", area, (0.01, 100.0), fixed=True),
            Parameter("k", per if drain != "square" else f"{per}/{unit}", 1.0, bounds),
            *(Parameter(name, per, 0.1, (0.0, 1.0)) for name in more),
        ],
        balances=balances,
    )


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    t = 0.1 * np.arange(80)
    q = np.sign(np.sin(t))
    y = np.zeros(len(t))
    for k in range(len(t) - 1):
        y[k + 1] = np.exp(-0.05 * 1.5) * y[k] + (1 - np.exp(-0.05 * 1.5)) / 1.5 * q[k]
    noise = 0.01 * np.random.default_rng(0).normal(size=len(t))
    result = fit(tank(), Experiment.from_arrays(t, {"q": q}, {"y": y + noise}))
    return result.save(tmp_path_factory.mktemp("fit") / "fit.json"), result


EDITS = {
    "a factor in a term": ({"drain": "twice"}, "2 k p"),
    "another law": ({"drain": "square"}, "k p^2"),
    "a factor at an input": ({"scale": 0.001}, "0.001 q"),
    "an output that is scaled": ({"reading": 1.02}, "1.02 p"),
    "a unit with another prefix": ({"unit": "kPa"}, "kPa"),
    "bounds": ({"bounds": (0.0, 10.0)}, "0 to 10"),
    "where a state begins": ({"start": 0.3}, "starts at 0.3"),
    "the range of a state": ({"high": 5.0}, "to 5"),
    "a constant that the file does not have": ({"more": ("leak",)}, "leak"),
}


@pytest.mark.parametrize(("edit", "line"), EDITS.values(), ids=EDITS)
def test_a_model_that_was_edited_since_is_refused_with_both_lines(saved, edit, line):
    path, _ = saved
    with pytest.raises(DataError) as error:
        load_fit(path, tank(**edit))
    fitted, now = (
        [text for text in str(error.value).splitlines() if text.strip().startswith(word)] for word in ("fitted", "now")
    )
    assert len(fitted) == len(now) > 0
    assert any(line in text for text in now) and not any(line in text for text in fitted)


def test_whoever_insists_is_told_what_differs(saved):
    path, result = saved
    forced = load_fit(path, tank(drain="twice"), insist=True)
    (finding,) = (f for f in forced.findings if f.code == ResultCode.OTHER_MODEL)
    assert finding.values["fitted"].endswith("A dp/dt = q - k p")
    assert finding.values["now"].endswith("A dp/dt = q - 2 k p")
    again = load_fit(forced.save(path.with_name("forced.json")), forced.model, insist=True)
    assert again.findings == forced.findings == (finding, *result.findings)


def test_the_model_of_the_fit_is_taken_without_a_word(saved):
    path, result = saved
    for model in (tank(), tank().start(k=3.0), tank().fix("k"), tank().prior(k=(1.0, 0.5)), result.model):
        assert load_fit(path, model).findings == result.findings


def test_a_known_constant_with_another_value_is_said(saved):
    path, _ = saved
    loaded = load_fit(path, tank(area=3.0))
    (finding,) = (f for f in loaded.findings if f.code == ResultCode.OTHER_CONSTANT)
    assert (finding.subject, finding.values["fitted"], finding.values["now"]) == ("A", 2.0, 3.0)
    assert loaded.parameters["A"].value == loaded.model.values["A"] == 2.0


def test_a_file_that_states_no_bounds_is_compared_by_equations_and_units(saved):
    _, result = saved
    units = {name: each.unit for name, each in result.parameters.items()}
    assert not compare_definition(tank(bounds=(0.0, 9.0)), equations_text(tank()), {}, units)
    assert compare_definition(tank(unit="kPa"), "", {}, units)


def spring(hidden=1.0, gravity=9.81, wraps=0.0, free_start=False, seventh=5678901.0):
    """A mass whose stiff spring stands behind the name of a block."""

    def balances(x, u, p):
        body = Block("-stiff spring", -hidden * p.k * x.x, "N")
        terms = {"drive": p.f * u.u, "weight": -gravity * p.g * p.m, "body": body, "small": seventh * 1e-6 * p.k * x.x}
        return [Balance("position", "m/s", 1, "x", velocity=x.v), Balance("force", "N", p.m, "v", **terms)]

    constants = (("m", "kg"), ("k", "N/m"), ("f", "N/V"), ("g", "m/s^2"))
    return Model(
        "spring",
        states=[State("x", "m", free_start=free_start), State("v", "m/s")],
        inputs=[Input("u", "V")],
        outputs=[Output("x", "m", wraps=wraps)],
        parameters=[Parameter(name, unit, 1.0, (0.1, 10.0)) for name, unit in constants],
        balances=balances,
    )


HIDDEN = ({"hidden": 2.0}, {"gravity": 9.810001}, {"wraps": 6.0}, {"free_start": True}, {"seventh": 5678902.0})


@pytest.mark.parametrize("edit", HIDDEN, ids=lambda edit: next(iter(edit)))
def test_what_the_equations_do_not_show_is_stated_too(edit):
    model, edited = spring(), spring(**edit)
    assert equations_text(model) == equations_text(edited)
    (difference,) = compare_definition(edited, equations_text(model), declare(model), {})
    assert difference.stored != difference.present
    assert not compare_definition(spring(), equations_text(model), declare(model), {})
    # Finished work is known by the same; a wrapped reading is another record.
    assert (identify(model) == identify(edited)) == ("wraps" in edit)


def test_files_without_digits_are_compared_by_what_they_state():
    model, stated = spring(), {n: line for n, line in declare(spring()).items() if not n.startswith("exactly")}
    assert not compare_definition(spring(gravity=9.810001), equations_text(model), stated, {})


def test_bounds_of_an_effect_follow_the_records():
    delayed = tank() + effect("transport_delay")
    name = next(q.name for q in delayed.all_parameters if q.name not in tank().values)
    assert declare(delayed) == declare(delayed.bound(**{name: (0.0, 77.0)}))
    assert declare(tank()) != declare(replace(tank(), states=(State("p", "Pa", 1.0),)))
