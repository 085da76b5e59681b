"""The documentation: its tutorials run as they stand, its formulas and its reference are complete."""

from __future__ import annotations

import importlib.util
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

import greybox
import greybox.model.effects
from tests.support.documented import ROOT, blocks, commands, missing, run_page, same

DOCS = ROOT / "docs"
# Pages that are run here, quickly: without the parts marked slow. The others are run by the slow tests: what they type is run by a
# test of its command as well.
QUICK = (
    "tools.md",
    "equations.md",
    "own_model.md",
    "own_effect.md",
    "changed.md",
    "fleet.md",
    "laws.md",
    "extensions.md",
    "records.md",
)
STUDIES = sorted(path.stem for path in (DOCS / "gallery").glob("*.md"))
QUICK_STUDIES = ("first_order_steps", "pendulum_constants", "worn_bearing")
TUTORIALS = (
    *("tutorial_micro_actuator.md", "tutorial_pneumatic.md", "study_files.md", "design.md", "robots.md"),
    *QUICK,
)


@pytest.fixture(scope="module")
def hooks():
    spec = importlib.util.spec_from_file_location("docs_hooks", DOCS / "hooks.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.rest
@pytest.mark.parametrize("page", [pytest.param(p, marks=[pytest.mark.slow] * (p == "fleet.md")) for p in QUICK])
def test_a_page_runs_and_prints_what_it_shows(page: str, tmp_path: Path) -> None:
    run = run_page(DOCS / page, tmp_path)
    assert not run.missing, "\n".join(run.missing)


@pytest.mark.slow
@pytest.mark.parametrize("page", TUTORIALS)
def test_a_whole_tutorial_runs_and_prints_what_it_shows(page: str, tmp_path: Path) -> None:
    run = run_page(DOCS / page, tmp_path, slow=True)
    assert not run.missing, "\n".join(run.missing)


@pytest.mark.parametrize(
    "study", [s if s in QUICK_STUDIES else pytest.param(s, marks=pytest.mark.slow) for s in STUDIES]
)
def test_a_study_of_the_gallery_runs_and_prints_what_it_shows(study: str, tmp_path: Path) -> None:
    run = run_page(DOCS / "gallery" / f"{study}.md", tmp_path)
    assert not run.missing, "\n".join(run.missing)
    assert run.printed and blocks(DOCS / "gallery" / f"{study}.md")[-1].language == "text"


def test_the_gallery_lists_each_study_once_with_a_sentence(hooks) -> None:
    page = (DOCS / "gallery.md").read_text(encoding="utf-8")
    listed = " ".join(hooks.LISTED.findall(page)).split()
    assert sorted(listed) == STUDIES and len(STUDIES) >= 20
    html = hooks.on_page_markdown(page)
    for study in STUDIES:
        title, sentence, *_ = (DOCS / "gallery" / f"{study}.md").read_text(encoding="utf-8").split("\n\n")
        assert title.startswith("# ") and sentence.endswith(".") and "\n" not in sentence
        assert f"](gallery/{study}.png)" in html and sentence in html


def test_the_picture_of_a_study_is_drawn_once_for_each_state_of_its_page(hooks, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(hooks, "CACHE", tmp_path / "kept")
    page = tmp_path / "study.md"
    text = (DOCS / "gallery" / "first_order_steps.md").read_text(encoding="utf-8")
    page.write_text(text, encoding="utf-8")
    picture = hooks.run_study(page)
    assert picture.startswith(b"\x89PNG")
    kept = next((tmp_path / "kept").iterdir())
    kept.write_bytes(b"kept")
    assert hooks.run_study(page) == b"kept"
    page.write_text(text.replace("a = 0.01", "a = 0.5"), encoding="utf-8")
    with pytest.raises(ValueError, match=r"not printed: a = 0\.5"):
        hooks.run_study(page)


def test_every_page_with_commands_or_code_is_run() -> None:
    pages = {p.name for p in DOCS.glob("*.md") if any(b.language == "python" or _own_commands(b) for b in blocks(p))}
    assert pages == set(TUTORIALS)


def _own_commands(block) -> bool:
    return block.language == "sh" and any(line.startswith("greybox") for line in commands(block.text))


@pytest.mark.parametrize(
    ("shown", "printed", "lacking"),
    [
        ("K 5895.5 +- 0.12", "head\nK  5895.6 +- 0.13\ntail", 0),  # another machine's last digits
        ("K 5895.5", "K 5000.0", 1),
        ("B 1\nA 2", "A 2\nB 1", 1),  # in another order
        ("note: x lacks", "note: y lacks", 1),
        ("...\nend", "begin\nend", 0),
        ("a 1, ...", "a 1, b 2, c 3", 0),
        ("a 1, ...", "a 2, b 2, c 3", 1),
    ],
)
def test_what_a_page_shows_is_compared_with_what_is_printed(shown: str, printed: str, lacking: int) -> None:
    assert len(missing(shown, printed)) == lacking


def test_lines_are_the_same_by_words_and_numbers() -> None:
    assert same("x 1.05e-06 m", "x   1.051e-06  m") and not same("x 1.05e-06 m", "x 1.05e-05 m")


def test_formulas_become_mathml_and_code_stays(hooks) -> None:
    html = hooks.on_page_markdown("mass $m_j$ and `$x$`\n\n$$\\dot x = A x$$\n\n```sh\necho $HOME $PATH\n```\n")
    assert html.count("<math") == 2 and 'display="block"' in html
    assert "`$x$`" in html and "echo $HOME $PATH" in html


def test_the_reference_holds_every_public_name(hooks) -> None:
    named = re.findall(r"^::: (\S+)$", hooks.public_names(), re.MULTILINE)
    shown = [name.rpartition(".")[2] for name in named]
    top = [name for names in greybox._NAMES.values() for name in names]
    assert shown[: len(top)] == top
    assert set(greybox.__all__) - set(greybox._NAMESPACES) == set(top)
    assert len(named) == len(set(named))
    for namespace in ("blackbox", "discovery", "export", "uncertainty"):
        assert set(getattr(greybox, namespace).__all__) <= set(shown)


def test_dir_lists_the_names_of_each_namespace() -> None:
    namespaces = [getattr(greybox, name) for name in dir(greybox) if not name[0].isupper()]
    faces = [module for module in namespaces if hasattr(module, "__all__")]
    assert {greybox.export, greybox.fleet, greybox.fmu, greybox.effects} <= {*faces}
    for module in faces:
        assert set(module.__all__) <= set(dir(module)), module.__name__
        assert not {"TYPE_CHECKING", "lazy_face"} & set(dir(module)), module.__name__


def test_commands_and_catalogue_are_those_of_the_program(hooks) -> None:
    from greybox.shell.commands import COMMANDS

    text = hooks.commands()
    for command in COMMANDS:
        assert f"## greybox {command}\n" in text
    assert "--json" in text and "\x1b" not in text
    page = hooks.write_catalogue_page(greybox.model.effects.CATALOGUE)
    assert (DOCS / "catalogue.md").read_text(encoding="utf-8") == page, "run python docs/hooks.py"
    roles = hooks.write_roles_page(greybox.model.effects.ROLES)
    assert (DOCS / "roles.md").read_text(encoding="utf-8") == roles, "run python docs/hooks.py"


def test_a_section_of_the_catalogue(hooks) -> None:
    page = hooks.write_catalogue_page((greybox.model.effects.effect("load_dependent_friction"),))
    assert page.endswith(
        "## At force\n"
        "\n"
        "Needs a balance of a velocity, in N, N m or per mass.\n"
        "\n"
        "### load_dependent_friction\n"
        "\n"
        "`-(Fc + mu (sizes of the forces that do not depend on v)) sign(v)` (`gear`; occasional, `weight` common)\n"
        "\n"
        "- `Fc` [{force}]: friction without load\n"
        "- `mu` [1]: friction over the force transmitted\n"
        "\n"
        "Contains [coulomb_friction](#coulomb_friction).\n"
        "\n"
        "Move at one speed under several loads: this friction grows with the load, Coulomb and viscous friction do not.\n"
        "\n"
        "*gears and harmonic drives: Hamon, Gautier, Garrec 2010, Dynamic identification of robots with a dry friction model"
        " depending on load and velocity.*\n"
    )


def test_a_clone_shows_what_the_built_pages_show(hooks) -> None:
    marks = re.compile(r"^<!-- (?!slow|figure|part|end)[\w :]+ -->$", re.MULTILINE)
    for path in DOCS.rglob("*.md"):
        text = path.read_text(encoding="utf-8")
        assert hooks.keep(text) == text, "run python docs/hooks.py"
        # No page ends, or goes on with a heading, where a clone's reader would find nothing below a mark.
        for mark in marks.finditer(text):
            below = text[mark.end() :].partition("<!-- end -->")
            assert below[1] and below[0].strip(), f"{path.name}: nothing below {mark[0]}"
            assert "<!-- end -->" not in hooks.on_page_markdown(text)


def test_every_package_has_its_table_of_modules(hooks) -> None:
    tables = hooks.modules()
    layers = {path.parent.name for path in (ROOT / "greybox").glob("*/__init__.py")}
    assert layers == set(re.findall(r"^## (\w+)$", tables, re.MULTILINE))
    assert "| `transcription/single_shooting.py` |" in tables


def test_pages_of_studies_find_their_way_into_the_navigation(hooks) -> None:
    decisions = {"Decisions": ["decisions/discovery.md"]}
    listed = {"nav": [{"Start": "index.md"}, {"More": [decisions]}, {"Studies": ["studies/errata.md"]}]}
    nav = list(hooks._pages(hooks.on_config(type("Config", (), listed)).nav))
    written = [p.relative_to(DOCS).as_posix() for p in DOCS.glob("*/*.md")]
    assert sorted(nav) == sorted(
        ["index.md", *(page for page in written if not page.startswith(("gallery/", "paper/")))]
    )
    assert all(page.startswith("decisions/") for page in decisions["Decisions"])


@pytest.mark.slow
@pytest.mark.timeout(1800)  # it runs the gallery
def test_the_site_builds_without_warnings_and_fetches_nothing(tmp_path: Path) -> None:
    pytest.importorskip("material", reason="mkdocs-material comes with the extra 'docs'")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=1800)
    assert done.returncode == 0, done.stderr
    fetched = re.compile(r'(?:src|href)="(https?:)?//[^"]+\.(?:js|css|woff2?)"')
    for page in tmp_path.rglob("*.html"):
        assert not fetched.search(page.read_text(encoding="utf-8")), page.name
    assert "<math" in (tmp_path / "how_it_works.html").read_text(encoding="utf-8")
    index = json.loads((tmp_path / "search" / "search_index.json").read_text(encoding="utf-8"))
    assert {"reference.html", "commands.html"} <= {d["location"].partition("#")[0] for d in index["docs"]}


@pytest.mark.parametrize("page", ["README.md", "CHANGELOG.md"])
def test_pages_say_how_many_effects_there_are(page: str) -> None:
    said = re.search(r"atalogue\S* holds (\d+) effects", (ROOT / page).read_text(encoding="utf-8"))
    assert said is not None and int(said[1]) == len(greybox.model.effects.all_effects())
