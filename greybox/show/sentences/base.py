"""Sentences about a journal whose lines were damaged."""

from __future__ import annotations

from greybox.base import Finding
from greybox.base.files import JournalCode
from greybox.show.sentences import register, writes
from greybox.show.sentences.wording import count_noun


@writes(JournalCode.LINES_SKIPPED)
def _lines_skipped(finding: Finding) -> str:
    lines, count = finding.values["lines"], finding.values["count"]
    more = f" and {count - len(lines)} more" if count > len(lines) else ""
    return (
        f"{finding.subject}: {count_noun(count, 'line')} skipped that {'is' if count == 1 else 'are'} no entry"
        f" ({', '.join(map(str, lines))}{more}): what stood there is computed again"
    )


register(
    {
        JournalCode.LAST_LINE_CUT: "{subject}: the last line was incomplete and is cut off: what stood there is computed again"
    }
)
