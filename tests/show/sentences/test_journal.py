"""Golden texts of a damaged journal."""

import pytest

from greybox.base.files import JournalCode
from greybox.base.values import Finding
from greybox.show.sentences import sentence

GOLDEN = [
    (
        JournalCode.LAST_LINE_CUT,
        {},
        "journal.jsonl: the last line was incomplete and is cut off: what stood there is computed again",
    ),
    (
        JournalCode.LINES_SKIPPED,
        {"lines": [7], "count": 1},
        "journal.jsonl: 1 line skipped that is no entry (7): what stood there is computed again",
    ),
    (
        JournalCode.LINES_SKIPPED,
        {"lines": [1, 2, 3, 4, 5], "count": 8},
        "journal.jsonl: 8 lines skipped that are no entry (1, 2, 3, 4, 5 and 3 more): what stood there is computed again",
    ),
]


@pytest.mark.parametrize(("code", "values", "text"), GOLDEN)
def test_every_damage_is_said(code, values, text):
    assert sentence(Finding(code, subject="journal.jsonl", values=values)) == text
