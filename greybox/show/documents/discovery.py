"""A discovery: the missing effect, its certainty, and the error before and after."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from greybox.base import Severity, format_unit
from greybox.base import document as doc
from greybox.base.json_shape import to_values
from greybox.base.values import with_code
from greybox.discovery.claims import Depth, name_claim
from greybox.discovery.decision import Grade, Verdict
from greybox.discovery.findings import DiscoveryCode
from greybox.discovery.holdout import worst_output
from greybox.estimation.result import Fit
from greybox.show.documents import tables
from greybox.show.documents.fit import OPEN_RECORDS, units_in_doubt
from greybox.show.figures import discovery as search_figures
from greybox.show.figures.figure import stretches_on_page, typeset_unit
from greybox.show.figures.records import plot_residuals_before_after, plot_spectra_before_after
from greybox.show.sentences import discovery as words
from greybox.show.sentences import sentences, wording

if TYPE_CHECKING:
    from greybox.discovery import Discovery, HoldoutError

# How the answer is marked; every other verdict asks for caution.
TONES = {Verdict.COMPLETE: doc.Tone.GOOD, Verdict.NAMED: doc.Tone.GOOD}


def describe_discovery(discovery: Discovery, *, command: str = "") -> doc.Document:
    """What is said of a discovery; ``command`` is what was typed."""
    plain = discovery.base.model.title
    return doc.Document(
        f"Effects that {plain} lacks",
        discovery_answer(discovery),
        discovery_tone(discovery),
        doc.Later(_tables, discovery),
        doc.Later(_notes, discovery),
        doc.Later(_details, discovery),
        f"Which effect, if any, does {plain} lack?",
        doc.Later(lambda: [doc.FigureBlock(search_figures.plot_holdout_error(discovery))]),
        doc.Later(_sections, discovery, command),
        "discovery",
    )


# Sets of effects that an answer shows, the plain model and its own among them; page and details have all.
SHOWN_SETS = 6
# An effect of the catalogue with no place in the model is no news in the text; one that should have worked is.
FAILED_CODES = (DiscoveryCode.CANDIDATE_FAILED, DiscoveryCode.CANDIDATE_NOT_SIMULATED)


def discovery_answer(discovery: Discovery) -> str:
    """What the model lacks, and the error on other records before and after in the output that it misses most."""
    first, *_ = sentences(discovery.conclusion) or ("There is no verdict.",)
    errors = discovery.holdout
    if not discovery.effects or not errors:
        return first
    output = worst_output(errors)
    e = errors[output]
    change = wording.change_text(e.before, e.after, e.unit)
    return f"{first.rstrip('.')}; the error in {output} on the validation records falls from {change}."


def discovery_tone(discovery: Discovery) -> doc.Tone:
    """Green where the answer is certain; every other verdict asks for caution."""
    return TONES.get(discovery.verdict, doc.Tone.CAUTION)


def _tables(discovery: Discovery) -> Iterator[doc.Block]:
    """The effects of the answer; and where they are not the whole truth, what else was tried."""
    if discovery.effects:
        yield _effects_table(discovery)
    if not discovery.effects or discovery.verdict in (Verdict.PARTLY, Verdict.UNKNOWN):
        yield _sets_table(discovery, SHOWN_SETS)


def _sets_table(discovery: Discovery, most: int | None = None) -> doc.TableBlock:
    """The plain model, the answer, and the other sets of effects, those with the least error on the validation records first."""
    output = worst_output(discovery.holdout)
    error = discovery.holdout[output]
    chosen = {e["name"] for e in discovery.effects}
    tried = sorted(
        discovery.ranking, key=lambda r: (set(r.effects) != chosen, r.errors.get(output, math.inf), r.behind)
    )
    factor, prefix = wording.choose_prefix(error.unit, error.before)

    def quote(size: float) -> str:
        return wording.with_unit(f"{factor * size:.3g}", f"{prefix}{error.unit}")

    rows = [["none", "", quote(error.before), "", ""]]
    for r in tried[: None if most is None else most - 1]:
        after = error.after if set(r.effects) == chosen else r.errors.get(output, math.nan)
        taken = 100 * (1 - after / error.before)
        cells = [quote(after), f"{taken:.0f} %" if taken > 0 else "grows"] if math.isfinite(after) else [""] * 2
        rows.append([" + ".join(r.effects), str(r.constants), *cells, str(r.occurrence)])
    head = ["effects", "constants", f"error in {output}", "taken away", "on such rigs"]
    if most is not None:  # few and short: a set should stand on one line
        head, rows = [head[0], *head[2:]], [[row[0], *row[2:]] for row in rows]
    note = "Errors are those on the validation records, with the constants that the estimation records gave."
    if with_code(discovery.findings, DiscoveryCode.LEARNT_FROM_VALIDATION):
        note = (
            "Errors of the answer and of the model without effects are those on the second half of the validation records, with constants"
            " that their first half gave too; those of the other sets may rest on the estimation records alone."
        )
    if any(not row[-2] for row in rows[1:]):
        note += " A set without an error was fitted too, but was too far behind on the estimation records to be run on these."
    return doc.TableBlock("Sets of effects", head, rows, note)


def _notes(d: Discovery) -> Iterator[doc.Text]:
    """What the answer leaves out, the next step, what to know of the records."""
    yield from units_in_doubt(d.best)
    # What the rig has decides the name, and what was fitted the constants: these come before what is left.
    first = (DiscoveryCode.USUAL_FIRST, DiscoveryCode.ASK_PART, DiscoveryCode.LEARNT_FROM_VALIDATION)
    yield from (f for f in (*d.conclusion, *d.next_steps, *d.findings) if f.code in first)
    # By how much the errors fall stands with the answer and in the details.
    yield from [f for f in d.conclusion if f.code not in (*first, DiscoveryCode.ERROR_REDUCED)][1:]
    rest = tables.worst_first(f for f in (*d.findings, *d.instruments) if f.code not in first)
    yield from (f for f in rest if f.severity is not Severity.NOTE)
    yield from (f for f in d.next_steps if f.code not in first)
    yield from (f"{name} is out: {finding}" for name, finding in d.not_tried.items() if finding.code in FAILED_CODES)
    yield from (text for text in [words.impossible_text(d.not_tried)] if text)
    yield from (f for f in (*d.findings, *d.instruments) if f.severity is Severity.NOTE)


def _details(d: Discovery) -> Iterator[doc.Block]:
    """Where the plain model falls short, the errors, the claims, the candidates."""
    where = str(d.localisation).splitlines() if d.localisation.is_missing else []
    lines = [*(f"the plain model: {line}" for line in where), *holdout_lines(d)]
    yield doc.BulletList([*lines, *([] if d.surrogate is None else [f"surrogate: {d.surrogate}"])])
    if d.claims:
        yield _claims(d)
    if d.false_names:
        yield doc.Paragraphs([words.false_names_text(rate) for rate in d.false_names])
    if d.ranking:
        yield _sets_table(d)


def _effects_table(discovery: Discovery) -> doc.TableBlock:
    """Each effect, where it acts, its constants, and how certain it is."""
    called = {law.name: law.claimed for law in discovery.laws}
    rows = []
    for effect in discovery.effects:
        claim = name_claim(discovery.claims, called.get(effect["name"], effect["name"]))
        constants = [words.constant_text(n, c) for n, c in effect["parameters"].items()]
        certainty = (
            "" if claim is None else f"{words.GRADES[claim.grade]} ({words.probability_text(claim.probability)})"
        )
        first, *more = [*([effect["equation"]] if "equation" in effect else []), *constants] or [""]
        rows.append([effect["name"], effect["site"], first, certainty])
        rows += [["", "", constant, ""] for constant in more]
    return doc.TableBlock("What the model lacks", ["effect", "acts at", "constants", "certainty"], rows)


def holdout_lines(discovery: Discovery) -> list[str]:
    """The error of each output before and after."""
    return [f"{output}: rms error on the validation records {error}" for output, error in discovery.holdout.items()]


def _sections(discovery: Discovery, command: str) -> Iterator[doc.Section]:
    best = discovery.best
    yield from discovery_sections(discovery, beside_verdict=True)
    yield doc.Section("parameters-before-after", "Parameters before and after", [_parameters_before_after(discovery)])
    names = ("extended", "The extended model") if best.model.effects else ("model", "The model")
    yield doc.Section(*names, [tables.typeset_equations(best.model)])
    yield tables.records_section(best)
    yield tables.fit_provenance_section(best, command)


def discovery_sections(discovery: Discovery, *, beside_verdict: bool = False) -> Iterator[doc.Section]:
    """The error before and after (its figure may stand ``beside_verdict`` already), the missing signal, where and when, the candidates."""
    figure = [] if beside_verdict else [doc.FigureBlock(search_figures.plot_holdout_error(discovery))]
    yield doc.Section("gap", "Error before and after", [*figure, *_holdout(discovery)])
    if discovery.claims:
        yield doc.Section("claims", "Claims", [_claims(discovery), *_false_names(discovery)])
    signals: list[doc.Block] = [
        doc.FigureBlock(search_figures.plot_effect_signal(signal, f"missing-{k}"))
        for k, signal in enumerate(discovery.effect_signals)
    ]
    if discovery.surrogate is not None:
        signals += [
            doc.Paragraphs([str(discovery.surrogate)]),
            doc.FigureBlock(search_figures.plot_surrogate(discovery.surrogate)),
        ]
    if signals:
        yield doc.Section("missing", "The missing signal", signals)
    if discovery.localisation.is_missing:
        yield doc.Section("localisation", "Localisation of the missing effect", list(_localisation(discovery)))
    if discovery.ranking:
        yield doc.Section("candidates", "Candidates", list(_candidates(discovery)))


# What a claim of each depth states.
DEPTHS = {
    Depth.MISSING: "something",
    Depth.PLACE: "where",
    Depth.VARIABLES: "of what",
    Depth.FAMILY: "family",
    Depth.NAME: "effect",
}


def _claims(discovery: Discovery) -> doc.TableBlock:
    """What is said of the plain model, from what is missing to its name; the sentence last, as it may be long."""
    rows = [
        [
            DEPTHS[claim.depth],
            f"{words.GRADES[claim.grade]} ({words.probability_text(claim.probability)})",
            f"{100 * claim.share:.0f} % in {claim.output}",
            words.rival_text(claim.rival) or "none",
            wording.capitalise(words.claim_text(to_values(claim))),
        ]
        for claim in discovery.claims
    ]
    head = ["claim", "certainty", "share of the error", "best rival", "in words"]
    return doc.TableBlock("What the plain model lacks, from something to its name", head, rows)


def _false_names(discovery: Discovery) -> Iterator[doc.Block]:
    """How often nonsense would have been established in the place of each effect."""
    rows = [
        [r.effect, DEPTHS[r.depth], str(r.among), str(r.tried), str(r.established), f"{100 * r.upper:.0f} %"]
        for r in discovery.false_names
    ]
    if rows:
        head = ["in the place of", "claim", "signals in a draw", "draws", "established", "at most (95 %)"]
        note = "The best signal of each draw takes the place of the effect, and is weighed as it was."
        yield doc.TableBlock("Signals without meaning, made from these records", head, rows, note)


# Validation records of a discovery that are drawn; all of them count.
RECORDS_OF_DISCOVERY = 8


def _holdout(discovery: Discovery) -> Iterator[doc.Block]:
    name, extended, errors = extended_model(discovery)
    rows = [
        [
            output,
            *(wording.quantity_text(v, format_unit(e.unit), 4) for v in (e.before, e.after)),
            wording.quantity_text(e.floor, format_unit(e.unit), 4) if e.is_floor_known else "not known",
            _explained(e),
        ]
        for output, e in errors.items()
    ]
    head = ["output", "plain model", name, "noise", "error taken away"]
    yield doc.TableBlock("Rms error of the free run on the validation records", head, rows)
    path = selection_path(discovery)
    if len(path) > 2:
        steps = [[name, f"{misfit:.4g} × noise"] for name, misfit in path]
        yield doc.TableBlock("Misfit on the estimation records, one effect after the other", ["model", "misfit"], steps)
    pairs = list(zip(discovery.base.validation.traces, extended.validation.traces, strict=False))
    pairs = pairs[:RECORDS_OF_DISCOVERY]
    stretches = stretches_on_page(sum(4 * len(before.measured) for before, _ in pairs))
    for k, (before, after) in enumerate(pairs):
        shared = before, after, tables.signal_units(discovery.base.model), extended.noise.levels
        residuals = plot_residuals_before_after(*shared, f"left-{k}", name)
        spectra = plot_spectra_before_after(*shared, f"spectra-{k}", name, follows=residuals.name)
        together = f"judged-{k}"
        figures: list[doc.Block] = [
            doc.FigureBlock(residuals, stretches, group=together, switch=together),
            doc.FigureBlock(spectra, stretches, switch=together),
        ]
        title = wording.capitalise(wording.record_text(before.name))
        yield from [doc.Subheading(title), *figures] if k < OPEN_RECORDS else [doc.Details(title, figures)]


def _explained(error: HoldoutError) -> str:
    share = error.visible_share
    if share is None:
        return "only noise"
    return f"{100 * share:.0f} %" if share >= 0 else "error grew"


def selection_path(discovery: Discovery) -> list[tuple[str, float]]:
    """The models on the way to the best one, one effect after the other, with their misfit over noise where they were fitted."""
    wanted = {e.name for e in discovery.best.model.effects}
    path = [("plain model", discovery.localisation.misfit)]
    held: set[str] = set()
    while held != wanted:
        nearer = [r for r in discovery.ranking if held < set(r.effects) <= wanted and len(r.effects) == len(held) + 1]
        if not nearer:
            break
        step = min(nearer, key=lambda r: r.misfit)
        added = set(step.effects) - held
        held |= added
        path.append((f"+ {', '.join(sorted(added))}", step.misfit))
    return path


def extended_model(discovery: Discovery) -> tuple[str, Fit, Mapping[str, HoldoutError]]:
    """What stands beside the plain model: its name, its fit and its errors; where no effect came near, the surrogate."""
    surrogate = discovery.surrogate
    if surrogate is not None and not discovery.best.model.effects:
        return f"with {words.surrogate_title(surrogate)}", surrogate.fit, search_figures.errors_to_judge(discovery)
    return extended_name(discovery), discovery.best, discovery.holdout


def extended_name(discovery: Discovery) -> str:
    """What to call the best model of the catalogue."""
    is_look_alike = all(e["grade"] == Grade.STAND_IN for e in discovery.effects)
    is_open = discovery.verdict in (Verdict.UNKNOWN, Verdict.PARTLY)
    return "nearest look-alike" if is_open and is_look_alike else "extended model"


def _localisation(discovery: Discovery) -> Iterator[doc.Block]:
    localisation = discovery.localisation
    yield doc.BulletList([line.strip() for line in str(localisation).splitlines()])
    unexplained = search_figures.plot_unexplained_signal(localisation)
    if unexplained is not None:
        yield doc.FigureBlock(unexplained)
    sets = {name: k + 1 for k, group in enumerate(localisation.sets) for name in group}
    rows = [
        [s.label, str(sets[s.label]), f"{s.gain:.4g}", wording.quantity_text(s.size, format_unit(s.unit))]
        for s in localisation.sites
    ]
    if rows:
        head = ["site", "set", "gain", "signal (rms)"]
        yield doc.TableBlock(
            "Sites, likeliest first",
            head,
            rows,
            "These sensors cannot distinguish the sites of one set. Gain: how much the signal raises the log-likelihood.",
        )
    windows = search_figures.plot_misfit_windows(localisation)
    if windows is not None:
        yield doc.FigureBlock(windows)


def _candidates(discovery: Discovery) -> Iterator[doc.Block]:
    figure = search_figures.plot_candidates(discovery)
    if figure is not None:
        yield doc.FigureBlock(figure)
    if discovery.alternatives:
        yield doc.BulletList([f"{' + '.join(names)} explains the records as well." for names in discovery.alternatives])
    yield doc.Details(f"All {wording.count_noun(len(discovery.ranking), 'candidate')}", [_sets_table(discovery)])


def _parameters_before_after(discovery: Discovery) -> doc.TableBlock:
    """Each parameter with the plain model and with the extended one."""
    if not discovery.best.model.effects:
        return tables.parameters_table(discovery.best)
    rows = []
    for name, e in discovery.best.parameters.items():
        plain = discovery.base.parameters.get(name)
        _, after, limits, _, remark = tables.estimate_cells(name, e)
        before = tables.estimate_cells(name, plain)[1] if plain is not None else "–"
        rows.append([name, before, after, limits, typeset_unit(e.unit), remark])
    head = ["parameter", "plain model", extended_name(discovery), "95 % interval", "unit", "remark"]
    return doc.TableBlock("Parameters: those of the plain model absorb part of the missing effect", head, rows)
