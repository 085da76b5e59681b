"""What is known of parameters and noise, stated on the command line: it counts, and stands in the result."""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result

from greybox.estimation.findings import EstimationCode
from greybox.shell.commands import COMMANDS, app
from greybox.shell.options import FITTING, IN_MODEL
from greybox.simulation.simulate import write_csv
from tests.support.command import CliRunner
from tests.support.pushed_mass import INTENSITY, LEVEL, MASS, STARTS, irregular, record, with_gaps

FILE = """
from greybox import Balance, Input, Model, Output, Parameter, State

mass = Model(
    "mass", [State("x", "m"), State("v", "m/s")], [Input("u", "N")], [Output("x", "m"), Output("v", "m/s")],
    [Parameter("M", "kg", 1.0, (0.01, 100.0), fixed=True), Parameter("B", "N*s/m", 0.4, (1e-3, 100.0)),
     Parameter("K", "N/m", 4.0, (1e-3, 1000.0))],
    lambda x, u, p: [
        Balance("position", "m/s", 1, "x", velocity=x.v),
        Balance("force", "N", p.M, "v", drive=u.u, damping=-p.B * x.v, spring=-p.K * x.x),
    ],
)
"""
fit_module = importlib.import_module("greybox.shell.fit")
Run = Callable[..., Result]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model and three records, with gaps, at irregular times, and one pushed at random."""
    folder = tmp_path_factory.mktemp("data")
    (folder / "mass.py").write_text(FILE)
    for name, data in {
        "gaps": with_gaps(record(0)),
        "irregular": irregular(record(1, x0=STARTS[1])),
        "pushed": record(3, intensity=INTENSITY, x0=STARTS[1]),
    }.items():
        write_csv(data, MASS, folder / f"{name}.csv")
    rng = np.random.default_rng(1)
    still = {n: s * rng.normal(size=240) for n, s in LEVEL.items()}
    write_csv(replace(record(0), inputs={"u": np.zeros(240)}, outputs=still), MASS, folder / "quiet.csv")
    return folder


@pytest.fixture
def run(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    """Fits the mass to some of the records."""
    monkeypatch.chdir(tmp_path)

    def call(records: str, *arguments: str) -> Result:
        files = [str(folder / f"{name}.csv") for name in records.split()]
        words = [str(folder / a) if a.endswith(".csv") else a for a in arguments]
        return CliRunner().invoke(
            app, ["fit", str(folder / "mass.py"), *files, *words, "--output", "out", "--no-report", "--figures"]
        )

    return call


@pytest.mark.rest
@pytest.mark.parametrize(
    ("records", "options", "found", "shown"),
    [
        (
            "gaps irregular",
            "--prior B=0.44+-0.001 --own K --loss student:5 --quiet quiet.csv --profile K --bootstrap 200",
            {EstimationCode.PRIOR_CONFLICT, EstimationCode.MEAN_OF_EXPERIMENTS},
            ["K (gaps): ", "K (irregular): ", "profile likelihood", "block bootstrap, 200 replicates"],
        ),
        ("gaps irregular", "--tie B=0.2*sqrt(K*M) --schedule K=M@1 --condition M=1,1", set(), ["0.2*sqrt(K*M)"]),
        pytest.param(
            "pushed",
            "--process-noise v --predict 5 --profile K,noise_v",
            {EstimationCode.PROCESS_NOISE_SIGNIFICANT},
            ["5 steps ahead", "K: 4.", "noise_v: 0.", "profile likelihood"],
            marks=pytest.mark.slow,
        ),
    ],
)
def test_what_is_known_beforehand_counts_and_is_stored(
    run: Run,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    records: str,
    options: str,
    found: set[EstimationCode],
    shown: list[str],
) -> None:
    if records != "pushed":  # drawing takes longer than all the rest: once will do
        monkeypatch.setattr(fit_module, "_draw_pictures", lambda *_: [])
        options += " --no-report"
    result = run(records, *options.split(), "--details")
    assert result.exit_code == 0, result.output
    assert result.stderr == ""
    for text in (*shown, "residual tests", "free run and prediction"):
        assert text in result.stdout, result.stdout
    saved = json.loads((tmp_path / "out" / "fit.json").read_text())
    assert saved["success"] is True
    assert found <= {finding["code"] for finding in saved["findings"]}
    if "student" in options:
        assert saved["loss"].startswith("student") and set(saved["own"]) == {"K"}
        assert set(saved["noise_sources"].values()) == {"quiet_record"}
    if records == "pushed":
        drawn = {f.name for f in (tmp_path / "out").glob("residual-*.png") if f.stat().st_size}
        assert drawn == {"residual-x.png", "residual-v.png"}
        assert set(saved["process_noise"]) == {"v"}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--prior", "K=4"], "--prior K=4: write mean and standard deviation, as in --prior K=0.0100+-0.0001"),
        (["--prior", "K=4+-0"], "a standard deviation above zero"),
        (["--prior", "M=1+-0.1"], "--prior M: fixed in the model or by --fix"),
        (["--tie", "B=Q"], "'Q'"),
        (["--own", "Bb"], "'Bb'"),
        (["--loss", "hubber"], "unknown loss 'hubber'; did you mean 'huber'"),
        (["--schedule", "K=P_S"], "'P_S'"),
        (["--condition", "M=1,2,3"], "--condition M: 3 values for 2 records"),
        (["--process-noise", "w"], "has no state 'w'"),
        (["--process-noise", "v=-1"], "is not an intensity; give a finite value of 0 or more"),
        (["--process-noise", "v", "--loss", "huber"], "leave out the loss, or the process noise"),
        (["--noise", "x=-1"], "not a positive standard deviation"),
        (["--quiet", "gaps.csv"], "input 'u' moves by 4 N"),
        (["--profile", "M"], "--profile M: no parameter that is fitted"),
        (["--profile", "K:K"], "--profile K:K: give one parameter, or two different ones as A:B"),
        (
            ["--profile", "K:B", "--own", "K"],
            "--profile K:B: each record has its own K; give two that all records share",
        ),
        (["--profile", "Kk"], "--profile Kk: no parameter that is fitted; did you mean 'K'"),
        (["--bootstrap", "20"], "--bootstrap 20: too few replicates for a 95 % interval; give 100 or more"),
    ],
)
def test_what_cannot_be_is_refused_in_one_message(run: Run, tmp_path: Path, options: list[str], message: str) -> None:
    result = run("gaps irregular", *options)
    assert result.exit_code == 2, result.output
    assert message in result.stderr
    assert result.stderr.count("error:") == 1 and "Traceback" not in result.output
    assert list(tmp_path.iterdir()) == []


GAINS = """
from greybox import Balance, Input, Model, Output, Parameter, State

lag = Model(
    "lag", [State("x", "K")], [Input("u", "K")], [Output("x", "K")],
    [Parameter("T", "s", 1.0, (0.01, 100.0)), Parameter("K1", "1", 2.0, (0.01, 100.0)), Parameter("K2", "1", 3.0, (0.01, 100.0))],
    lambda x, u, p: [Balance("heat", "K", p.T, "x", loss=-x.x, drive=p.K1 * p.K2 * u.u)],
)
"""


def test_a_check_counts_what_is_known_beforehand_and_hands_it_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("lag.py").write_text(GAINS)
    called = [
        CliRunner().invoke(app, ["check", "lag.py", *more, "--no-report"]) for more in ([], ["--prior", "K1=2+-0.02"])
    ]
    assert [result.exit_code for result in called] == [0, 0], called
    assert "K1 and K2 stay open" in called[0].output.replace("\n", " ")
    # Of the product alone the record says something: the prior, in its own digits, is all that is known of one factor.
    data = json.loads(Path("results/lag-check/check.json").read_text())["data"]
    assert data["constants"]["K1"]["std"] == pytest.approx(0.02, rel=1e-6)
    assert data["constants"]["K2"]["std"] / 3 == pytest.approx(0.01, rel=0.05)
    assert not any(constant["averaged"] for constant in data["constants"].values())
    assert "priors_count" in [f["code"] for f in data["findings"]]
    assert "fix one of" not in called[1].output
    assert "--prior K1=2.0+-0.02" in called[1].output.partition("next:")[2]


def test_a_check_takes_every_option_of_a_fit_that_makes_its_model() -> None:
    taken = {option.name for option in COMMANDS["check"].options}
    assert {option.name for option in IN_MODEL if option in FITTING} <= taken
