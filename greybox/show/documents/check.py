"""A check: what can be learnt of a model's parameters, before anything is fitted."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING

from greybox.base import Finding
from greybox.base import document as doc
from greybox.base.document import Document, Later, TableBlock
from greybox.base.texts import LINE_WIDTH
from greybox.data.experiment import collect_record_findings
from greybox.data.findings import UNITS_TAKEN, RecordCode, is_sensor_fault
from greybox.estimation.check import ModelCheck
from greybox.model import equations_text
from greybox.model.effects.catalogue import AT
from greybox.model.parts import PARTS
from greybox.show.documents import tables
from greybox.show.documents.fit import OPEN_RECORDS
from greybox.show.figures.figure import stretches_on_page
from greybox.show.figures.fit import plot_intervals
from greybox.show.figures.records import plot_inputs, plot_outputs
from greybox.show.sentences import sentence
from greybox.show.sentences.identifiability import describe_inputs, describe_verdict
from greybox.show.sentences.model import shorten_reason, write_places, write_units
from greybox.show.sentences.wording import (
    capitalise,
    count_noun,
    format_number,
    join_names,
    percent_text,
    quantity_text,
    record_text,
)

if TYPE_CHECKING:
    from greybox.model.effects import EffectListing


FAST_KERNEL = "for the fast kernel, install a C compiler (gcc, clang) or set the environment variable CC"


def describe_check(check: ModelCheck, *, command: str = "") -> doc.Document:
    """What is said of a check; ``command`` is what was typed."""
    names = join_names([q.name for q in check.model.free_parameters]) or "the parameters"
    # Doubtful sensors, units that no header states, holes, what any record leaves open and the remedy, what is known of these records.
    notes = [*_doubts(check, lambda f: is_sensor_fault(f) or f.code in UNITS_TAKEN), *_gaps(check)]
    structure = check.structure
    # What any record leaves open is no news where priors close it.
    is_open = not check.practical.constants or bool(check.practical.undetermined)
    if structure is not None and not structure.complete and is_open:
        notes.append(describe_verdict(structure))
        notes += [f"remedy: {sentence(remedy)}" for remedy in structure.recommendations]
    notes += [*check.other_answers, *tables.worst_first(check.practical.findings)]
    if check.model.has_equations and not check.compiled:
        notes.append(FAST_KERNEL)
    return doc.Document(
        f"Check of {check.model.title}",
        _answer(check),
        _tone(check),
        [] if check.failure else [_precision_table(check)],
        notes,
        doc.Later(_details, check),
        f"Can {names} be determined? This is checked before the fit.",
        sections=doc.Later(_sections, check, command),
        kind="check",
    )


# Letters from the beginning of a line to what is said, in the lists of a check.
WIDTH = 16


def _details(check: ModelCheck) -> Iterator[doc.Block]:
    """Equations, integration, records, what the outputs can tell at best and what these records tell, roles and effects."""
    yield doc.EquationList([], equations_text(check.model, LINE_WIDTH, in_full=True))
    facts = _computation(check)
    if check.assumed:
        facts += _listed("records", ["none given; simulated at the start values:", str(check.assumed)])
    else:
        inputs = dict.fromkeys(line for e in check.practical.excitation for line in describe_inputs(e))
        facts += _listed("records", [line for e in check.experiments for line in str(e).splitlines()])
        facts += [("noise", _noise(check)), *_listed("input", inputs)]
    yield doc.Facts(facts, width=WIDTH)
    yield from _roles(check)
    if check.failure and not check.model.free_parameters:
        return
    verdict = check.doubt if check.structure is None else describe_verdict(check.structure)
    yield doc.Details(f"identifiability from any record: {verdict}{_choice(check)}", [_structure_facts(check)])
    if not check.failure:
        yield from _combinations(check)


def _listed(name: str, lines: Iterable[str]) -> list[tuple[str, str]]:
    return [("" if k else name, line) for k, line in enumerate(lines)]


def _computation(check: ModelCheck) -> list[tuple[str, str]]:
    if not check.model.has_equations:
        return [("runs as", check.discretisation)]
    facts = [
        ("units", "every term has the unit of its balance"),
        (
            "equations",
            f"{'linear in states and inputs' if check.linear else 'nonlinear'}; integrated by {check.discretisation}",
        ),
        ("runs as", f"{check.kernel} ({check.kernel_reason})"),
    ]
    return facts if check.compiled else [*facts, ("", FAST_KERNEL)]


def _roles(check: ModelCheck) -> Iterator[doc.Block]:
    """The role of each signal, the effects that find a place, and what would open the others."""
    named = {
        group: [f"{n} {role}" for n, role in check.roles[group].items()] for group in ("states", "inputs", "parameters")
    }
    lines = [", ".join(named["states"]) or "no state has one"]
    lines += [", ".join(named[group]) for group in ("inputs", "parameters") if named[group]]
    without = [s.name for s in check.model.states if s.name not in check.roles["states"]]
    lines += [f"without one: {', '.join(without)}"] if without else []
    yield doc.Facts([*_listed("roles", lines), ("effects", "\n".join(write_places(check.placements)))], width=WIDTH)


def _sections(check: ModelCheck, command: str) -> Iterator[doc.Section]:
    yield doc.Section("expected", "What the records can determine", list(_precision(check)))
    yield doc.Section("structure", "What any record could determine", list(_structure(check)))
    computed = doc.Facts(_computation(check), "How it was computed")
    yield doc.Section("model", "The model", [computed, tables.typeset_equations(check.model)])
    yield doc.Section("data", "Data", list(_data(check)))
    yield tables.provenance_section(command)


def _doubts(check: ModelCheck, counts: Callable[[Finding], bool]) -> list[doc.Text]:
    """What the records leave in doubt, sensor faults first."""
    findings = sorted(collect_record_findings(check.experiments), key=is_sensor_fault, reverse=True)
    return [_about_record(finding) for finding in findings if counts(finding)]


def _gaps(check: ModelCheck) -> list[doc.Text]:
    """Holes in the time of the records: another model, or a fit, may refuse what this check has run through."""
    return _doubts(check, lambda finding: finding.code is RecordCode.TIME_GAP)


def _answer(check: ModelCheck) -> str:
    """Which parameters a fit would determine, and how well the least certain of them."""
    title = check.model.title
    if check.doubt and check.model.has_equations:
        return f"The check of {title} has no answer: {check.doubt}."
    if check.failure:
        return f"{title}: {check.failure}."
    open_ones = [name for name, c in check.constants.items() if not c.determined]
    shares = {n: c.std / abs(c.value) for n, c in check.constants.items() if c.determined and c.std and c.value}
    worst = max(shares, key=shares.__getitem__, default="")
    reach = f" to {percent_text(shares[worst], 2)} or better ({worst})" if worst else ""
    records = "A record such as this one" if check.assumed else "These records"
    if any(q.prior is not None for q in check.model.free_parameters):
        records += " and what is known beforehand determine"
    else:
        records += " determines" if check.assumed else " determine"
    count = len(check.constants) - len(open_ones)
    if not open_ones:
        which = "every free parameter" if check.complete else "each parameter only by averaging the noise"
        return f"{records} {which} of {title}{reach}{_choice(check)}, if the model is right."
    left = f"{join_names(open_ones)} {'stays' if len(open_ones) == 1 else 'stay'} open"
    return f"{records} {count or 'none'} of the {len(check.constants)} free parameters of {title}{reach}; {left}."


def _tone(check: ModelCheck) -> doc.Tone:
    if check.doubt and check.model.has_equations:
        return doc.Tone.BAD
    return (
        doc.Tone.GOOD
        if check.complete and not (check.failure or check.other_answers or _doubts(check, is_sensor_fault))
        else doc.Tone.CAUTION
    )


def _precision(check: ModelCheck) -> Iterator[doc.Block]:
    if check.failure:
        yield doc.Paragraphs([check.failure], doc.Tone.CAUTION)
        return
    yield _precision_table(check)
    percent = {name: 196 * c.std / abs(c.value) for name, c in check.constants.items() if c.std and c.value}
    figure = plot_intervals(percent, "Expected half width of each 95 % interval: smaller is better.")
    if figure is not None:
        yield doc.FigureBlock(figure)
    yield from _combinations(check)
    if check.practical.findings:
        yield doc.BulletList(check.practical.findings)


def _precision_table(check: ModelCheck) -> doc.TableBlock:
    rows = []
    for name, c in check.constants.items():
        share = f" ({percent_text(c.std / abs(c.value), 2)})" if c.std is not None and c.value else ""
        std = "" if c.std is None else f"{format_number(c.std, 2)}{share}"
        remark = "not determined" if c.std is None or not c.determined else "only by averaging" if c.averaged else ""
        rows.append([name, format_number(c.value), std, c.unit, remark])
    caption = "Expected standard deviations of a fit near the start values, if the model is right"
    return doc.TableBlock(caption, ["parameter", "start value", "expected std", "unit", doc.REMARK], rows)


def _combinations(check: ModelCheck) -> Iterator[doc.Facts]:
    """Combinations of parameters that the records determine, where they do not determine each of them."""
    practical = check.practical
    facts = [
        ("combinations above the noise", _formulas(practical.combinations)),
        ("only by averaging the noise", _formulas(practical.by_averaging)),
        (
            "least precise combination",
            f"{', '.join(practical.weakest)} ({percent_text(practical.weakest_std, 2)})" if practical.weakest else "",
        ),
    ]
    if not check.complete and any(text for _, text in facts):
        yield doc.Facts(
            [fact for fact in facts if fact[1]], "Combinations of parameters, with their expected standard deviations"
        )


def _formulas(combinations: Mapping[str, float]) -> str:
    return ", ".join(f"{text} ({percent_text(std, 2)})" for text, std in combinations.items())


def _choice(check: ModelCheck) -> str:
    """``, up to an exchange``: what no record decides although each constant is determined."""
    exchanged = any(finding.values["exchanged"] for finding in check.other_answers)
    return ", up to an exchange" if exchanged else ", up to a choice" if check.other_answers else ""


def _structure(check: ModelCheck) -> Iterator[doc.Block]:
    structure = check.structure
    if structure is None:
        yield doc.Paragraphs([capitalise(check.doubt)], doc.Tone.BAD if check.model.has_equations else doc.Tone.PLAIN)
        return
    yield doc.Paragraphs([describe_verdict(structure)], doc.Tone.GOOD if structure.complete else doc.Tone.CAUTION)
    if not structure.complete:
        yield _structure_facts(check)
    if check.other_answers:
        yield doc.BulletList(list(check.other_answers))


def _structure_facts(check: ModelCheck) -> doc.Facts:
    """Combinations that any record determines, what stays open, and what would close it."""
    structure = check.structure
    facts: list[tuple[str, doc.Text]] = []
    if structure is not None and not structure.complete:
        more = structure.rank - len(structure.determined)
        formulas = [*structure.determined, *([f"{more} more"] if more else [])]
        facts = [("determined", ", ".join(formulas))] if formulas else []
        facts += [("not determined", str(direction)) for direction in structure.directions]
        facts += [("or" if k else "remedy", remedy) for k, remedy in enumerate(structure.recommendations)]
    return doc.Facts(facts, "What stays open")


# Records of a check whose curves are drawn.
RECORDS_OF_CHECK = 10


def _data(check: ModelCheck) -> Iterator[doc.Block]:
    if check.assumed:
        yield doc.Paragraphs([f"No records were given. The check uses a simulated one: {check.assumed}"])
    head = ["record", "rows", "duration", "sampling time", "fingerprint"]
    rows = [
        [e.name, str(e.rows), f"{e.duration:.6g} s", tables.format_sampling_time(e.time), e.fingerprint[:12]]
        for e in check.experiments
    ]
    yield doc.TableBlock("Records", head, rows, "" if check.assumed else f"Noise: {_noise(check)}")
    # Sensor faults stand in the verdict.
    findings = [finding for finding in collect_record_findings(check.experiments) if not is_sensor_fault(finding)]
    if findings:
        yield doc.BulletList(list(map(_about_record, findings)))
    if not check.assumed:
        lines = dict.fromkeys(line for e in check.practical.excitation for line in str(e).splitlines())
        yield doc.BulletList(list(lines))
    units = tables.signal_units(check.model)
    drawn = check.experiments[:RECORDS_OF_CHECK]
    stretches = stretches_on_page(sum(len(e.inputs) + len(e.outputs) for e in drawn))
    for k, e in enumerate(drawn):
        figures = plot_outputs(e, units, f"outputs-{k}"), plot_inputs(e, units, f"inputs-{k}")
        blocks = [doc.FigureBlock(f, stretches, group=f"{k}") for f in figures if f is not None]
        yield from blocks if k < OPEN_RECORDS else [doc.Details(capitalise(record_text(e.name)), blocks)]


def _about_record(finding: Finding) -> str:
    return f"Record {finding}"


def _noise(check: ModelCheck) -> str:
    """How large the noise is, where it is known from, and which outputs are left out."""
    units = {o.name: o.unit for o in check.model.outputs}
    sizes = ", ".join(f"{name} {quantity_text(std, units[name])}" for name, std in check.noise.items())
    return "; ".join([sizes, *map(str, (check.noise_model, *check.excluded))])


# The effects of the catalogue, and where they find a place in a model.


HEAD = ("effect", "at", "parameters", "equation")


def describe_effects(listing: EffectListing) -> Document:
    """How many effects there are, by site; each with its parameters and its equation, and why some have no place."""
    taken = [p for p in listing.placements if p.effect is not None]
    if listing.model:
        kinds = {p.name.partition(AT)[0] for p in taken}
        places = f", at {count_noun(len(taken), 'place')}" if len(taken) > len(kinds) else ""
        answer = f"{listing.model} takes {count_noun(len(kinds), 'effect')} of {len(listing.entries)} that are known{places}."
        sites = [(p.site, p.name) for p in taken]
    else:
        answer, sites = (
            f"{count_noun(len(listing.entries), 'effect')} can be added to a model.",
            [(e.site, e.name) for e in listing.entries],
        )
    full = list(_tables(listing))
    if len(sites) == 1:
        return Document("Effects", f"{sites[0][1]} acts at {sites[0][0]}.", table=full[: 1 + bool(listing.model)])
    groups: dict[str, list[str]] = {}
    for site, name in sites:
        groups.setdefault(site, []).append(name)
    by_site = TableBlock(
        "Effects by site",
        ["acts at", "effects"],
        [[site or "anywhere", ", ".join(names)] for site, names in groups.items()],
    )
    tried = ", ".join(listing.candidates)
    notes = [f"discover tries what the model lists, and what a record may have wrong: {tried}; --effects names others."]
    return Document(
        "Effects", answer, table=[by_site], notes=notes if listing.candidates else (), details=Later(lambda: full)
    )


def _tables(listing: EffectListing) -> Iterator[TableBlock]:
    if not listing.model:
        yield TableBlock(
            "Effects", HEAD, [[e.name, e.site, write_units(e.parameters), e.equation] for e in listing.entries]
        )
        yield TableBlock("Parts that a rig has or lacks", ["part", "what it is"], [[p.name, p.meaning] for p in PARTS])
        return
    rows = [
        [p.name, p.site, write_units(p.parameters), p.effect.equation]
        for p in listing.placements
        if p.effect is not None
    ]
    yield TableBlock("Effects", HEAD, rows)
    refused = [[p.name, shorten_reason(p)] for p in listing.placements if p.effect is None]
    if refused:
        yield TableBlock("Effects without a place", ["effect", "why it has no place"], refused)
