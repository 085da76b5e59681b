"""The paper and the citation file say what the project is."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[2]
PAPER = (ROOT / "docs" / "paper" / "paper.md").read_text(encoding="utf-8")


def test_the_paper_is_as_long_as_its_journal_wants() -> None:
    body = PAPER.split("---", 2)[2]
    assert 250 <= len(re.findall(r"\w[\w'-]*", re.sub(r"^\|.*$", "", body, flags=re.MULTILINE))) <= 1000


def test_every_citation_has_its_entry_and_the_reverse() -> None:
    entries = re.findall(
        r"^@\w+\{(\w+),", (ROOT / "docs" / "paper" / "paper.bib").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert set(re.findall(r"@([A-Z]\w+)", PAPER)) == set(entries)


def test_the_citation_file_names_this_version() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert citation["version"] == project["version"] and citation["license"] == project["license"]
    assert {"cff-version", "title", "message", "authors", "abstract"} <= set(citation)
