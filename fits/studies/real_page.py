"""What the studies on measured records share: their command line, and the page `real_data.md` that they write."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from fits.papers.paper_page import write_section
from greybox.discovery.findings import DiscoveryCode
from greybox.discovery.result import Discovery

PAGE = "real_data.md"
TITLE = """# What is missing, on measured records

What `greybox discover` says of three public benchmarks (nonlinearbenchmark.org), each begun from the plain model with nothing told, and
how far each model is off. No model is complete on any of them ([what measured records taught us](../measured_lessons.md)).

Written by `python -m fits.studies.real_data FOLDER`, with the folders `silverbox`, `emps` and `cascaded_tanks` below FOLDER; the records
are not part of this project. Constants and effects come from the training record alone, part of which is kept back to choose by. All
errors are those of free runs, as root mean squares. Three settings were settled with test errors in view: the rows of the last silverbox
fit, the first part of an EMPS arc, and the form of the tanks' reading curve.
"""


def arguments(study: str, *files: str) -> tuple[Path, Path]:
    """The folder of the records and the folder of the page from the command line; without the files a usage line and exit code 2."""
    parser = argparse.ArgumentParser(prog=f"python -m fits.{study}")
    parser.add_argument("folder", metavar="FOLDER", type=Path, help=f"folder with {', '.join(files)}")
    parser.add_argument(
        "--output", metavar="DOCS", type=Path, default=Path("docs/studies"), help="folder of the page (docs/studies)"
    )
    given = parser.parse_args()
    missing = [name for name in files if not (given.folder / name).is_file()]
    if missing:
        parser.error(f"{given.folder} has no {', '.join(missing)}; give the folder of these records")
    return given.folder, given.output


def write(folder: Path, name: str, parts: Sequence[str]) -> Path:
    """Put the paragraphs ``parts`` as the part ``name`` into the page."""
    return write_section(folder, name, "\n\n".join(parts), PAGE, TITLE)


def verdict_text(discovery: Discovery) -> str:
    """The finding in its own words, without what is said of the rest."""
    of_rest = (DiscoveryCode.ERROR_LEFT, DiscoveryCode.MISSING_SIGNAL)
    story = " ".join(str(finding) for finding in discovery.conclusion if finding.code not in of_rest)
    return f"`greybox discover` (verdict *{discovery.verdict}*): {story}"
