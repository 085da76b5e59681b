"""The app as a person uses it: in a real browser, from an empty session to the exported study."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

from greybox.base.files import locked
from greybox.extensions.app.workbench import JOURNAL
from tests.support.browser import collected_faults, wait_until
from tests.support.hostile import ELEMENTS, MARKUP, RARER_MARKUP
from tests.support.reliability import note_row

pytestmark = pytest.mark.rest

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: no browser to look with")
pytest.importorskip("tornado", reason="the app's server is not installed")
PATIENCE = 150_000  # milliseconds: other tests may run beside this one
# Let the page note that it has read the answer to a stop and dealt with it: a timer runs out after what waits for the answer has run.
NOTE_ANSWER = """
(() => {
  const ask = window.fetch;
  window.answered = false;
  window.fetch = async (...request) => {
    const answer = await ask(...request), read = answer.json.bind(answer);
    answer.json = async () => {
      const content = await read();
      if (String(request[0]).endsWith("do/stop")) setTimeout(() => { window.answered = true; }, 100);
      return content;
    };
    return answer;
  };
})()
"""


# Let answers wait until the page is told to take them.
HOLD_ANSWERS = """
(() => {
  const ask = window.fetch, open = new Promise((resolve) => { window.release = () => { window.fetch = ask; resolve(); }; });
  window.fetch = async (...request) => { const answer = await ask(...request); await open; return answer; };
})()
"""


@pytest.fixture(scope="module")
def server(rig: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[subprocess.Popen[str], Path]]:
    """The command as it is typed, without a record, and the folder that it exports to."""
    folder = tmp_path_factory.mktemp("served")
    command = [sys.executable, "-m", "greybox", "app", str(rig / "carriage.py"), "--noise", "v=2e-3", "--at-rest"]
    process = subprocess.Popen(
        [*command, "--json", "--output", str(folder / "out"), "--workers", "1"],
        cwd=folder,
        stdout=subprocess.PIPE,
        text=True,
    )
    yield process, folder / "out"
    process.send_signal(signal.SIGINT)
    assert process.wait(60) == 0
    process.stdout.close()


@pytest.fixture(scope="module")
def served(server) -> tuple[str, Path]:
    """The address of the app, and the folder that it exports to."""
    process, folder = server
    return json.loads("".join(process.stdout.readline() for _ in range(4)))["address"], folder


@contextmanager
def held_search(page, folder: Path) -> Iterator[Callable[[], None]]:
    """Begin a search that cannot go on, let alone end, before it is let go: its journal is locked, which it has to read first."""
    folder.mkdir(exist_ok=True)
    with ExitStack() as hold:
        file = hold.enter_context(open(folder / JOURNAL, "ab"))
        hold.enter_context(locked(file))
        page.click("#discover")
        yield hold.close


@pytest.fixture(scope="module")
def page(browser, served):
    """The page, opened once; an error in its console or a request to elsewhere fails the test that comes last."""
    address, _ = served
    one = browser.new_page(viewport={"width": 1300, "height": 900})
    one.set_default_timeout(PATIENCE)
    with collected_faults(one, (address,), expected="422") as faults:
        one.goto(address)
        until(one, "window.greyboxReady === true")
        yield one
        one.close()
    assert not faults


def until(page, expression: str) -> None:
    """Wait for an expression as long as other tests beside this one may take."""
    wait_until(page, expression, PATIENCE / 1000)


def ratio(page) -> float:
    """Misfit over noise as the page shows it."""
    return float(page.text_content("#misfit tbody td:last-child").partition(" ")[0])


def value(page, name: str) -> float:
    return float(page.input_value(f".constant[data-name={name}] input[type=number]"))


def load(page, selector: str, file: Path, count: int) -> None:
    page.set_input_files(selector, str(file))
    until(page, f"document.querySelectorAll('#records li').length === {count}")


def settled(page) -> None:
    """Wait until the page has looked where the residual lives."""
    until(page, "!['', '…'].includes(document.getElementById('where').textContent)")


def test_a_person_loads_records(page, rig: Path, tmp_path: Path) -> None:
    assert page.is_visible("#empty") and page.is_disabled("#export")
    wrong = tmp_path / "other.csv"
    wrong.write_text("time [s],pressure [bar]\n0,1\n0.1,2\n", encoding="utf-8")
    page.set_input_files("#load", str(wrong))
    page.wait_for_selector("#choice:not([hidden])")
    assert page.text_content("#unmatched") == "other.csv" and page.is_visible("#empty")
    assert page.input_value("#signals select[name=f]") == ""
    page.click("#leave")
    assert page.is_hidden("#choice")
    load(page, "#load", rig / "train.csv", 1)
    load(page, "#load-validation", rig / "test.csv", 2)
    assert page.is_hidden("#message")
    page.select_option("#record", "0")
    # What another record shows stands until this one's has come.
    until(page, "document.getElementById('where').textContent.includes('force balance')")
    for figure in ("run", "residual", "windows"):
        assert page.locator(f"#{figure} svg.main-svg").count() > 0


def test_a_record_with_a_gap_is_split_with_a_click(page, rig: Path, tmp_path: Path) -> None:
    torn, lines = tmp_path / "torn.csv", (rig / "test.csv").read_text(encoding="utf-8").splitlines(keepends=True)
    torn.write_text("".join([*lines[:120], *lines[180:]]), encoding="utf-8")
    page.set_input_files("#load", str(torn))
    page.wait_for_selector("#gap:not([hidden])")
    assert "time has a gap" in page.text_content("#message") and page.locator("#records li").count() == 2
    page.click("#split")
    until(page, "document.querySelectorAll('#records li').length === 4")
    assert page.is_hidden("#gap") and page.is_hidden("#message")
    # Behind the gap the carriage moves: its speed there is estimated, and the run begins with it.
    assert "at_rest" not in page.text_content("#study")
    page.select_option("#record", "3")
    until(page, "Math.abs(document.getElementById('run').data[1].y[0]) > 0.05")
    assert "split_holes = true" in page.text_content("#study") and "torn.csv" in page.text_content("#study")
    for _ in range(3):  # two records of one file, and the reading of all records with gaps
        before = page.text_content("#study")
        page.click("#undo")
        # One step at a time: a click on a page that still shows the state before would go back too far.
        until(page, f"document.getElementById('study').textContent !== {json.dumps(before)}")
        settled(page)
        if page.locator("#records li").count() == 2 and "split_holes" not in page.text_content("#study"):
            break
    until(page, "document.querySelectorAll('#records li').length === 2")
    assert "split_holes" not in page.text_content("#study")


def test_dragging_a_constant_redraws_the_simulation_at_once(page) -> None:
    before, redraws = ratio(page), "Number(document.documentElement.dataset.redraws ?? 0)"
    study = page.text_content("#study")
    simulated = "JSON.stringify([...document.getElementById('run').data[1].y].slice(0, 50))"
    drawn = page.evaluate(simulated)
    slider = page.locator(".constant[data-name=B] input[type=range]")
    slider.scroll_into_view_if_needed()
    box = slider.bounding_box()
    middle = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + box["width"] / 2, middle)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.8 * box["width"], middle, steps=8)
    until(page, f"{redraws} > 0")  # while the button is still down
    assert page.evaluate(simulated) != drawn
    page.mouse.up()
    until(page, f"document.getElementById('study').textContent !== {json.dumps(study)}")
    until(page, f"document.querySelector('#misfit tbody td:last-child').textContent.split(' ')[0] != {before}")
    assert value(page, "B") > 3
    settled(page)


def test_what_is_typed_stays_where_an_answer_comes_meanwhile(page) -> None:
    before, study = value(page, "B"), page.text_content("#study")
    page.evaluate(HOLD_ANSWERS)
    page.press(".constant[data-name=M] input[type=range]", "ArrowRight")
    page.press(".constant[data-name=B] input[type=number]", "9")
    typed = value(page, "B")
    page.evaluate("window.release()")
    until(page, f"document.getElementById('study').textContent !== {json.dumps(study)}")
    assert value(page, "B") == typed != before
    page.fill(".constant[data-name=B] input[type=number]", str(before))
    page.keyboard.press("Tab")
    page.click("#undo")
    until(page, f"document.getElementById('study').textContent === {json.dumps(study)}")
    assert value(page, "B") == before
    settled(page)


def test_a_value_out_of_bounds_is_told_and_the_old_one_stays(page) -> None:
    before = value(page, "B")
    page.fill(".constant[data-name=B] input[type=number]", "-5")
    page.keyboard.press("Tab")
    page.wait_for_selector("#message:not([hidden])")
    assert "B" in page.text_content("#message") and value(page, "B") == before


def test_what_the_rig_has_is_ticked(page) -> None:
    page.click("section[aria-labelledby=h-parts] summary")
    page.check("input[aria-label='lacks gear']")
    until(page, "document.querySelector(\"input[aria-label='lacks gear']\").checked")
    page.check("input[aria-label='has gear']")
    until(page, "!document.querySelector(\"input[aria-label='lacks gear']\").checked")
    page.uncheck("input[aria-label='has gear']")
    until(page, "!document.querySelector(\"input[aria-label='has gear']\").checked")
    page.click("section[aria-labelledby=h-parts] summary")
    settled(page)


def test_friction_is_added_with_a_click_and_fitted(page) -> None:
    page.click("#shelf summary")
    page.fill("#filter", "coulomb")
    page.click("button[aria-label='Add coulomb_friction']")
    page.wait_for_selector(".constant[data-name=Fc]")
    assert "coulomb friction" in page.text_content("#title") and value(page, "Fc") > 0
    settled(page)
    # A bar that is shown and hidden again between two looks is seen by nobody: the page notes what becomes of it.
    page.evaluate(
        "window.shown = false; new MutationObserver(() => { window.shown ||= !document.getElementById('progress').hidden; })"
        ".observe(document.getElementById('progress'), { attributes: true });"
    )
    page.click("#fit")
    page.wait_for_selector("#fit-answer:not([hidden])")
    assert page.evaluate("window.shown")
    # Sentences wrap, a table keeps its columns.
    assert "records" in page.text_content("#fit-answer .answer p") and "Fc" in page.text_content("#fit-answer pre")
    assert "iteration" in page.text_content("#stage")  # the last news stays
    until(page, "document.getElementById('progress').hidden")
    assert value(page, "Fc") == pytest.approx(0.5, rel=0.02) and value(page, "B") == pytest.approx(1.5, rel=0.02)
    until(page, "parseFloat(document.querySelector('#misfit tbody td:last-child').textContent) < 1.3")
    assert "95 %" in page.text_content(".constant[data-name=Fc] .describe")
    settled(page)


def test_everything_is_exported_and_the_study_is_one_that_greybox_reads(page, served) -> None:
    _, folder = served
    page.click("#export")
    page.wait_for_selector("#files li")
    names = {Path(e).name for e in page.locator("#files li").all_text_contents()}
    assert {"model.py", "study.toml", "repeat.py", "fit.json", "report.html", "train.csv"} <= names
    assert all(list(folder.rglob(name)) for name in names)
    assert page.text_content("#study") == (folder / "study.toml").read_text(encoding="utf-8")
    study = (folder / "study.toml").read_text(encoding="utf-8")
    assert 'effects = ["coulomb_friction"]' in study and re.search(r"^Fc = 0\.[45]", study, re.MULTILINE)


def test_undo_goes_back_to_the_model_before(page) -> None:
    page.click("#undo")  # the fit
    until(page, "!document.querySelector('.constant[data-name=Fc] .describe').textContent.includes('95 %')")
    assert "coulomb friction" in page.text_content("#title")
    page.click("#undo")  # the effect
    page.wait_for_selector(".constant[data-name=Fc]", state="detached")
    assert page.text_content("#title") == "carriage"
    settled(page)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="the lock that holds the search is one of POSIX")
def test_discover_can_be_stopped_and_finds_the_friction(page, served) -> None:
    _, folder = served
    with held_search(page, folder) as let_go:
        held = []

        def hold_answer(route) -> None:
            held.append((route, route.fetch()))  # the search has been asked to stop
            let_go()

        page.route("**/do/stop", hold_answer)
        page.evaluate(NOTE_ANSWER)
        page.click("#stop")
        page.wait_for_selector("#message.good:not([hidden])")
    # The answer comes after the news of what it led to, and tells of a time before.
    ((route, answer),) = held
    route.fulfill(response=answer)
    until(page, "window.answered")
    page.unroute("**/do/stop")
    assert page.is_visible("#message.good") and page.is_enabled("#discover")
    page.click("#discover")
    page.wait_for_selector("#discovery-answer:not([hidden])")
    assert page.text_content("#outcome") == "named"
    assert "coulomb friction" in page.text_content("#title")
    settled(page)
    page.click("#export")
    page.locator("#files li", has_text="discovery.json").wait_for()
    assert list(folder.rglob("discovery.json"))
    # What follows meets the model that it meets where this test does not run.
    page.click("#undo")
    page.wait_for_selector(".constant[data-name=Fc]", state="detached")
    assert page.text_content("#title") == "carriage"
    settled(page)


def test_a_person_says_which_column_is_which_signal(page, rig: Path, tmp_path: Path) -> None:
    foreign = tmp_path / "bench.csv"
    lines = (rig / "train.csv").read_text(encoding="utf-8").splitlines()
    foreign.write_text("\n".join(["Zeit [s],Kraft [N],Schlitten [mm/s]", *lines[1:]]), encoding="utf-8")
    for attempt in range(2):
        page.set_input_files("#load", str(foreign))
        page.wait_for_selector("#choice:not([hidden])")
        chosen = {n: page.input_value(f"#signals select[name={n}]") for n in ("time", "f", "v")}
        assert chosen == {
            "time": "Zeit [s]",
            "f": "Kraft [N]",
            "v": "Schlitten [mm/s]",
        }  # each is the only one of its unit
        page.click("#choice button[type=submit]")
        if attempt:
            break
        page.wait_for_selector("#message:not([hidden])")  # the records that are there have other headers
        assert "train.csv" in page.text_content("#message") and page.locator("#records li").count() == 2
        for count in (1, 0):
            page.locator("#records li button[aria-label^=Remove]").first.click()
            until(page, f"document.querySelectorAll('#records li').length === {count}")
    until(page, "document.querySelectorAll('#records li').length === 1")
    assert page.is_hidden("#choice") and page.is_hidden("#message")
    settled(page)
    study = page.text_content("#study")
    assert 'f = "Kraft [N]"' in study and 'v = "Schlitten [mm/s]"' in study and 'time = "Zeit [s]"' in study
    for _ in range(3):
        page.click("#undo")
        page.wait_for_timeout(200)
    until(page, "document.querySelectorAll('#records li').length === 2")
    assert "Kraft" not in page.text_content("#study")
    settled(page)


def test_a_second_window_without_the_token_gets_nothing(browser, served) -> None:
    address, _ = served
    origin = address.rsplit("/", 2)[0]
    other = browser.new_page()
    for path in ("", "state", "wrong/", "wrong/state", "wrong/events"):
        with other.expect_response(lambda _: True) as answered, pytest.raises(playwright.Error):
            other.goto(f"{origin}/{path}")  # an empty refusal is no page to the browser
        assert (answered.value.status, answered.value.header_value("content-length")) == (403, "0")
    # A page from elsewhere that has come to know the address may not read from it, nor change anything.
    other.close()
    other = browser.new_page()
    other.goto("data:text/html,<p>elsewhere</p>")
    for method in ("GET", "POST"):
        asked = f"fetch('{address}state', {{method: '{method}'}}).then(() => 'answered', () => 'refused')"
        assert other.evaluate(asked) == "refused"
    other.close()


def test_it_fits_a_phone_and_follows_dark_and_light(tab, served) -> None:
    address, _ = served
    tab.set_default_timeout(PATIENCE)
    tab.emulate_media(color_scheme="dark")
    tab.set_viewport_size({"width": 390, "height": 800})
    tab.goto(address)
    until(tab, "window.greyboxReady === true")
    assert tab.evaluate("document.documentElement.scrollWidth") <= 390
    paper = "getComputedStyle(document.body).backgroundColor"
    dark = tab.evaluate(paper)
    tab.click("#theme")
    assert tab.evaluate(paper) == "rgb(255, 255, 255)" != dark
    tab.goto("about:blank")
    tab.emulate_media(color_scheme="light")
    tab.set_viewport_size({"width": 1280, "height": 720})


def poison_answer(value: Any, text: str) -> Any:
    """An answer of the server with ``text`` in the place of each of its texts; a figure's own are escaped before they are sent."""
    if isinstance(value, dict):
        return {
            key: inner if key in ("data", "views", "signals") else poison_answer(inner, text)
            for key, inner in value.items()
        }
    if isinstance(value, list):
        return [poison_answer(inner, text) for inner in value]
    return text if isinstance(value, str) else value


def show_poisoned(tab, address: str, text: str) -> tuple[int, list[str]]:
    """How many texts were exchanged in a page that has ``text`` for every text of a session, and what is wrong with it."""
    tab.set_default_timeout(PATIENCE)
    shown, places = (
        0,
        ("#description", "#equations", "#where", "#records li span", "#misfit tbody th", ".constant .what b"),
    )

    def exchange(route) -> None:
        nonlocal shown
        answer = route.fetch()
        content = poison_answer(answer.json(), text)
        shown += json.dumps(content).count(json.dumps(text))
        route.fulfill(response=answer, json=content)

    answers = re.compile(r"/(state|do/[a-z]+)$")
    with collected_faults(tab, (address,)) as faults:
        tab.route(answers, exchange)
        tab.goto(address)
        until(tab, "window.greyboxReady === true")
        tab.evaluate("document.querySelectorAll('details').forEach((part) => { part.open = true; })")
        for place in places:
            if text not in tab.locator(place).first.text_content():
                faults.append(f"{place} does not show the text")
        if tab.evaluate("window.hurt") is not None or tab.locator(ELEMENTS).count():
            faults.append("the text became markup")
        tab.goto("about:blank")
        tab.unroute(answers, exchange)
    return shown, faults


@pytest.mark.rest
@pytest.mark.parametrize("text", MARKUP[:3])
def test_no_text_of_a_session_becomes_markup(tab, served, rig: Path, page, text: str) -> None:
    if not page.locator("#records li").count():
        load(page, "#load", rig / "train.csv", 1)
    shown, faults = show_poisoned(tab, served[0], text)
    assert shown > 100 and not faults


def test_why_a_file_is_refused_is_shown_as_text(page, tmp_path: Path) -> None:
    file = tmp_path / '<img src=x onerror="window.hurt=1">.csv'
    file.write_text("time,<img src=x onerror=window.hurt=2>\n0,1\n", encoding="utf-8")
    page.set_input_files("#load", str(file))
    page.wait_for_selector("#choice:not([hidden])")
    assert "onerror=window.hurt=2" in page.text_content("#choice")
    assert page.evaluate("window.hurt") is None and not page.locator(ELEMENTS).count()


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_each_text_in_every_answer_of_the_app(tab, served, rig: Path, page) -> None:
    if not page.locator("#records li").count():
        load(page, "#load", rig / "train.csv", 1)
    texts = (*MARKUP, *RARER_MARKUP)
    results = [show_poisoned(tab, served[0], text) for text in texts]
    faults = [fault for _, some in results for fault in some]
    fields = f"{sum(shown for shown, _ in results)} texts of answers; none executed, none became markup"
    note_row("hostile texts in every answer of the app, in Chromium", len(texts), len(faults), fields)
    assert not faults
