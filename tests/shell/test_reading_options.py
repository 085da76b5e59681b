"""Every option on how records are read, in every command that reads records: it works, or is refused in one sentence."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result

import greybox as gb
from greybox import Balance, Input, Model, Output, Parameter, State
from greybox.base.errors import GreyboxError
from greybox.extensions.app.command import StudyOnFile
from greybox.extensions.changes.command import read_like
from greybox.extensions.design.command import read_data
from greybox.extensions.fleet.records import RecordCollection, find_records
from greybox.shell.commands import COMMANDS
from greybox.shell.inputs import layout_of, read_quiet_records, read_records
from greybox.shell.options import READING
from greybox.shell.study import Study

lag = Model(
    "lag",
    [State("x", "m")],
    [Input("u", "V")],
    [Output("x", "m")],
    [Parameter("T", "s", 1.0, (1e-3, 1e3)), Parameter("K", "m/V", 1.0, (1e-3, 1e3), fixed=True)],
    lambda x, u, p: [Balance("b", "m", p.T, "x", fall=-x.x, drive=p.K * u.u)],
)
TIME = 0.1 * np.arange(60)
DRIVE = np.sin(TIME) + 0.4


def write(
    path: Path, header: str = "time [s],u [V],x [m],other [m]", time: np.ndarray = TIME, drive: np.ndarray = DRIVE
) -> Path:
    level = np.cos(TIME) * 0.3
    rows = np.column_stack([time, drive, level, 2 * level])
    path.write_text("\n".join([header, *(",".join(f"{v:.9g}" for v in row) for row in rows)]) + "\n")
    return path


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("records")
    broken = np.where(np.arange(60) > 30, TIME + 20, TIME)
    text = write(folder / "bare.csv").read_text().split("\n", 1)[1]
    (folder / "bare.csv").write_text(text)
    timeless = "\n".join(line.split(",", 1)[1] for line in write(folder / "none.csv").read_text().splitlines())
    (folder / "none.csv").write_text(timeless + "\n")
    return {
        "plain": write(folder / "plain.csv"),
        "bare": folder / "bare.csv",
        "none": folder / "none.csv",
        "holes": write(folder / "holes.csv", time=broken, drive=np.where(np.arange(60) > 30, 0.4, 0.4 + DRIVE)),
        "still": write(folder / "still.csv", drive=np.zeros(60)),
    }


# Option -> its value, the file that it is tried on, and how it is typed.
ASKED = {
    "columns": ({"x": "other"}, "plain", "x=other"),
    "headers": (("time [s]", "u [V]", "x [m]", "-"), "bare", "time [s],u [V],x [m],-"),
    "sampling_time": (0.05, "none", "0.05"),
    "read_limit": (2.0, "plain", "2"),
    "first_time": (1.0, "plain", "1"),
    "last_time": (4.0, "plain", "4"),
    "hold": ("first", "plain", "first"),
    "interpolation": ({"u": "first"}, "plain", "u=first"),
    "before": ({"u": 7.0}, "plain", "u=7"),
    "split_holes": (True, "holes", ""),
    "free_decay": (True, "still", ""),
}


@pytest.fixture(scope="module")
def known() -> gb.Fit:
    run = gb.simulate(lag, {"time": TIME, "u": DRIVE})
    record = gb.Experiment("r", TIME, {"u": DRIVE}, {"x": run.outputs["x"] + 1e-3 * np.sin(9 * TIME)}, "zero")
    return gb.fit(lag, record, noise={"x": 1e-3}, options=gb.FitOptions(at_rest=True))


def read_collection(found: RecordCollection) -> tuple[gb.Experiment, ...]:
    return tuple(found.read(reference, lag) for reference in found.references)


Reader = Callable[[Study, gb.Fit], tuple[gb.Experiment, ...]]
READERS: dict[str, Reader] = {
    "fit": lambda study, _: read_records(study, lag).estimation,
    "validation": lambda study, _: read_records(study.but(estimation=(), validation=study.estimation), lag).validation,
    "discover": lambda study, _: read_records(study.but(estimation=(), test=study.estimation), lag).test,
    "quiet": lambda study, _: read_quiet_records(study.but(quiet=study.estimation), lag),
    "app": lambda study, _: StudyOnFile(study, lag).read(study.estimation, study.columns),
    "changed": lambda study, known: read_like(known, study.estimation, study),
    "design": lambda study, _: read_data(study.estimation, lag, study),
    "fleet": lambda study, _: read_collection(find_records(study.estimation, hold=study.hold, **layout_of(study))),
}
# Records at rest are taken whole: parts of the others are looked for in a run. The clocks of a design are those of the record to come.
ELSEWHERE = {
    ("quiet", "first_time"),
    ("quiet", "last_time"),
    ("quiet", "split_holes"),
    ("quiet", "free_decay"),
    ("design", "sampling_time"),
}


@pytest.mark.parametrize("option", READING, ids=lambda option: option.name)
@pytest.mark.parametrize("way", READERS)
def test_an_option_changes_what_is_read(way, option, files, known):
    command = COMMANDS[{"validation": "fit", "quiet": "fit"}.get(way, way)]
    if (way, option.name) in ELSEWHERE or option.name not in command.table:
        return
    if way == "design" and option.name == "hold":
        return
    value, file, _ = ASKED[option.name]
    study = command.study(estimation=(files[file],))

    def read(study: Study) -> object:
        try:
            return [(r.identity, r.rows) for r in READERS[way](study, known)]
        except GreyboxError as error:
            return str(error)

    asked, plain = read(study.but(**{option.name: value})), read(study)
    assert isinstance(asked, list), asked
    if option.name == "read_limit":  # nothing here is near the limit
        return
    assert asked != plain
    as_fitted = READERS["fit"](
        study.but(
            **{option.name: value, "hold": "zero" if way == "changed" else value if option.name == "hold" else "auto"}
        ),
        known,
    )
    assert asked == [(r.identity, r.rows) for r in as_fitted]


@pytest.mark.parametrize("option", READING, ids=lambda option: option.name)
@pytest.mark.parametrize(
    "name", ["check", "fit", "compare", "discover", "changed", "design", "campaign", "fleet", "app"]
)
def test_an_option_that_a_command_does_not_take_is_refused(run: Callable[..., Result], name, option, files):
    if option.name in COMMANDS[name].table:
        return
    flag, typed = option.flags[0], ASKED[option.name][2]
    result = run(name, "lag", files["plain"], flag, *([typed] if typed else []))
    assert result.exit_code == 2
    assert f"{flag}: greybox {name} has no such option" in result.stderr
