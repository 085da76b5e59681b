"""Everything about the two papers in one go: their tables and figures, and what only the physical model can do.

    python -m fits.papers [--output docs/studies]

writes `docs/studies/paper_tables.md` and its figures anew; each study asserts its verdict on the way. A few minutes.
"""

from __future__ import annotations

import sys
from pathlib import Path

from fits.papers import micromotion_chirp, micromotion_feed_through, micromotion_page, pneumatic_page, pneumatic_supply
from fits.papers.paper_page import Say, docs_folder

STUDIES = (micromotion_page, pneumatic_page, pneumatic_supply, micromotion_chirp, micromotion_feed_through)


def main(folder: Path, say: Say = sys.stdout.write) -> None:
    """All studies, in the order of the page."""
    for study in STUDIES:
        study.main(folder, say)


if __name__ == "__main__":
    main(docs_folder("papers"))
