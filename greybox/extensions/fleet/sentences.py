"""What is said of a fleet: how many records have a result, what is said of how many records."""

from __future__ import annotations

from greybox.base import Finding
from greybox.extensions.fleet.result import FleetCode
from greybox.show.sentences.registry import register
from greybox.show.sentences.wording import count_noun


def _fitted(finding: Finding) -> str:
    v = finding.values
    if v["fitted"] == v["records"]:
        return f"all {count_noun(v['records'], 'record')} {'was' if v['records'] == 1 else 'were'} fitted"
    return f"{v['fitted']} of {count_noun(v['records'], 'record')} were fitted"


register(
    {
        FleetCode.RECORDS_FITTED: _fitted,
        FleetCode.RECORDS_LEFT: "{left} of {records} records were not begun: the same call with the journal goes on from here",
        FleetCode.RECORD_WITHOUT_RESULT: "record {subject} has no result: {reason}",
        FleetCode.RECORDS_ALIKE: lambda f: (
            f"record {f.subject} is the same measurement as {f.values['first']}"
            + (f", and {count_noun(f.values['pairs'] - 1, 'other record')} so" if f.values["pairs"] > 1 else "")
            + ": the fleet counts it twice; leave one out"
        ),
        FleetCode.FINDING_COUNT: lambda f: (
            f"{f.values['records']} of {count_noun(f.values['of'], 'record')}, {f.subject} the first: {f.values['sentence']}"
        ),
    }
)
