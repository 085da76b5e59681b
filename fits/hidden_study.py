"""How often is the hidden effect named? Cases that the program was not tuned to, each answered by `greybox.discover` and two baselines.

    python -m fits.hidden_study FOLDER [--cases 200] [--first 1000] [--rows 1200] [--workers 1] [--cluster ADDRESS] [--page]

Six of ten cases hide one effect, one each two effects, none, one that the catalogue does not have, and a relative of one whose form
differs (`fits.hidden_cases`, simulated without greybox). Every case leaves FOLDER/NNNN.json, so the study goes on where it was
stopped. ``--page`` writes docs/discovery_study.md and its figure from what FOLDER holds, bad results included.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import greybox as gb
from fits.hidden_baselines import by_correlation, by_sparse_regression
from fits.hidden_cases import Case, make
from fits.hidden_page import VISIBLE, write
from greybox.discovery.problem import DiscoveryProblem
from greybox.discovery.starting_points import estimate_scales
from greybox.effects import Scales, tailor_to_record
from greybox.files import write_file
from greybox.parallel import JobResult, open_workers, run_jobs
from greybox.project import find_model

# Kinds of ten cases in a row.
KINDS = ("single", "single", "pair", "single", "complete", "single", "relative", "single", "outside", "single")
CASES, FIRST, ROWS = 200, 1000, 1200


def study(folder: Path, cases: int, first: int, rows: int, workers: int = 1, cluster: str = "") -> None:
    """Every case that FOLDER does not have yet: here one after the other, in worker processes or on a cluster."""
    open_cases = [(seed, rows) for seed in range(first, first + cases) if not (folder / f"{seed:04d}.json").exists()]

    def receive(number: int, result: JobResult) -> None:
        seed, _ = open_cases[number]
        answer = failed(_make_case(seed, rows), result.error) if result.error else result.value
        if answer is not None:
            write_file(folder / f"{seed:04d}.json", json.dumps(answer, indent=1) + "\n")

    with open_workers(workers, cluster) as executor:
        run_jobs(_answer, None, open_cases, executor=executor, workers=workers, receive=receive)


def _answer(_: None, item: tuple[int, int]) -> dict[str, Any] | None:
    """The row of one case; None where the rig flies apart."""
    try:
        case = _make_case(*item)
    except OverflowError:  # drawn so strong: no case
        return None
    try:
        return answered(case)
    except gb.GreyboxError as error:  # a defect, which the page has to show
        return failed(case, error)


def _make_case(seed: int, rows: int) -> Case:
    return make(seed, KINDS[seed % len(KINDS)], rows)


def answered(case: Case) -> dict[str, Any]:
    """What `discover` and the baselines say to one case, beside the truth."""
    model = find_model(case.model).fix(**case.known).start(**case.start)
    options = gb.FitOptions(at_rest=True)
    began = time.process_time()
    discovery = gb.discover(
        model, case.estimation, validation=case.validation, noise=case.noise, quiet=case.quiet or (), options=options
    )
    seconds = time.process_time() - began
    worst = max(discovery.holdout.values(), key=lambda g: g.before / g.floor)
    return hidden(case) | {
        "verdict": discovery.verdict,
        "said": [e["name"] for e in discovery.effects],
        "alternatives": discovery.alternatives,
        "sites": list(discovery.sites),
        "base": max(g.before / case.sigma[o] for o, g in discovery.holdout.items()),
        "closed": worst.explained_fraction,
        "curve": discovery.surrogate.explained_fraction if discovery.surrogate else None,
        "constants": _constants(case, discovery.effects),
        "seconds": seconds,
        "correlation": by_correlation(discovery.base, model, case),
        "sparse": by_sparse_regression(model, case),
        "each": without_each(case, model),
    }


def hidden(case: Case) -> dict[str, Any]:
    """What is true of a case."""
    truth = {name: dict(values) for name, values in case.effects.items()}
    return {
        "name": case.name,
        "kind": case.kind,
        "rig": case.model,
        "truth": truth,
        "right": case.right,
        "colour": case.colour,
    }


def failed(case: Case, error: gb.GreyboxError | str) -> dict[str, Any]:
    """The row of a case that ended with an error."""
    nothing: dict[str, Any] = {"said": [], "alternatives": [], "sites": [], "constants": [], "each": []}
    return (
        hidden(case)
        | nothing
        | {
            "verdict": f"error: {error}",
            "base": VISIBLE,
            "closed": 0.0,
            "curve": None,
            "seconds": 0.0,
            "correlation": "",
            "sparse": "",
        }
    )


def without_each(case: Case, model: gb.Model) -> list[float]:
    """Of two effects, the misfit on the judging record without each, over that with both; the larger ratio of all outputs.

    Below `VISIBLE` nothing could name that one. (Noise of a colour leaves more or less than its level on one record.)
    """
    if len(case.effects) < 2:
        return []
    problem = DiscoveryProblem(model, (case.estimation,), dict(case.sigma), (), gb.FitOptions(at_rest=True))
    scales = estimate_scales(problem.baseline)
    both = _misfit(case, problem, scales, list(case.effects))
    one = [_misfit(case, problem, scales, [kept for kept in case.effects if kept != name]) for name in case.effects]
    return [max(left[o] / both[o] for o in both) for left in one]


def _misfit(case: Case, problem: DiscoveryProblem, scales: Scales, names: Sequence[str]) -> dict[str, float]:
    """Rms misfit on the judging record by output, of the model with these effects, fitted from the true constants."""
    model = problem.baseline.model
    for name in names:
        model = model + tailor_to_record(gb.effect(name), scales)
    truth = {n: v for n, v in case.base.items() if n in model.values}
    for bound in model.bound_effects:
        truth |= {bound.model_names[n]: v for n, v in case.effects[bound.effect.name].items()}
    candidate = problem.refit_best(model, [truth, model.values])
    extended = model if candidate is None else candidate.model
    seen = gb.validate(extended, case.validation, noise=case.sigma, options=problem.options)
    return {name: m.rmse for name, m in seen.misfit.items()}


def _constants(case: Case, effects: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Estimate, standard deviation and truth of every constant of the effects that were named rightly."""
    return [
        {"effect": e["name"], "name": q, "truth": case.effects[e["name"]][q], **c}
        for e in effects
        if e["name"] in case.effects
        for q, c in e["parameters"].items()
        if q in case.effects[e["name"]]
    ]


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("folder", type=Path)
    arguments.add_argument("--cases", type=int, default=CASES)
    arguments.add_argument("--first", type=int, default=FIRST)
    arguments.add_argument("--rows", type=int, default=ROWS)
    arguments.add_argument("--page", action="store_true", help="write the page from what the folder holds")
    arguments.add_argument("--workers", type=int, default=1, help="processes; 0: one for each core")
    arguments.add_argument("--cluster", default="", help="address of a Dask scheduler, or local")
    chosen = arguments.parse_args()
    if not chosen.page:
        study(chosen.folder, chosen.cases, chosen.first, chosen.rows, chosen.workers, chosen.cluster)
    rows = [json.loads(file.read_text(encoding="utf-8")) for file in sorted(chosen.folder.glob("*.json"))]
    write(rows, Path(__file__).resolve().parents[1] / "docs", chosen.rows)


if __name__ == "__main__":
    main()
