"""The study of certainty on measured records: its verdict on claims, and its round trip of an answer."""

import numpy as np
import pytest

import greybox as gb
from fits.studies.measured_certainty import is_same, judge_claim, round_trip, run_in_c, said, tell_effects, write_page
from fits.studies.measured_rigs import RIGS, SEARCHES
from greybox.discovery.disturbance_sites import list_disturbance_sites
from greybox.model.effects.catalogue import AT, all_effects


def claim(depth: int, site: str, variables: tuple[str, ...] = (), family: tuple[str, ...] = (), name: str = "") -> dict:
    return {"depth": depth, "site": site, "variables": variables, "family": family, "name": name}


@pytest.mark.parametrize(
    ("rig", "made", "right"),
    [
        ("light ball", claim(1, "balance force or sensor of h"), True),
        ("light ball", claim(2, "balance force", ("v",)), True),
        ("light ball", claim(2, "balance force", ("h",)), False),
        ("light ball", claim(4, "balance force", name="quadratic_damping"), True),
        ("light ball", claim(4, "balance force", name="second_mode"), False),
        ("heavy ball", claim(0, ""), False),
        ("heavy ball", claim(1, "balance force"), False),
        ("healthy rotor", claim(4, "input u", name="input_dead_zone"), False),
        ("braked rotor", claim(2, "balance torque", ("u",)), False),
        ("braked rotor", claim(2, "balance torque", ("u",)) | {"form": "timing"}, None),
        ("pendulum", claim(3, "balance torque", family=("stribeck_friction", "coulomb_friction")), True),
        ("pendulum", claim(4, "balance torque", name="lugre_friction"), None),
        ("heaters", claim(4, "balance heat_1", name="radiation_loss"), False),
        ("heaters", claim(4, "sensor of T2", name="sensor_lag_at_T2"), True),
        ("pushed damper", claim(4, "balance force", name="coulomb_friction"), False),
        ("pushed damper", claim(3, "balance force", family=("coulomb_friction", "bouc_wen_hysteresis")), True),
        ("silverbox", claim(4, "balance force", name="quadratic_damping"), True),
        ("silverbox", claim(4, "balance force", name="end_stop"), None),
    ],
)
def test_a_claim_is_judged_by_what_is_known_of_the_rig(rig: str, made: dict, right: bool | None) -> None:
    assert judge_claim(RIGS[rig], made) is right


@pytest.mark.parametrize("rig", [name for name, rig in RIGS.items() if rig.folder.startswith("known")])
def test_what_is_known_of_a_rig_is_about_its_own_sites_and_signals(rig: str, tmp_path) -> None:
    model = RIGS[rig].model(tmp_path)
    labels = {site.label for site in list_disturbance_sites(model, [o.name for o in model.outputs])}
    known = {effect.name for effect in all_effects()}
    for fact in RIGS[rig].facts:
        assert set(fact.sites) <= labels
        assert set(fact.variables) <= {*model.system.state_names, *(i.name for i in model.inputs), "time"}
        assert {name.partition(AT)[0] for name in fact.names} <= known
    assert set(RIGS[rig].open) <= known


def test_every_rig_is_searched_and_no_search_judges_on_what_it_has_seen() -> None:
    assert {case.rig for case in SEARCHES} == set(RIGS)
    for case in SEARCHES:
        stretches = [s.split() for s in (case.learn, case.choose, case.judge)]
        assert len({tuple(s) for s in stretches}) == 3
        for file, first, end in (s for s in stretches if len(s) == 3):
            overlapping = [
                s
                for s in stretches
                if s[0] == file and (len(s) == 1 or (int(s[1]) < int(end) and int(first) < int(s[2])))
            ]
            assert len(overlapping) == 1, case


@pytest.mark.rest
def test_an_answer_takes_its_round_trip() -> None:
    plant = gb.Model(
        "rotor",
        states=[gb.State("w", "rad/s", role="velocity")],
        inputs=[gb.Input("u", "V", role="drive")],
        outputs=[gb.Output("w", "rad/s")],
        parameters=[
            gb.Parameter("k", "rad/(s^2*V)", 3.0, (1e-3, 1e4)),
            gb.Parameter("b", "1/s", 2.0, (1e-4, 1e3), role="damping"),
        ],
        balances=lambda x, u, p: [gb.Balance("torque", "rad/s^2", 1, "w", drive=p.k * u.u, damping=-p.b * x.w)],
    )
    truth = (plant + gb.effect("coulomb_friction")).start(Fc=1.5)
    time, records = 0.02 * np.arange(300), []
    # Among the first draws of noise is one that remembers itself by chance, and leaves the name open.
    for seed in range(10, 13):
        generator = np.random.default_rng(seed)
        drive = np.repeat(generator.normal(0.0, 2.0, 20), 15)
        run = gb.simulate(truth, {"time": time, "u": drive})
        records.append(
            gb.Experiment(
                f"run {seed}", time, {"u": drive}, {"w": run.outputs["w"] + 0.01 * generator.normal(size=300)}
            )
        )
    learn, choose, judge = records
    found = gb.discover(plant, learn, validation=choose, effects=[gb.effect("coulomb_friction")], workers=1)
    trip = round_trip(found, learn, {"choose": choose, "judge": judge})
    assert found.verdict == "named" and trip["status"] == "converged" and not trip["said"]
    # Written with all its digits; the refit ends where the answer stands, and the model in C is the library's.
    assert trip["written"] == 0 and trip["rewritten"] == 0
    assert all(abs(ratio - 1) < 1e-3 for ratio in trip["ratio"].values())
    assert trip["c"] < 1e-9


@pytest.mark.parametrize(("rate", "is_compared"), [(5.0, True), (2e3, True), (1e9, False)])
def test_the_model_in_c_is_compared_at_a_step_that_its_fast_modes_allow(tmp_path, rate, is_compared) -> None:
    plant = gb.Model(
        "rotor",
        states=[gb.State("w", "rad/s", 1.0, role="velocity")],
        inputs=[gb.Input("u", "rad/s^2", role="drive")],
        outputs=[gb.Output("w", "rad/s")],
        parameters=[gb.Parameter("b", "1/rad", rate)],
        # About the speed of one, with which it begins, its mode has the rate 2 b.
        balances=lambda x, u, p: [gb.Balance("torque", "rad/s^2", 1, "w", drive=u.u, drag=-p.b * x.w**2)],
    )
    time = 0.02 * np.arange(50)
    difference = run_in_c(plant, gb.Experiment("steps", time, {"u": np.ones(50)}, {"w": np.zeros(50)}), tmp_path)
    assert difference < 1e-12 if is_compared else "overflows" in difference


def test_the_page_counts_what_was_said() -> None:
    made = claim(1, "balance torque") | {"grade": "established", "probability": 0.9, "right": True}
    line = {
        "rig": "pendulum",
        "learn": "a",
        "choose": "b",
        "verdict": "partly",
        "claims": [claim(0, "") | {"grade": "established", "right": True}, made],
        "effects": [{"name": "second_mode", "grade": "established", "right": False}],
        "errors": {who: {where: {"q": 0.1} for where in ("choose", "judge")} for who in ("plain", "answer")},
        "seconds": 10.0,
        "out_of_time": False,
        "round_trip": {
            "status": "converged",
            "said": [],
            "written": 0.0,
            "rewritten": 0.0,
            "ratio": {"learn": 1.0, "choose": 1.0, "judge": 1.02},
            "c": 1e-14,
        },
    }
    # The effect of the answer that no claim names counts as said.
    assert [c["right"] for c in said(line)] == [True, False]
    page = write_page([line])
    assert "| right name first, where the catalogue holds it | 0 of 1 |" in page
    assert "| wrong among what is established and can be judged | 1 of 2 |" in page
    assert "| round trips with the same error within 1 %, or told | 0 of 1 |" in page
    assert "second_mode (established, wrong)" in tell_effects(line)


def test_a_round_trip_whose_refit_finds_no_start_is_not_the_same_whatever_was_said() -> None:
    trip = {"status": "converged", "said": [], "ratio": {"learn": 1.0, "choose": 1.004}}
    assert is_same(trip) and not is_same(trip | {"ratio": {"learn": 1.02}})
    assert is_same(trip | {"ratio": {"learn": 1.02}, "said": ["another fit ends elsewhere"]})
    assert not is_same(trip | {"status": "no_start", "said": ["another fit ends elsewhere"]})
