"""How often is the hidden effect named, and what is said where the catalogue does not have it?

    python -m fits.studies.hidden_study FOLDER [--cases 200] [--first 1000] [--rows 1200] [--workers 1] [--cluster ADDRESS] [--page]

Every other case is on one of two rigs (`fits.studies.hidden_cases`), the others on six everyday plants
(`fits.studies.plant_cases`); all are simulated
without greybox. Each case is answered twice: with every effect of the catalogue among the candidates, and with the true effects and
their families taken away. Every case leaves FOLDER/NNNNN.json, so the study goes on where it was stopped.

``--page`` writes docs/studies/discovery_study.md with its figures from what FOLDER holds, bad results
included.
``--calibrate variables`` (or another depth) fits the map from the weight of such a claim to its probability to what FOLDER holds: the
page on claims must then come from another draw.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import greybox as gb
from fits.studies.hidden_baselines import by_correlation, by_sparse_regression
from fits.studies.hidden_cases import Case, make
from fits.studies.hidden_claims import calibrate, describe_claims, write_claims
from fits.studies.hidden_page import VISIBLE, write
from fits.studies.plant_cases import make as make_plant
from greybox.base.files import write_file
from greybox.base.json_shape import to_values
from greybox.base.parallel.jobs import JobResult, open_workers, run_jobs
from greybox.discovery import claims
from greybox.discovery.candidates import estimate_scales, family_of
from greybox.discovery.problem import DiscoveryProblem
from greybox.discovery.result import Discovery
from greybox.model.effects.catalogue import CATALOGUE, find_placements
from greybox.model.effects.scales import Scales, tailor_to_record
from greybox.shell.project import find_model

# Kinds of twenty cases in a row: odd seeds are on the rigs, even ones on the plants.
KINDS = (
    *("single", "single", "foreign", "pair", "single", "single", "pair", "complete", "mixed", "mixed"),
    *("complete", "relative", "single", "foreign", "relative", "single", "foreign", "single", "single", "mixed"),
)
RIGS = ("micro_actuator", "pneumatic_cylinder")
CASES, FIRST, ROWS, LONG = 200, 1000, 1200, 3000
TIME_LIMIT = 600.0  # s of a search: `greybox discover --time 600`
EVERY_LONG = 11  # one of so many cases has LONG rows


def study(folder: Path, cases: int, first: int, rows: int, workers: int = 1, cluster: str = "") -> None:
    """Every case that FOLDER does not have yet: here one after the other, in worker processes or on a cluster."""
    open_cases = [(seed, rows) for seed in range(first, first + cases) if not (folder / f"{seed:05d}.json").exists()]

    def receive(number: int, result: JobResult) -> None:
        seed, _ = open_cases[number]
        answer = _failed(_make_case(seed, rows), result.error) if result.error else result.value
        if answer is not None:
            write_file(folder / f"{seed:05d}.json", json.dumps(answer, indent=1) + "\n")

    with open_workers(workers, cluster) as executor:
        run_jobs(_answer_seed, None, open_cases, executor=executor, workers=workers, receive=receive)


def _answer_seed(_: None, item: tuple[int, int]) -> dict[str, Any] | None:
    """The row of one case; None where the plant flies apart."""
    try:
        case = _make_case(*item)
    except OverflowError:  # drawn so strong: no case
        return None
    try:
        return answer_case(case)
    except gb.GreyboxError as error:  # a defect, which the page has to show
        return _failed(case, error)


def _make_case(seed: int, rows: int) -> Case:
    kind, length = KINDS[seed % len(KINDS)], LONG if seed % EVERY_LONG == 0 else rows
    return make(seed, kind, length) if seed % 2 else make_plant(seed, kind, rows=length)


def answer_case(case: Case) -> dict[str, Any]:
    """What `discover` says to one case with the truth among the candidates and without it, and the baselines, beside the truth."""
    model = find_model(case.model).fix(**case.known).start(**case.start)
    on_rig = case.model in RIGS
    options = gb.FitOptions(at_rest=on_rig)
    right = {name for names in case.right for name in names}
    listed = {name.partition("_at_")[0] for name in right} & {e.name for e in CATALOGUE}
    family = sorted({relative for name in listed for relative in family_of(name)})
    answers = []
    for without in ((), family) if family else ((),):
        began = time.process_time()
        discovery = gb.discover(
            model,
            case.estimation,
            validation=case.validation,
            noise=case.noise,
            quiet=case.quiet or (),
            without=without,
            options=options,
            workers=1,
            time_limit=TIME_LIMIT,
        )
        answers.append(
            _describe(case, model, discovery, right)
            | {"left_out": bool(without), "seconds": time.process_time() - began}
        )
    placements = find_placements(model, CATALOGUE)
    baselines = {}
    if on_rig:
        baselines = {
            "correlation": by_correlation(discovery.base, model, case),
            "sparse": by_sparse_regression(model, case),
        }
    return (
        _describe_truth(case)
        | {"true_sites": sorted({p.site for p in placements if p.name in right and p.effect is not None})}
        | {"base": max(g.before / case.sigma[o] for o, g in discovery.holdout.items())}
        | {"answers": answers, "each": compare_without_each(case, model), **baselines}
    )


def _describe_truth(case: Case) -> dict[str, Any]:
    return {
        "name": case.name,
        "kind": case.kind,
        "plant": Path(case.model).stem,
        "truth": {name: dict(values) for name, values in case.effects.items()},
        "right": case.right,
        "colour": case.colour,
        "noise_known": case.noise is not None,
    }


def _describe(case: Case, model: gb.Model, discovery: Discovery, right: set[str]) -> dict[str, Any]:
    """One answer: the verdict, its effects with their grades, what is claimed, and the constants beside the true ones."""
    worst = max(discovery.holdout.values(), key=lambda g: g.before / g.floor)
    dependences = [d for d in discovery.localisation.dependences if d.is_relevant]
    surrogate = discovery.surrogate
    return {
        "verdict": str(discovery.verdict),
        "effects": [
            {
                "name": e["name"],
                "site": e["site"],
                "right": e["name"] in right,
                "grade": str(e["grade"]),
                "probability": e["probability"],
            }
            for e in discovery.effects
        ],
        "claims": describe_claims(case, model, discovery.claims),
        "rates": [to_values(rate) for rate in discovery.false_names],
        "said": [e["name"] for e in discovery.effects],
        "alternatives": discovery.alternatives,
        "sites": list(discovery.sites),
        "variables": [d.variable for d in dependences[:1]] + ([surrogate.variable] if surrogate else []),
        "closed": worst.explained_fraction,
        "share": worst.share,
        "curve": surrogate.explained_fraction if surrogate else None,
        "constants": _compare_constants(case, discovery.effects),
    }


def _failed(case: Case, error: gb.GreyboxError | str) -> dict[str, Any]:
    """The row of a case that ended with an error."""
    return _describe_truth(case) | {"error": str(error), "answers": [], "each": [], "true_sites": [], "base": VISIBLE}


def compare_without_each(case: Case, model: gb.Model) -> list[float]:
    """Of two effects, the misfit on the judging record without each, over that with both; the larger ratio of all outputs.

    Below `VISIBLE` nothing could name that one. (Noise of a colour leaves more or less than its level on one record.) Only for effects
    of the catalogue.
    """
    if case.kind != "pair" or any(name not in names for name, names in zip(case.effects, case.right, strict=True)):
        return []
    problem = DiscoveryProblem(model, (case.estimation,), dict(case.sigma), (), gb.FitOptions(at_rest=True))
    scales = estimate_scales(problem.baseline)
    both = _measure_misfit(case, problem, scales, list(case.effects))
    one = [
        _measure_misfit(case, problem, scales, [kept for kept in case.effects if kept != name]) for name in case.effects
    ]
    return [max(left[o] / both[o] for o in both) for left in one]


def _measure_misfit(case: Case, problem: DiscoveryProblem, scales: Scales, names: Sequence[str]) -> dict[str, float]:
    """Rms misfit on the judging record by output, of the model with these effects, fitted from the true constants."""
    model = problem.baseline.model
    for name in names:
        model = model + tailor_to_record(gb.effect(name), scales)
    truth = {n: v for n, v in case.base.items() if n in model.values}
    for bound in model.bound_effects:
        truth |= {bound.model_names[n]: v for n, v in case.effects[bound.effect.name].items()}
    candidate = problem.refit_best(model, [truth, model.values])
    extended = model if candidate is None else candidate.model
    run = gb.validate(extended, case.validation, noise=case.sigma, options=problem.options)
    return {name: m.rmse for name, m in run.misfit.items()}


def _compare_constants(case: Case, effects: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Estimate, standard deviation and truth of every constant of the effects that were named rightly."""
    return [
        {"effect": e["name"], "name": q, "truth": case.effects[e["name"]][q], **c}
        for e in effects
        if e["name"] in case.effects
        for q, c in e["parameters"].items()
        if q in case.effects[e["name"]]
    ]


def read(folder: Path) -> list[dict[str, Any]]:
    """The rows of a folder."""
    return [json.loads(file.read_text(encoding="utf-8")) for file in sorted(folder.glob("*.json"))]


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("folder", type=Path)
    arguments.add_argument("--cases", type=int, default=CASES)
    arguments.add_argument("--first", type=int, default=FIRST)
    arguments.add_argument("--rows", type=int, default=ROWS)
    depths = {depth.name.lower(): depth for depth in claims.Depth}
    arguments.add_argument(
        "--calibrate", nargs="+", choices=depths, help="fit the map of these claims to what the folder holds"
    )
    arguments.add_argument("--page", action="store_true", help="write the pages from what the folder holds")
    arguments.add_argument("--note", default="", help="a sentence for the page on what its rates are of")
    arguments.add_argument("--workers", type=int, default=1, help="processes; 0: one for each core")
    arguments.add_argument("--cluster", default="", help="address of a Dask scheduler, or local")
    chosen = arguments.parse_args()
    chosen.folder.mkdir(parents=True, exist_ok=True)
    if chosen.calibrate:
        file = Path(claims.__file__).parent / "certainty.json"
        calibrate(read(chosen.folder), file, [depths[name] for name in chosen.calibrate])
        return
    if not chosen.page:
        study(chosen.folder, chosen.cases, chosen.first, chosen.rows, chosen.workers, chosen.cluster)
        return
    rows, docs = read(chosen.folder), Path(__file__).resolve().parents[2] / "docs" / "studies"
    write(rows, docs, chosen.rows, chosen.note)
    write_claims(rows, docs)


if __name__ == "__main__":
    main()
