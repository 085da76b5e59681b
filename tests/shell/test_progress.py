"""How far a command is, and how long it still takes."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from greybox.estimation.transcription.problem import FitProgress
from greybox.shell import progress
from greybox.shell.compare import scan_share
from greybox.shell.progress import (
    ProgressLine,
    expected_share,
    format_duration,
    share_done,
    show_search_progress,
    time_left,
)


@pytest.mark.parametrize(("share", "left"), [(0.25, 30.0), (0.5, 10.0), (1.0, 0.0), (None, None), (0.0, None)])
def test_the_time_left_goes_on_as_what_is_done(share: float | None, left: float | None) -> None:
    assert time_left(10.0, share) == left


@pytest.mark.parametrize(("seconds", "text"), [(0.2, "1 s"), (89.0, "89 s"), (600.0, "10 min"), (4800.0, "1 h 20 min")])
def test_times_are_told_as_people_do(seconds: float, text: str) -> None:
    assert format_duration(seconds) == text


def test_a_fit_gets_on_and_is_never_done_before_it_ends() -> None:
    shares = [share_done(FitProgress(stage, 3, k, 1.0)) for stage in (1, 2) for k in (0, 1, 5, 7)]
    assert shares[0] == 0 and shares[4] == pytest.approx(1 / 3)
    assert shares == sorted(shares) and shares[-1] < 0.5


@pytest.mark.parametrize("iteration", [0, 5, 14])
def test_the_last_and_longest_stage_of_a_fit_does_not_say_when_it_ends(iteration: int) -> None:
    """It runs over the whole record: a second was told as left for most of a minute."""
    assert share_done(FitProgress(5, 5, iteration, 1.0)) is None


@pytest.mark.parametrize("iteration", [8, 15, 40, 400])
def test_a_search_longer_than_usual_does_not_say_when_it_ends(iteration: int) -> None:
    """A share of the steps so far would be no forecast: it says a third of the time so far, however long that is."""
    share = share_done(FitProgress(1, 1, iteration, 1.0))
    assert share is None and time_left(9.0, share) is None


def test_a_comparison_weighs_its_scans() -> None:
    outputs = ["x", "i"]
    order = [
        (kind, output) for output in outputs for kind in ("arx", "armax", "output error", "box-jenkins", "hammerstein")
    ]
    ends = [scan_share(f"{kind} of {output}", 1.0, outputs) for kind, output in order]
    assert ends == sorted(ends) and ends[4] == pytest.approx(0.5) and ends[-1] == pytest.approx(1.0)


def test_the_line_shows_text_and_time_left_and_goes_away(monkeypatch: pytest.MonkeyPatch) -> None:
    # The clock stands between two steps: other threads read it too, as often as they like.
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    line = ProgressLine()
    screen = io.StringIO()
    line.console = Console(file=screen, force_terminal=True, width=120, color_system=None)
    monkeypatch.setattr(progress, "_bar", _still)
    now[0] = 0.5
    line("too early", 0.1)
    assert line.bar is None
    now[0] = 4.0
    line("rig: 1 of 4 starts done", 0.25)
    line.bar.refresh()
    line.stop()
    shown = screen.getvalue()
    assert "too early" not in shown
    assert "rig: 1 of 4 starts done" in shown and "about 12 s left" in shown


def test_without_a_terminal_a_plain_line_comes_now_and_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    line = ProgressLine()
    line.console = Console(file=io.StringIO(), force_terminal=False)
    for now[0], text, share in (
        (5.0, "too early", 0.1),
        (12.0, "refit 10", 0.25),
        (15.0, "too soon", 0.3),
        (100.0, "refit 60", None),
    ):
        line(text, share)
    line.stop()
    assert capsys.readouterr().err.splitlines() == ["refit 10; 12 s so far; about 36 s left", "refit 60; 2 min so far"]


def test_a_silent_command_writes_no_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    line = ProgressLine(silent=True)
    now[0] = 50.0
    line("refit 10", 0.25)
    assert capsys.readouterr().err == ""


def _still(console: Console, own=progress._bar):
    """The same line, drawn when asked and not by a clock, which the test has stopped."""
    bar = own(console)
    bar.live.auto_refresh = False
    bar.get_time = lambda: 4.0
    return bar


def test_a_discovery_says_its_steps_and_how_many_refits_are_done(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    shown: list[tuple[str, float | None]] = []
    monkeypatch.setattr(ProgressLine, "__call__", lambda line, text, share=None: shown.append((text, share)))
    with show_search_progress() as (say, report):
        say("plain model: misfit 50 times the noise")
        report(10)
    assert shown == [
        ("plain model: misfit 50 times the noise", None),
        ("plain model: misfit 50 times the noise; refit 10", 0.25),
    ]
    assert capsys.readouterr().err == "plain model: misfit 50 times the noise\n"
    assert expected_share(20, 40) == 0.5
    # From half of what is usual on it is no forecast: 39 of 40 said a second, and there were 45 to come.
    assert [expected_share(done, 40) for done in (21, 39, 400)] == [None] * 3
