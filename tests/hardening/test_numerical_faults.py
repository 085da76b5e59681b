"""Records that no model of theirs explains or determines, with priors, ties, many substeps: an answer or a sentence, and no nan in it."""

from __future__ import annotations

import itertools
import re
import sys
import traceback
import warnings
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from greybox.base.json_file import read_json
from greybox.estimation.result import Fit
from greybox.shell.commands import app
from models.silverbox import silverbox
from tests.hardening.test_fuzz_records import time_limit
from tests.oracles.independent import linear_record, multisine
from tests.support.command import CliRunner
from tests.support.reliability import note_row

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(3600),
    pytest.mark.skipif(sys.platform != "linux", reason="alarms of Linux"),
]
PERIOD = 1.6384e-3
ROWS = 150
SECONDS = 120
NO_NUMBER = re.compile(r"(?<![\w.])nan(?!\w)")
OPTIONS = {
    "nothing": "",
    "tight prior": "--prior d=43+-1e-9",
    "wrong prior": "--prior d=4000+-1e-6 --prior b=2000+-1e-6",
    "tie": "--tie k1=b",
    "far start": "--start d=4900 --start k1=1001 --start b=9e6",
    "many substeps": "--effect cubic_stiffness --method rk4 --substeps 2000",
    "loss": "--loss student:5",
    "process noise": "--process-noise v",
}


def make_records() -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Time, input and output (N,) of records that are odd in their numbers alone."""
    rng = np.random.default_rng(1)
    u = multisine(rng, ROWS, PERIOD, 5, 200, 0.1)
    y = linear_record(silverbox, u, PERIOD).outputs["y"]
    time, nothing, outlier = PERIOD * np.arange(ROWS), np.zeros(ROWS), y.copy()
    outlier[60] = 1e6
    with_gaps = np.where(np.arange(ROWS) % 10 == 0, y, np.nan)
    return {
        "all still": (time, nothing, nothing),
        "input alone": (time, u, nothing),
        "free decay": (time, nothing, np.exp(-30 * time) * np.cos(400 * time)),
        "noise": (time, u, rng.normal(size=ROWS)),
        "outlier": (time, u, outlier),
        "large": (time, u, 1e90 * y),
        "small": (time, u, 1e-90 * y),
        "step": (time, np.where(time > 0.1, 1.0, 0.0), y),
        "short": (time[:6], u[:6], y[:6]),
        "runs away": (time, u, np.exp(200 * time)),
        "opposite": (time, u, -1000 * y),
        "late": (1e9 + time, u, y),
        "slow": (1e6 * time, u, y),
        "mostly gaps": (time, u, with_gaps),
    }


def judge(command: list[str], out: Path) -> str:
    """What a fit comes to: "answered", "refused", or what is wrong with it."""
    with warnings.catch_warnings(), time_limit(SECONDS):
        warnings.simplefilter("error", RuntimeWarning)  # raw ones of numpy
        result = CliRunner().invoke(app, command)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        place = traceback.extract_tb(result.exception.__traceback__)[-1]
        return f"{type(result.exception).__name__} in {Path(place.filename).name}:{place.lineno}: {result.exception}"[
            :200
        ]
    if result.exit_code == 2:
        return "refused" if "error: " in result.output and not out.exists() else f"code 2: {result.output[-200:]}"
    if result.exit_code not in (0, 1):
        return f"code {result.exit_code}: {result.output[-200:]}"
    if out.exists():
        read_json(out / "fit.json", Fit)
    place_of_nan = (
        NO_NUMBER.search(result.output) if result.exit_code == 0 else None
    )  # a run that overflows has no misfit
    return (
        "answered"
        if place_of_nan is None
        else f"says nan: {result.output[max(place_of_nan.start() - 80, 0) : place_of_nan.end() + 20]!r}"
    )


def test_fits_of_records_that_say_nothing_or_contradict(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    outcomes, wrong = Counter[str](), Counter[str]()
    records = make_records()
    for name, columns in records.items():
        np.savetxt(
            f"{name}.csv",
            np.column_stack(columns),
            delimiter=",",
            header="time [s],u [V],y [V]",
            comments="",
            fmt="%.12g",
        )
    for number, (name, option) in enumerate(itertools.product(records, OPTIONS)):
        out = tmp_path / str(number)
        words = ["fit", "silverbox", f"{name}.csv", *OPTIONS[option].split(), "--no-report", "--output", str(out)]
        outcome = judge(words, out)
        outcomes[outcome if outcome in ("answered", "refused") else "wrong"] += 1
        if outcome not in ("answered", "refused"):
            wrong[f"{name}, {option}: {outcome}"] += 1
            print(f"{name}, {option}: {outcome}", flush=True)
    figures = f"{len(records)} records with {len(OPTIONS)} sets of options; {outcomes['answered']} answered, {outcomes['refused']} refused"
    note_row(
        "records that say nothing or contradict the model, fitted by the command",
        sum(outcomes.values()),
        sum(wrong.values()),
        figures,
    )
    assert not wrong, "\n".join(wrong)
