"""The page of a discovery: what is missing, how sure that is, and the gap before and after."""

from __future__ import annotations

import math
from collections.abc import Iterator

from greybox.discovery import Discovery, HoldoutError, Refinement
from greybox.plots.discovery import (
    plot_candidates,
    plot_effect_signal,
    plot_holdout_error,
    plot_misfit_windows,
    plot_surrogate,
    plot_unexplained_signal,
)
from greybox.plots.records import plot_residuals_before_after, plot_spectra_before_after
from greybox.plots.style import PAGE
from greybox.rendering.result import to_constant_cells
from greybox.reports.equations import typeset_equations
from greybox.reports.fit_parts import constants_table
from greybox.reports.page import Block, FigureBlock, Folded, Heading, Listing, Page, Section, Table, Text, Tone
from greybox.reports.provenance import provenance_section
from greybox.reports.records import records_section, signal_units
from greybox.reports.typography import (
    as_sentence,
    count_noun,
    format_number,
    join_names,
    typeset_number,
    typeset_unit,
)

NO_GAP = 1.05  # a misfit up to this many times the noise
MOST_DRAWN = 8  # judging records with curves
TONES: dict[str, Tone] = {"complete": "good", "named": "good", "ambiguous": "caution", "unknown": "caution"}
ANSWERS = {
    "complete": "Nothing is missing.", "named": "Something is missing, and it has a name.",
    "ambiguous": "Something is missing; these records fit more than one name.",
    "unknown": "Something is missing that the catalogue does not explain.",
}  # fmt: skip


def report_of_discovery(found: Discovery, *, command: str = "") -> Page:
    """The page of a discovery; ``command`` is what was typed."""
    sections = [*discovery_sections(found)]
    sections.append(Section("constants", "The constants, before and after", [constants_before_after(found)]))
    model: list[Block] = [typeset_equations(found.best.model)]
    sections.append(Section("model", "The extended model" if found.best.model.effects else "The model", model))
    sections.append(records_section([*found.best.traces], [*found.best.validation.traces], found.best))
    sections.append(provenance_section(found.best, command))
    plain = found.base.model.title
    return Page(
        f"What {plain} lacks", f"Which effect, if any, does {plain} lack?", verdict(found), sections, "discovery"
    )


def verdict(found: Discovery) -> Text:
    """The answer, the story and the notes."""
    said = [ANSWERS[found.verdict], found.story]
    for effect in found.effects if found.verdict != "complete" else []:
        values = [
            typeset_number(f"{name} = {format_number(c['value'])}" + (f" +- {c['std']:.2g}" if c["std"] else ""))
            + f" {typeset_unit(c['unit'])}"
            for name, c in effect["parameters"].items()
        ]
        looks = "The look-alike " if found.verdict == "unknown" else ""
        said.append(f"{looks}{effect['name']} ({effect['site']}): {join_names([v.rstrip() for v in values])}.")
    said += [f"Next: {as_sentence(step)[0].lower()}{as_sentence(step)[1:]}" for step in found.next_steps]
    return Text([*said, *map(as_sentence, found.notes)], TONES[found.verdict])


def discovery_sections(found: Discovery) -> Iterator[Section]:
    """The story: the gap, the missing signal, where and when, the candidates."""
    yield Section("gap", "The gap", list(_gap(found)))
    signal: list[Block] = [FigureBlock(plot_effect_signal(m, f"missing-{k}")) for k, m in enumerate(found.missing)]
    if found.surrogate is not None:
        signal += [Text([as_sentence(str(found.surrogate))]), FigureBlock(plot_surrogate(found.surrogate))]
    if signal:
        yield Section("signal", "The missing signal", signal)
    if found.refinement is not None:
        yield Section("further", "What comes after", list(_further(found.refinement)))
    if found.look.missing:
        yield Section("where", "Where, when and in which region", list(_where(found)))
    if found.ranking:
        yield Section("candidates", "The candidates", list(_candidates(found)))


def _gap(found: Discovery) -> Iterator[Block]:
    yield FigureBlock(plot_holdout_error(found))
    rows = [
        [
            output, *(typeset_number(f"{v:.4g} {typeset_unit(g.unit)}".rstrip()) for v in (g.before, g.after, g.floor)),
            _closed(g),
        ]
        for output, g in found.gap.items()
    ]  # fmt: skip
    head = ["output", "plain model", extended_name(found), "noise", "closed"]
    yield Table("Misfit of the free run on records that nothing was fitted to (rms)", head, rows)
    way = selection_path(found)
    if len(way) > 2:
        steps = [[name, typeset_number(f"{misfit:.4g} × noise")] for name, misfit in way]
        yield Table("Step by step, on the records that were fitted", ["model", "misfit"], steps)
    units = signal_units(found.base.model)
    pairs = list(zip(found.base.validation.traces, found.best.validation.traces, strict=False))[:MOST_DRAWN]
    stretches = PAGE.stretches(sum(4 * len(b.measured) for b, _ in pairs))
    for k, (before, after) in enumerate(pairs):
        shared = before, after, units, found.best.noise.std
        residuals = plot_residuals_before_after(*shared, f"left-{k}", extended_name(found))
        spectra = plot_spectra_before_after(*shared, f"spectra-{k}", extended_name(found), follows=residuals.name)
        group = f"judged-{k}"
        figures = [
            FigureBlock(residuals, stretches, group=group, switch=group), FigureBlock(spectra, stretches, switch=group),
        ]  # fmt: skip
        if k == 0:
            yield Heading(f"Record {before.name}")
        yield from figures if k == 0 else [Folded(f"Record {before.name}", figures)]


def selection_path(found: Discovery) -> list[tuple[str, float]]:
    """Names of the models on the way to the best one, one effect after the other, with their misfit over noise where they were fitted."""
    wanted = {e.name for e in found.best.model.effects}
    path = [("plain model", max((m.noise_ratio for m in found.base.misfit.values()), default=math.nan))]
    held: set[str] = set()
    while held != wanted:
        nearer = [r for r in found.ranking if held < set(r.effects) <= wanted and len(r.effects) == len(held) + 1]
        if not nearer:
            break
        step = min(nearer, key=lambda r: r.misfit)
        new = set(step.effects) - held
        held |= new
        path.append((f"+ {', '.join(sorted(new))}", step.misfit))
    return path


def _closed(gap: HoldoutError) -> str:
    if gap.before <= NO_GAP * gap.floor:
        return "no gap"
    return f"{100 * gap.explained_fraction:.1f} %" if gap.explained_fraction > 0 else "it grew"


def extended_name(found: Discovery) -> str:
    """What to call the extended model."""
    return "with the nearest look-alike" if found.verdict == "unknown" else "with what was found"


def _further(refinement: Refinement) -> Iterator[Block]:
    """The steps beyond the answer, and what they leave."""
    yield Text([refinement.story])
    if not refinement.steps:
        return
    steps = [
        [s.name, _percent(s.fitted), _percent(s.held_out), ", ".join(f"{n} {_percent(v)}" for n, v in s.alike.items())]
        for s in refinement.steps
    ]
    head = ["effect", "of the misfit fitted", "of that on the validation records", "nearly as well"]
    yield Table("Further effects, each with the share of the rms misfit that it takes away", head, steps)
    yield constants_table(refinement.fit)


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def _where(found: Discovery) -> Iterator[Block]:
    look = found.look
    yield Listing([as_sentence(line.strip()) for line in str(look).splitlines()])
    picture = plot_unexplained_signal(look)
    if picture is not None:
        yield FigureBlock(picture)
    sets = {name: k + 1 for k, group in enumerate(look.sets) for name in group}
    rows = [
        [
            str(s),
            str(sets[str(s)]),
            typeset_number(f"{s.gain:.4g}"),
            typeset_number(f"{s.size:.3g} {typeset_unit(s.unit)}".rstrip()),
        ]
        for s in look.sites
    ]
    if rows:
        note = "Places of one set cannot be told apart with these sensors; gain is the logarithm of how much likelier the record is."
        yield Table("Places, likeliest first", ["place", "set", "gain", "size of the signal (rms)"], rows, note)
    picture = plot_misfit_windows(look)
    if picture is not None:
        yield FigureBlock(picture)


def _candidates(found: Discovery) -> Iterator[Block]:
    picture = plot_candidates(found)
    if picture is not None:
        yield FigureBlock(picture)
    if found.alternatives:
        yield Listing([f"{' + '.join(a)} explains the records as well." for a in found.alternatives])
    rows = [
        [" + ".join(r.effects), typeset_number(f"{r.misfit:.4g} × noise"), typeset_number(f"{r.behind:.4g}")]
        for r in found.ranking
    ]
    note = "Behind: by how much Schwarz's criterion is above that of the best; 10 and more are decisive."
    yield Folded(
        f"All {count_noun(len(rows), 'candidate')}", [Table("Candidates", ["effects", "misfit", "behind"], rows, note)]
    )


def constants_before_after(found: Discovery) -> Table:
    """Each constant with the plain model and with the extended one."""
    if not found.best.model.effects:
        return constants_table(found.best)
    rows = []
    for name, e in found.best.parameters.items():
        before = found.base.parameters.get(name)
        _, after, limits, _, remark = map(typeset_number, to_constant_cells(name, e))
        told = typeset_number(to_constant_cells(name, before)[1]) if before is not None else "–"
        rows.append([name, told, after, limits, typeset_unit(e.unit), remark])
    head = ["constant", "plain model", extended_name(found), "95 % interval", "unit", "remark"]
    return Table("Constants: what a model lacks, its other constants have to make up for", head, rows)
