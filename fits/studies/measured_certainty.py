"""Is what is certain on measured records true there? Every rig, independent records: learn here, choose there, judge on a third.

    python -m fits.studies.measured_certainty FOLDER [--output RESULTS] [--limit SECONDS] [--told] [--page FILE]

FOLDER holds the rigs of `fits.studies.measured_rigs`; one that is missing is skipped, and said so. Every search is
a file in RESULTS, so that the
study continues where it was stopped. Each claim, and each effect of the answer, stands beside what is known of the rig: right, wrong, or
not known. The model that `discover` hands over takes a round trip: written as ``model.py``, read back, fitted to the same records, written
again and compiled to C. ``--page`` writes the page without searching.

What to expect: nothing certain on a heavy ball and on the healthy rotor, hardly anything wrong among what is certain elsewhere, and
the same error within 1 % after every round trip.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import subprocess
import sys
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any

import numpy as np

import greybox as gb
from fits.papers.paper_page import markdown
from fits.studies.measured_rigs import RIGS, SEARCHES, TIMING, Case, Fact, Rig
from greybox.base.errors import GreyboxError
from greybox.base.json_shape import to_values
from greybox.base.texts import to_identifier
from greybox.discovery.claims import TIMING as TIMING_FORM
from greybox.discovery.claims import Depth
from greybox.discovery.findings import DiscoveryCode
from greybox.estimation.optim.minimisation import TerminationStatus
from greybox.estimation.validate import validate
from greybox.model.effects.catalogue import AT
from greybox.model.parts import read_parts
from greybox.shell.project import load_model_file
from greybox.simulation.kernel.c_compiler import find_compiler

# Numbers that the state of a model in C may have, the past of a delayed input among them.
PLANT_STATE = 4096
# Steps of a sample at which the model in C and the library are compared: the first with which the run goes through.
SUBSTEPS = (8, 64, 512)
# Share by which two errors may differ and still be the same.
SAME = 0.01
# Seconds after which a search begins no further refit: what it has by then is its answer.
LIMIT = 180.0
DEPTHS = {Depth.PLACE: "place", Depth.VARIABLES: "variables", Depth.FAMILY: "family", Depth.NAME: "name"}
GRADES = ("established", "probable")
WORDS = {True: "right", False: "wrong", None: "not known"}


def judge_claim(rig: Rig, claim: Mapping[str, Any]) -> bool | None:
    """Whether a claim is true of a rig; None where nobody knows."""
    depth, base = Depth(claim["depth"]), claim["name"].partition(AT)[0]
    if depth is Depth.MISSING:
        return bool(rig.facts) or (False if rig.is_whole else None)
    if any(_agrees(fact, claim, depth) for fact in rig.facts):
        return True
    if (depth is Depth.NAME and base in rig.open) or (depth is Depth.FAMILY and set(claim["family"]) & set(rig.open)):
        return None
    # A lag or a delay at a place where one may be.
    if depth is Depth.VARIABLES and claim.get("form") == TIMING_FORM and set(TIMING) & set(rig.open):
        return None
    if rig.is_whole or (depth is Depth.NAME and base in rig.false):
        return False
    return None


def _agrees(fact: Fact, claim: Mapping[str, Any], depth: Depth) -> bool:
    if not set(fact.sites) & set(claim["site"].split(" or ")):
        return False
    if depth is Depth.VARIABLES:
        return bool(set(fact.variables) & set(claim["variables"]))
    families = {name.partition(AT)[0] for name in fact.names}
    if depth is Depth.FAMILY:
        return bool(families & set(claim["family"]))
    return depth is Depth.PLACE or claim["name"] in fact.names


def study(case: Case, root: Path, limit: float, is_told: bool = False) -> dict[str, Any]:
    """One search, what it says beside what is known, and the round trip of its model."""
    rig, began = RIGS[case.rig], process_time()
    learn, choose, judge = (rig.record(root, stretch) for stretch in (case.learn, case.choose, case.judge))
    model = rig.model(root / rig.folder / "model")
    if is_told:
        model = model.with_parts(has=rig.has, lacks=rig.lacks)
    found = gb.discover(model, learn, validation=choose, test=judge, workers=1, time_limit=limit)
    searched = process_time() - began
    claims = [to_values(claim) for claim in found.claims]
    return {
        "rig": case.rig,
        "learn": case.learn,
        "choose": case.choose,
        "judge": case.judge,
        "verdict": str(found.verdict),
        "says": found.story,
        "claims": [{**claim, "right": judge_claim(rig, claim)} for claim in claims],
        "rates": [to_values(rate) for rate in found.false_names],
        "effects": [
            {
                "name": e["name"],
                "grade": str(e["grade"]),
                "probability": e.get("probability"),
                "right": _judge_name(rig, e["name"]),
            }
            for e in found.effects
        ],
        "question": _judge_question(rig, model, found),
        "errors": {
            who: {where: errors_on(fit, record) for where, record in (("choose", choose), ("judge", judge))}
            for who, fit in (("plain", found.base), ("answer", found.extended))
        },
        "seconds": searched,
        "out_of_time": any(f.code is DiscoveryCode.TIME_OVER for f in found.findings),
        "round_trip": round_trip(found, learn, {"choose": choose, "judge": judge}),
    }


def _judge_name(rig: Rig, name: str) -> bool | None:
    """Whether an effect of an answer is there, wherever it acts."""
    return judge_claim(
        rig, {"depth": Depth.NAME, "name": name, "site": " or ".join(s for f in rig.facts for s in f.sites)}
    )


def _judge_question(rig: Rig, model: gb.Model, found: gb.Discovery) -> dict[str, Any] | None:
    """The part that an answer asks for, and whether a name is right to which the answer leads of one who knows the rig; None without one.

    ``right`` is None of a part that nobody has spoken of.
    """
    asked = next((f for f in found.next_steps if f.code is DiscoveryCode.ASK_PART), None)
    if asked is None:
        return None
    known = read_parts(model.with_parts(has=rig.has, lacks=rig.lacks))
    if known.is_open(asked.subject):
        return {"part": asked.subject, "names": [], "right": None}
    names = asked.values["yes" if asked.subject in known.has else "no"].split(" + ")
    return {"part": asked.subject, "names": names, "right": any(_judge_name(rig, name) for name in names)}


def errors_on(fit: gb.Fit, record: gb.Experiment) -> dict[str, float]:
    """Root-mean-square error of the free run by output, its initial state adapted to the beginning of the record."""
    return {output: m.rmse for output, m in validate(fit.model, record, noise=fit.noise.std).misfit.items()}


def round_trip(found: gb.Discovery, learn: gb.Experiment, records: Mapping[str, gb.Experiment]) -> dict[str, Any]:
    """The model that is handed over, written, read back, fitted again: its errors over the answer's; then written again, and in C."""
    with TemporaryDirectory() as folder:
        answer = found.extended
        read = load(gb.export.to_python(answer, Path(folder) / "model.py"))
        # The records that the answer was fitted to: stretches of an unstable plant, rows with a known past, half of a second record too.
        fitted = [trace.experiment for trace in answer.traces]
        # From these constants alone: other starts answer another question.
        refit = gb.fit(read, fitted, options=replace(found.options, other_starts=0, exchange=False))
        again = load(gb.export.to_python(refit, Path(folder) / "again.py"))
        said = [str(f) for f in found.findings if f.code is DiscoveryCode.REFIT_ELSEWHERE]
        return {
            "status": refit.solver.status,
            "said": said,
            "written": relative_difference(answer.model.values, read.values),
            "rewritten": relative_difference(refit.model.values, again.values),
            "errors": {where: errors_on(refit, record) for where, record in records.items()},
            "ratio": {
                where: max(
                    (
                        after / before
                        for before, after in zip(
                            errors_on(answer, r).values(), errors_on(refit, r).values(), strict=True
                        )
                    ),
                    key=lambda ratio: abs(np.log(ratio)),
                )
                for where, r in {"learn": learn, **records}.items()
            },
            "c": run_in_c(refit.model, records["judge"], Path(folder)),
        }


def load(file: Path) -> gb.Model:
    """The model of a file."""
    return next(value for value in vars(load_model_file(file)).values() if isinstance(value, gb.Model))


def relative_difference(values: Mapping[str, float], others: Mapping[str, float]) -> float:
    """The largest relative difference of values of the same names."""
    return max((abs(others[n] - v) / (abs(v) or 1.0) for n, v in values.items()), default=0.0)


def run_in_c(model: gb.Model, record: gb.Experiment, folder: Path) -> float | str:
    """How far the model in C is from the library over the inputs of a record, as a share of the largest output; or why there is none."""
    # A step in C knows the input of now alone.
    if moving := [effect.name for effect in model.effects if effect.hold]:
        return f"not compared, as a step holds its input and {moving[0]} does not"
    dt = float(np.median(np.diff(record.time)))
    time = dt * np.arange(record.rows)
    inputs = np.column_stack([record.inputs[i.name] for i in model.inputs] or [np.zeros(record.rows)])
    signals = {i.name: inputs[:, k] for k, i in enumerate(model.inputs)}
    try:
        # Both with the same step, and one at which a fast mode (a small mass that a fit has found) does not run away.
        for substeps in SUBSTEPS:
            run = gb.simulate(model, {"time": time, **signals}, substeps=substeps)
            if run.overflow is None:
                break
        else:
            return f"not compared, as the run overflows at {run.overflow:.3g} s"
        source, _ = gb.export.to_c(model, folder / "plant.c", dt=dt, substeps=substeps)
    except GreyboxError as error:
        return str(error)
    library = folder / "plant.so"
    command = [*find_compiler().command, "-std=c99", "-O1", "-shared", "-fPIC", "-o", str(library), str(source), "-lm"]
    subprocess.run(command, check=True)
    plant, name = ctypes.CDLL(str(library)), to_identifier(model.name)
    state, shown, given = (
        (ctypes.c_double * PLANT_STATE)(),
        (ctypes.c_double * 8)(),
        (ctypes.c_double * inputs.shape[1])(),
    )
    getattr(plant, f"{name}_start")(state)
    rows = []
    for row in inputs:
        given[:] = list(row)
        getattr(plant, f"{name}_outputs")(state, given, shown)
        rows.append(list(shown)[: len(model.outputs)])
        getattr(plant, f"{name}_step")(state, given)
    there = np.column_stack([run.outputs[o.name] for o in model.outputs])
    return float(np.abs(np.array(rows) - there).max() / np.abs(there).max())


def first_name(line: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """What an answer says first by name: its first effect, or else the most probable claim of a name."""
    named = [c for c in line["claims"] if c["depth"] == Depth.NAME]
    return next(iter(line["effects"]), None) or max(named, key=lambda c: c["probability"], default=None)


def first_family(line: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """The most probable claim of a family."""
    claimed = [c for c in line["claims"] if c["depth"] == Depth.FAMILY]
    return max(claimed, key=lambda c: c["probability"], default=None)


def said(line: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Every statement of an answer below "something is missing": its claims, and the effects of which no claim has the name."""
    claims = [c for c in line["claims"] if c["depth"] > Depth.MISSING]
    # An effect of the answer counts with the grade that the answer gives it, whatever grade its claim has.
    names = {e["name"] for e in line["effects"]}
    others = [c for c in claims if c["depth"] != Depth.NAME or c["name"] not in names]
    return [*others, *({**e, "depth": Depth.NAME} for e in line["effects"])]


def count_claims(lines: Iterable[Mapping[str, Any]]) -> Counter[tuple[int, str, bool | None]]:
    """Statements by depth, grade and whether they are true."""
    return Counter((int(c["depth"]), c["grade"], c["right"]) for line in lines for c in said(line))


def is_same(trip: Mapping[str, Any]) -> bool:
    """Whether the refit leaves the answer's error within 1 % on every record, or the search said that it may not."""
    # That another fit ends elsewhere was said, and not that none begins.
    if trip["status"] == TerminationStatus.NO_START:
        return False
    return bool(trip["said"]) or all(abs(ratio - 1) <= SAME for ratio in trip["ratio"].values())


def write_page(lines: Sequence[Mapping[str, Any]], told: Sequence[Mapping[str, Any]] = (), note: str = "") -> str:
    """The page `measured_certainty.md`.

    ``told`` are the answers of searches that knew the parts of their rigs; ``note`` is a sentence on which state of the program searched.
    """
    ways = {"nothing told": lines, "parts told": told} if told else {"answers": lines}
    columns = [count_answers(each) for each in ways.values()]
    totals = [[what, *cells] for what in columns[0] if set(cells := [c[what] for c in columns]) != {"0 of 0"}]
    counts = [count_claims(each) for each in ways.values()]
    by_grade = {
        grade: [
            [name, *(str(c[depth, grade, truth]) for c in counts for truth in WORDS)] for depth, name in DEPTHS.items()
        ]
        for grade in GRADES
    }
    heads = ["depth", *(f"{way}: {word}" for way in ways for word in WORDS.values())]
    rigs = list(dict.fromkeys(line["rig"] for line in (*lines, *told)))
    return "\n".join(
        [
            HEAD.format(
                searches=" and ".join(f"{len(each)} of {len(SEARCHES)}" for each in ways.values()),
                rigs=len(rigs),
                note=note,
            ),
            markdown(["what", *ways], totals),
            *(f"\n## {grade.capitalize()}, by depth\n\n{markdown(heads, rows)}" for grade, rows in by_grade.items()),
            "\n## By rig\n",
            BY_RIG,
            *(part for way, each in ways.items() for part in (f"{way.capitalize()}:\n", tabulate_rigs(each, rigs), "")),
        ]
    )


def count_answers(lines: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """How many answers are right, in words."""
    listed = [line for line in lines if RIGS[line["rig"]].is_in_catalogue]
    lacking = [line for line in lines if RIGS[line["rig"]].facts]
    null = [line for line in lines if not RIGS[line["rig"]].facts]
    certain = [c for line in lines for c in said(line) if c["grade"] == "established" and c["right"] is not None]
    asked = [line["question"] for line in listed if line.get("question")]
    tripped = [line["round_trip"] for line in lines if line["round_trip"]]
    established = [any(c["right"] and c["grade"] == "established" for c in said(line)) for line in lacking]
    seconds = np.array([line["seconds"] for line in lines])
    return {
        "right name first, where the catalogue holds it": count(first_name(line) for line in listed),
        "right name anywhere in the answer": (
            f"{sum(any(e['right'] for e in line['effects']) for line in listed)} of {len(listed)}"
        ),
        "right family first, where the catalogue holds it": count(first_family(line) for line in listed),
        "something true established (a place or deeper)": f"{sum(established)} of {len(lacking)}",
        "wrong among what is established and can be judged": f"{sum(not c['right'] for c in certain)} of {len(certain)}",
        "answers with something established where nothing may be said (heavy balls, healthy rotor)": (
            f"{sum(any(c['grade'] == 'established' for c in said(line)) for line in null)} of {len(null)}"
        ),
        "round trips with the same error within 1 %, or told": f"{sum(map(is_same, tripped))} of {len(tripped)}",
        "questions about a part whose answer leads to a right name": count(q for q in asked if q["right"] is not None),
        "searches that ended at their time limit": f"{sum(line['out_of_time'] for line in lines)} of {len(lines)}",
        "CPU s: median, 95th of a hundred, most": ", ".join(f"{v:.0f}" for v in np.percentile(seconds, (50, 95, 100))),
    }


def tabulate_rigs(lines: Sequence[Mapping[str, Any]], rigs: Sequence[str]) -> str:
    """What was established of each rig."""
    rows = []
    for rig in rigs:
        here = [line for line in lines if line["rig"] == rig]
        c = count_claims(here)
        cells = ["/".join(str(c[depth, "established", truth]) for truth in WORDS) for depth in DEPTHS]
        names = count(map(first_name, here)) if RIGS[rig].is_in_catalogue else "-"
        middle = f"{np.median([line['seconds'] for line in here]):.0f}" if here else "-"
        rows.append([rig, str(len(here)), names, *cells, middle])
    return markdown(["rig", "searches", "right name first", *DEPTHS.values(), "CPU s (median)"], rows)


def count(claims: Iterable[Mapping[str, Any] | None]) -> str:
    """How many of these are right."""
    truths = [claim is not None and claim["right"] is True for claim in claims]
    return f"{sum(truths)} of {len(truths)}"


def tell_effects(line: Mapping[str, Any]) -> str:
    """The effects of an answer with grade and truth."""
    return "; ".join(f"{e['name']} ({e['grade']}, {WORDS[e['right']]})" for e in line["effects"]) or "none"


def tell_deepest(line: Mapping[str, Any]) -> str:
    """The deepest established claims."""
    certain = [c for c in said(line) if c["grade"] == "established"]
    deepest = [c for c in certain if c["depth"] == max(d["depth"] for d in certain)]
    return "; ".join(
        f"{c['name'] or ', '.join(c.get('family', ())[:2]) or ', '.join(c.get('variables', ())) or c['site']} ({WORDS[c['right']]})"
        for c in deepest
    )


HEAD = """# Certainty on measured records

How often what `greybox discover` calls certain is true on measured records of {rigs} public rigs: with nothing told but the plain model,
and where the parts of the rig are told (`has`, `lacks`); {searches} searches, each with one record to learn from, one to choose by and a
third to be judged on.{note} Written by
`python -m fits.studies.measured_certainty FOLDER --page docs/studies/measured_certainty.md`; `fits.studies.measured_rigs` says whose the
records are and what is known of each rig. All rigs were looked at while the method was built: this is no blind test. [What these records
taught](../measured_lessons.md).

- Known by construction, weighing or publication: balls, rotor (braked at known times, or healthy), pendulum, heaters, damper. What is
  claimed of the others beside the known facts is *not known*.
- On a heavy ball and on the healthy rotor every claim counts as wrong, though the scale of the video does bend.
- *Right* is a place where something known acts; a variable on which it depends there; a family with a right name in it; a right name.
- In a round trip the model that is handed over is written, read back, fitted to the same records, and run in C.
"""
BY_RIG = "What was established at each depth: right/wrong/not known.\n"


def name_file(case: Case) -> str:
    """The file of a search."""
    return to_identifier(f"{case.rig} {case.learn} {case.choose}") + ".json"


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the searches that are not done yet, or write the page of those that are."""
    parser = argparse.ArgumentParser(description="Is what is certain on measured records true there?")
    parser.add_argument("folder", type=Path, help="folder of the rigs' records")
    parser.add_argument(
        "--output", type=Path, default=Path("results/measured_certainty"), help="a file for each search"
    )
    parser.add_argument(
        "--limit", type=float, default=LIMIT, help="seconds after which a search begins no further refit"
    )
    parser.add_argument("--told", action="store_true", help="tell each search which parts its rig has and lacks")
    parser.add_argument("--rig", action="append", choices=list(RIGS), dest="rigs", help="these rigs alone")
    parser.add_argument("--page", type=Path, help="write the page of the searches that are done, and search nothing")
    parser.add_argument(
        "--beside", type=Path, help="for the page: a file for each search that was told the parts of its rig"
    )
    parser.add_argument("--note", default="", help="a sentence for the page on the state of the program that searched")
    given = parser.parse_args(arguments)
    given.output.mkdir(parents=True, exist_ok=True)
    cases = [case for case in SEARCHES if case.rig in (given.rigs or RIGS)]
    # One search of every rig, then a second of each, and so on: where the study is stopped it has seen as much as it can.
    cases.sort(key=lambda case: [other for other in SEARCHES if other.rig == case.rig].index(case))
    if not given.page:
        for rig in dict.fromkeys(case.rig for case in cases):
            if not (given.folder / RIGS[rig].folder).is_dir():
                sys.stderr.write(f"{rig} is skipped: there is no {given.folder / RIGS[rig].folder}\n")
        for case in cases:
            file = given.output / name_file(case)
            if file.exists() or not (given.folder / RIGS[case.rig].folder).is_dir():
                continue
            sys.stderr.write(f"{case.rig}: {case.learn} -> {case.choose}\n")
            file.write_text(json.dumps(study(case, given.folder, given.limit, given.told), indent=1))
    lines = read_answers(given.output)
    if given.page:
        told = read_answers(given.beside) if given.beside else []
        given.page.write_text(write_page(lines, told, given.note and f" {given.note}"), encoding="utf-8")
    for line in lines:
        sys.stdout.write(f"{line['rig']}: {line['verdict']}; {tell_effects(line)}; {tell_deepest(line)}\n")


def read_answers(folder: Path) -> list[dict[str, Any]]:
    """The answers in a folder, rig by rig, judged anew: what is known of a rig may have grown since."""
    files = [folder / name_file(case) for case in SEARCHES]
    lines = [json.loads(file.read_text()) for file in files if file.exists()]
    return [judge_again(line) for line in sorted(lines, key=lambda line: list(RIGS).index(line["rig"]))]


def judge_again(line: Mapping[str, Any]) -> dict[str, Any]:
    """An answer beside what is known of its rig now."""
    rig = RIGS[line["rig"]]
    claims = [{**c, "right": judge_claim(rig, c)} for c in line["claims"]]
    return {**line, "claims": claims, "effects": [{**e, "right": _judge_name(rig, e["name"])} for e in line["effects"]]}


if __name__ == "__main__":
    main()
