"""Grey against black: scores against a computation of their own, the command, its file and its figure."""

import json
from functools import partial

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import lfilter

import greybox as gb
from greybox.base.values import with_code
from greybox.comparison.black_box_candidates import fit_black_boxes
from greybox.comparison.result import Comparison, ComparisonFinding, ComparisonPolicy, load_comparison, save_comparison
from greybox.shell.commands import app
from greybox.show.figures.pictures import draw_comparison
from greybox.simulation.simulate import write_csv
from tests.support.command import CliRunner
from tests.support.result_schema import strict_offences

STEP, NOISE, M, D, K = 0.05, 2e-3, 1.0, 0.8, 9.0
# Scans over a few structures only.
SMALL = ComparisonPolicy(
    scan=gb.blackbox.StructureScanPolicy(
        largest_poles=1, largest_searched_poles=1, first_delays=(1,), nonlinearities={"polynomial": (2,)}
    )
)
KINDS = {"arx", "armax", "output_error", "box_jenkins", "hammerstein"}
PLANT = """
from greybox import Balance, Input, Model, Output, Parameter, State

def balances(x, u, p):
    return [
        Balance("position", "m/s", 1, "x", velocity=x.v),
        Balance("force", "N", p.M, "v", drive=u.F, damping=-p.D * x.v, spring=-p.K * x.x),
    ]

mass = Model(
    "mass",
    states=[State("x", "m"), State("v", "m/s")],
    inputs=[Input("F", "N", role="drive")],
    outputs=[Output("y", "m", lambda x, u, p: x.x)],
    parameters=[
        Parameter("M", "kg", 1.0, (0.1, 10), fixed=True, source="weighed"),
        Parameter("D", "N*s/m", 1.0, (0, 10), source="guess"),
        Parameter("K", "N/m", 7.0, (0.1, 100), source="guess"),
    ],
    balances=balances,
)
"""


def motion(force, x0=(0.0, 0.0)):
    """Positions of mass, damper and spring under the held force, by the matrix exponential."""
    block = np.zeros((3, 3))
    block[:2, :2], block[1, 2] = [[0, 1], [-K / M, -D / M]], 1 / M
    held = expm(block * STEP)
    x, found = np.array(x0), []
    for f in force:
        found.append(x[0])
        x = held[:2, :2] @ x + held[:2, 2] * f
    return np.array(found)


def record(seed, rows, name, gap=()):
    rng = np.random.default_rng(seed)
    force = np.repeat(rng.uniform(-1, 1, rows // 4 + 1), 4)[:rows]
    y = motion(force) + NOISE * rng.standard_normal(rows)
    y[list(gap)] = np.nan
    return gb.Experiment(name, STEP * np.arange(rows), {"F": force}, {"y": y})


@pytest.fixture(scope="module")
def plant(tmp_path_factory):
    path = tmp_path_factory.mktemp("plant") / "mass.py"
    path.write_text(PLANT)
    return path


@pytest.fixture(scope="module")
def model(plant):
    from greybox.shell.project import find_model

    return find_model(str(plant))


@pytest.fixture(scope="module")
def records():
    return record(1, 160, "train"), record(2, 120, "first"), record(3, 90, "second", gap=(60, 61, 75))


@pytest.fixture(scope="module")
def compared(model, records):
    train, *judges = records
    fit = gb.fit(model, train, options=gb.FitOptions(at_rest=True))
    models = {
        "physics": fit,
        "arx": gb.blackbox.arx(train, na=2, nb=2),
        "oe": gb.blackbox.output_error(train, nb=2, nf=2, history="zero"),
        "unstable": gb.blackbox.PolynomialModel("arx", "y", ("F",), STEP, (0,), ([0.1],), a=[1, -1.9], samples=100),
    }
    # The same output error behind a pole outside the circle that a zero hides, and with a little of the input at once.
    hidden, oe = [1.0, -1.01], models["oe"]
    b = np.convolve(oe.b[0] + [1e-4, 0.0, 0.0], hidden)
    models["hidden"] = gb.blackbox.PolynomialModel("arx", "y", ("F",), STEP, (0,), (b,), a=np.convolve(oe.f[0], hidden))
    return models, gb.compare(models, judges, training=train, skip=20, steps=[3])


def own_scores(runs):
    """rmse and best fit in percent over pairs of measured and simulated."""
    known = [(y[np.isfinite(y)], run[np.isfinite(y)]) for y, run in runs]
    square = sum(np.sum((y - run) ** 2) for y, run in known)
    movement = sum(np.sum((y - y.mean()) ** 2) for y, _ in known)
    return np.sqrt(square / sum(len(y) for y, _ in known)), 100 * (1 - np.sqrt(square / movement))


# ---- The scores ----


def test_scores_of_a_black_box_are_those_of_a_plain_filter(records, compared):
    _, *judges = records
    models, found = compared
    oe, entry = models["oe"], found["oe"]
    runs = [(e.outputs["y"][20:], lfilter(oe.b[0], oe.f[0], e.inputs["F"])[20:]) for e in judges]
    for score, expected in [(entry.validation["y"], own_scores(runs))] + [
        (entry.records[e.name]["y"], own_scores([run])) for e, run in zip(judges, runs, strict=True)
    ]:
        assert (score.rmse, score.best_fit_percent) == pytest.approx(expected, rel=1e-9)
        assert score.one_step_rmse == pytest.approx(score.rmse)  # an output error predicts as it runs
        assert score.unit == "m"
    assert entry.validation["y"].samples == 100 + 70 - 3  # the gap is not judged


def test_one_step_errors_of_arx_are_those_of_its_equation(records, compared):
    models, found = compared
    arx, first = models["arx"], records[1]
    (a1, a2), (b1, b2) = arx.a[1:], arx.b[0][1:]
    y, u = first.outputs["y"], first.inputs["F"]
    ahead = -a1 * y[1:-1] - a2 * y[:-2] + b1 * u[1:-1] + b2 * u[:-2]
    expected = np.sqrt(np.mean((y[2:] - ahead)[18:] ** 2))
    assert found["arx"].records["first"]["y"].one_step_rmse == pytest.approx(expected, rel=1e-9)
    assert found["arx"].records["first"]["y"].ahead_rmse[3] > expected


def test_scores_of_the_physical_model_are_those_of_the_exact_motion(model, records, compared):
    _, *judges = records
    models, found = compared
    fit = models["physics"]
    assert fit.parameters["K"].value == pytest.approx(K, rel=0.01)
    system = np.zeros((3, 3))
    system[:2, :2] = [[0, 1], [-fit.parameters["K"].value, -fit.parameters["D"].value]]
    system[1, 2] = 1.0
    held, runs = expm(system * STEP), []
    for e in judges:
        x, run = np.zeros(2), []
        for force in e.inputs["F"]:
            run.append(x[0])
            x = held[:2, :2] @ x + held[:2, 2] * force
        runs.append((e.outputs["y"][20:], np.array(run)[20:]))
    score = found["physics"].validation["y"]
    assert (score.rmse, score.best_fit_percent) == pytest.approx(own_scores(runs), rel=1e-6)
    assert score.rmse == pytest.approx(NOISE, rel=0.2)


def test_criteria_stability_and_feed_through(records, compared):
    _, found = compared
    train = records[0]
    for entry in (found["physics"], found["oe"], found["arx"]):
        square = entry.training["y"].rmse ** 2
        assert entry.bic == pytest.approx(160 * np.log(square) + entry.parameters * np.log(160))
    assert [found[n].parameters for n in found.names] == [2, 4, 4, 2, 7]
    assert [found[n].kind for n in found.names] == ["grey", "black", "black", "black", "black"]
    assert [found[n].stable for n in found.names] == [True, True, True, False, False]
    assert found["unstable"].feedthrough == {"y/F": 0.1} and not found["physics"].feedthrough
    assert found.training == (train.name,) and found.validation == ("first", "second")
    best = with_code(found.verdict, ComparisonFinding.BEST_MODEL)
    assert [(f.subject, f.values["measure"]) for f in best] == [("y", "free_run"), ("y", "one_step")]
    assert best[0].values["model"] == {"name": "physics", "kind": "grey", "parameters": 2}
    assert best[0].values["error"] == found["physics"].validation["y"].rmse
    for code in (ComparisonFinding.UNSTABLE_MODELS, ComparisonFinding.FEEDTHROUGH_MODELS):
        (remark,) = with_code(found.verdict, code)
        assert remark.values["models"] == ["hidden"]
    (failed,) = with_code(found.verdict, ComparisonFinding.FAILED_MODELS)
    assert failed.values["models"] == ["unstable"] and found["unstable"].failed


def test_criteria_over_different_outputs_are_not_compared():
    rng = np.random.default_rng(0)
    time, u = 0.1 * np.arange(80), rng.normal(size=80)
    twin = gb.Experiment(
        "twin", time, {"u": u}, {n: lfilter([0.3], [1, -0.6], u) + 0.01 * rng.normal(size=80) for n in "yz"}
    )
    first, second = (gb.blackbox.arx(twin, na=1, nb=1, nk=0, output=n) for n in "yz")
    code = ComparisonFinding.BIC_OF_DIFFERENT_OUTPUTS
    (remark,) = with_code(gb.compare({"a": first, "b": second}, twin, training=twin).verdict, code)
    assert remark.values["outputs"] == {"a": ["y"], "b": ["z"]}
    assert not with_code(gb.compare({"a": first, "c": first}, twin, training=twin).verdict, code)


def test_the_file_has_the_promised_form(compared, tmp_path):
    _, found = compared
    saved = json.loads(save_comparison(found, tmp_path / "compare.json").read_text())
    assert load_comparison(tmp_path / "compare.json") == saved
    assert strict_offences(saved, Comparison) == []
    for name, entry in saved["models"].items():
        assert entry["kind"] in ("grey", "black") and isinstance(entry["parameters"], int)
        score = entry["validation"]["y"]
        assert {"rmse", "best_fit_percent", "one_step_rmse"} <= set(score)
        assert score["rmse"] == found[name].validation["y"].rmse
        assert score["ahead_rmse"]["3"] == found[name].validation["y"].ahead_rmse[3]
        assert set(entry["records"]) == {"train", "first", "second"}


def test_a_run_that_leaves_all_bounds_is_said_and_drawn(compared, tmp_path):
    models, _ = compared
    long = record(8, 2500, "long")
    found = gb.compare({"physics": models["physics"], "unstable": models["unstable"]}, long, skip=20)
    assert np.isinf(found["unstable"].validation["y"].rmse)
    assert found["unstable"].failed and [e.name for e in found.standing] == ["physics"]
    assert with_code(found.verdict, ComparisonFinding.FAILED_MODELS)[0].values["models"] == ["unstable"]
    saved = json.loads(save_comparison(found, tmp_path / "compare.json").read_text())
    assert saved["models"]["unstable"]["validation"]["y"]["rmse"] is None
    (figure,) = draw_comparison(found, tmp_path)
    assert figure.stat().st_size > 20_000


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda m, r: gb.compare([], r), "no model to compare"),
        (lambda m, r: gb.compare([m["arx"], m["arx"]], r), "models of the same name: arx; give a dictionary"),
        (lambda m, r: gb.compare([m["arx"]]), "no record to compare on"),
        (lambda m, r: gb.compare([m["arx"]], r, skip=500), "skip: 500 rows, but the shortest record has 90"),
        (lambda m, r: gb.compare([m["arx"]], r, steps=[0]), "steps ahead: 0; give whole numbers from 1"),
        (
            lambda m, r: gb.compare([m["arx"]], gb.blackbox.resample(r[1], 0.1)),
            r"every 0.1 s, but arx\(2, 2, 1\) of 'y' was identified at 0.05 s; give greybox.blackbox.resample\(experiment, 0.05\)",
        ),
    ],
)
def test_what_cannot_be_compared_is_refused(records, compared, call, message):
    with pytest.raises(gb.errors.DataError, match=message):
        call(compared[0], list(records))


def test_uneven_records_are_brought_to_equal_steps(monkeypatch):
    few = partial(gb.blackbox.best_black_boxes, kinds=("arx",))
    monkeypatch.setattr("greybox.comparison.black_box_candidates.best_black_boxes", few)
    one = record(4, 80, "uneven")
    time = one.time.copy()
    time[40:] += 0.02
    uneven = gb.Experiment("uneven", time, one.inputs, one.outputs)
    found, findings = fit_black_boxes([uneven, record(5, 80, "even")], ["y"], ["F"], policy=SMALL)
    assert [named.name for named in found] == ["arx"]
    (resampled,) = with_code(findings, ComparisonFinding.RECORD_RESAMPLED)
    assert resampled.subject == "uneven" and resampled.values["sampling_time"] == pytest.approx(STEP)


# ---- The command ----


@pytest.fixture
def run(tmp_path, monkeypatch, records, model, plant):
    few = partial(gb.blackbox.best_black_boxes, policy=SMALL.scan)
    monkeypatch.setattr(
        "greybox.comparison.black_box_candidates.best_black_boxes", lambda *a, policy, **k: few(*a, **k)
    )
    monkeypatch.chdir(tmp_path)
    for r in records:
        write_csv(r, model, tmp_path / f"{r.name}.csv")
    return lambda *arguments: CliRunner().invoke(app, ["compare", str(plant), *map(str, arguments)])


@pytest.mark.rest
def test_the_command_compares_writes_and_draws(run, tmp_path):
    judge = ["--validate", "first.csv", "--validate", "second.csv", "--skip", 20]
    done = run("train.csv", *judge, "--at-rest", "--predict", 5, "--no-report", "--figures", "--output", "out")
    assert done.exit_code == 0, done.output
    # On a slow machine progress follows.
    assert done.stderr.startswith("note: second.csv: output 'y' has 3 gaps in 90 rows\n")
    saved = json.loads((tmp_path / "out" / "compare.json").read_text())
    assert set(saved["models"]) == {"mass", *KINDS}
    assert {n: m["kind"] for n, m in saved["models"].items()} == {"mass": "grey", **dict.fromkeys(KINDS, "black")}
    assert saved["models"]["mass"]["validation"]["y"]["rmse"] == pytest.approx(NOISE, rel=0.2)
    assert saved["remarks"] == ["second.csv: output 'y' has 3 gaps in 90 rows"]
    assert saved["validation"] == ["first", "second"] and set(saved["data"]) == {"train", "first", "second"}
    names = sorted(p.name for p in (tmp_path / "out").iterdir())
    figures = [f"comparison-{record}.{kind}" for record in ("first", "second") for kind in ("pdf", "png", "svg")]
    assert names == ["compare.json", *figures]
    assert all((tmp_path / "out" / n).read_bytes().startswith(b"\x89PNG") for n in figures[1::3])
    (best, *_) = saved["findings"]
    assert (best["code"], best["subject"], best["values"]["model"]["name"]) == ("best_model", "y", "mass")
    assert saved["verdict"][0].startswith(
        "y, free run on the validation records: mass (grey box, 2 parameters) is best"
    )
    assert done.stdout.startswith("mass is best: its error in y on the validation records")


@pytest.mark.rest
def test_a_step_has_its_black_boxes(run, tmp_path, model):
    time = STEP * np.arange(200)
    y = motion(np.ones(200)) + 1e-4 * np.random.default_rng(0).standard_normal(200)
    write_csv(gb.Experiment("step", time, {"F": np.ones(200)}, {"y": y}), model, tmp_path / "step.csv")
    done = run("step.csv", "--at-rest", "--json", "--no-report", "--fix", "D=0.8", "--output", "out")
    assert done.exit_code == 0, done.output
    saved = json.loads(done.stdout)
    assert set(saved["models"]) == {"mass", *KINDS} - {"hammerstein"}  # an input of two levels has no curve
    assert saved["models"]["mass"]["parameters"] == 1
    assert saved["validation"] == []
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["compare.json"]  # figures were not asked for


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["missing.csv"], "missing.csv"),
        (["train.csv", "--fix", "Q=1"], "Q"),
        (["train.csv", "--validate", "first.csv", "--skip", "115"], "--skip 115"),
        (["train.csv", "--skip", "5"], "--skip 5 has no effect"),
        (["train.csv", "--effects", "coulomb_frction"], "coulomb_friction"),
        (["train.csv", "--seed", "3"], "--seed 3 has no effect"),
        (["train.csv", "--loss", "hubber"], "huber"),
        (["train.csv", "--arc-length", "1", "--transcription", "single"], "leave out one of the two"),
        (["train.csv", "--process-noise", "w"], "w"),
        (["train.csv", "--predict", "-1"], "--predict"),
        (["train.csv", "--validate", "slow.csv"], "greybox.blackbox.resample(experiment, 0.05)"),
        (["train.csv", "--output", "train.csv"], "it is a file"),
    ],
)
def test_bad_input_is_one_message_and_nothing_is_written(run, tmp_path, model, records, arguments, message):
    write_csv(gb.blackbox.resample(records[1], 0.1), model, tmp_path / "slow.csv")
    before = sorted(p.name for p in tmp_path.iterdir())
    done = run(*arguments)
    assert done.exit_code == 2, done.output
    assert message in done.stderr and "Traceback" not in done.stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == before


def test_compare_takes_the_options_of_fit():
    fit, compare = ({name for p in app.commands[c].params for name in p.opts} for c in ("fit", "compare"))
    # Options about the intervals of parameters, which are not compared, and the time for the starts of one model.
    assert fit - compare == {"--profile", "--bootstrap", "--time"}


@pytest.mark.slow
def test_many_starts_and_process_noise_reach_the_fit(run, tmp_path):
    done = run("train.csv", "--starts", 2, "--seed", 4, "--output", "many")
    assert done.exit_code == 0, done.output
    pushed = run("train.csv", "--process-noise", "v", "--effects", "coulomb_friction", "--output", "pushed")
    assert pushed.exit_code == 0, pushed.output
    saved = json.loads((tmp_path / "pushed" / "compare.json").read_text())
    grey = [name for name, entry in saved["models"].items() if entry["kind"] == "grey"]
    assert len(grey) == 2
    assert all(
        any(f["code"] == ComparisonFinding.PREDICTION_FILTER for f in saved["models"][name]["findings"])
        for name in grey
    )


@pytest.mark.slow
def test_rivals_with_effects_begin_where_the_records_show_them(run, shared_data, tmp_path):
    tanks = shared_data / "cascaded_tanks"
    judge = ["--validate", tanks / "test.csv", "--skip", 50, "--effects", "lower_overflow+upper_overflow+reading_curve"]
    arguments = ["compare", "cascaded_tanks", tanks / "train.csv", *judge, "--output", "out"]
    done = CliRunner().invoke(app, list(map(str, arguments)))
    assert done.exit_code == 0, done.output
    models = json.loads((tmp_path / "out" / "compare.json").read_text())["models"]
    rms = {name: entry["validation"]["y"]["rmse"] for name, entry in models.items()}
    (grown,) = (name for name in rms if name.endswith("reading_curve"))
    assert rms[grown] < 0.25 < 0.5 < min(value for name, value in rms.items() if models[name]["kind"] == "black")
