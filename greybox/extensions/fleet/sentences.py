"""What is said of a fleet: how many records have a result, the population of the constants, what is said of how many records."""

from __future__ import annotations

from typing import TYPE_CHECKING

from greybox.base.findings import Finding
from greybox.extensions.fleet.result import FleetCode
from greybox.show.sentences.registry import register, renders, sentence
from greybox.show.sentences.wording import count_noun, format_number, format_table, make_formatter

if TYPE_CHECKING:
    from greybox.extensions.fleet.result import ConstantDistribution, FleetResult


def _fitted(finding: Finding) -> str:
    v = finding.values
    if v["fitted"] == v["records"]:
        return f"all {count_noun(v['records'], 'record')} {'was' if v['records'] == 1 else 'were'} fitted"
    return f"{v['fitted']} of {count_noun(v['records'], 'record')} were fitted"


def _finding_count(finding: Finding) -> str:
    v = finding.values
    return f"{v['records']} of {count_noun(v['of'], 'record')}, {finding.subject} the first: {v['sentence']}"


register(
    {
        FleetCode.RECORDS_FITTED: _fitted,
        FleetCode.RECORDS_LEFT: "{left} of {records} records were not begun: the same call with the journal goes on from here",
        FleetCode.RECORD_WITHOUT_RESULT: "record {subject} has no result: {reason}",
        FleetCode.FINDING_COUNT: _finding_count,
    }
)

POPULATION_HEAD = [
    "parameter",
    "median",
    "90 % of the records",
    "from record to record",
    "left open by a record",
    "records",
]
# Records without a result that print names; the page and the table have all.
NAMED_RECORDS = 10


def distribution_row(name: str, constant: ConstantDistribution) -> list[str]:
    """One constant as cells below `POPULATION_HEAD`."""
    notes = [
        f"{count} {what}"
        for count, what in ((constant.undetermined, "open"), (constant.at_bound, "at a bound"))
        if count
    ]
    records = ", ".join([str(constant.count), *notes])
    if not constant.count:
        return [name, "", "", "", "", records]
    unit = "" if constant.unit == "1" else constant.unit
    write = make_formatter(constant.median, (constant.high - constant.low) / 10)
    spread = (
        "not visible"
        if not constant.spread
        else f"{100 * constant.spread:.2g} %"
        if constant.relative
        else f"{constant.spread:.2g} {unit}".rstrip()
    )
    left_open = f"{100 * constant.std / constant.median:.2g} %" if constant.relative else f"{constant.std:.2g}"
    return [
        name,
        f"{write(constant.median)} {unit}".rstrip(),
        f"{write(constant.low)} to {write(constant.high)}",
        spread,
        left_open,
        records,
    ]


MISFIT_HEAD = ["misfit over noise", "median", "90 % of the records"]


def misfit_rows(fleet: FleetResult) -> list[list[str]]:
    """Misfit over noise of each output over the records."""
    return [
        [name, format_number(median, 3), f"{format_number(low, 3)} to {format_number(high, 3)}"]
        for name, (low, median, high) in fleet.noise_ratios.items()
    ]


@renders("FleetResult")
def write_fleet(fleet: FleetResult) -> str:
    """How many records have a result, the population of the constants, what is said of how many records."""
    first, *others = fleet.findings
    lines = [f"{fleet.model.title}: {sentence(first)}"]
    if fleet.population:
        rows = [distribution_row(name, constant) for name, constant in fleet.population.items()]
        lines += ["", *format_table(POPULATION_HEAD, rows)]
    if rows := misfit_rows(fleet):
        lines += ["", *format_table(MISFIT_HEAD, rows)]
    failed = [f for f in others if f.code == FleetCode.RECORD_WITHOUT_RESULT]
    notes = [f"{f.severity}: {sentence(f)}" for f in others if f not in failed[NAMED_RECORDS:]]
    if len(failed) > NAMED_RECORDS:
        notes.append(
            f"warning: {count_noun(len(failed) - NAMED_RECORDS, 'more record')} without a result; the table names them"
        )
    return "\n".join([*lines, *([""] if notes else []), *notes])
