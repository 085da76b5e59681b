"""How probable is an effect that `greybox.discover` puts into a model? Cases with the truth among the candidates, and without it.

    python -m fits.hidden_certainty FOLDER [--cases 200] [--first 5000] [--rows 1200] [--page]

Every case is answered twice: with every effect of the catalogue as a candidate, and with the true effects and their families taken away;
cases whose truth no entry of the catalogue comes near are answered once. Both rigs (`fits.hidden_cases`) and six other plants
(`fits.plant_cases`). Each answer leaves FOLDER/NNNN.json, so the study goes on where it was stopped.

``--page`` fits the weights of `greybox.discovery.CertaintyPolicy` to what FOLDER holds (a logistic regression; the reliability is that
of cases that were left out of the fit) and writes docs/certainty.md with the reliability diagram.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import greybox as gb
from fits.hidden_cases import Case, make
from fits.plant_cases import make as make_plant
from greybox.discovery import CertaintyPolicy, family_of
from greybox.discovery.certainty import probability_of, to_features
from greybox.project import find_model

# Kinds of ten cases in a row; every other case is on one of the six plants, which lack some kinds.
SOURCES = ("single", "foreign", "pair", "single", "single", "outside", "foreign", "relative", "single", "single")
PLANT_KINDS = ("single", "pair", "foreign")
RIGS = ("micro_actuator", "pneumatic_cylinder")
CASES, FIRST, ROWS, LONG = 200, 5000, 1200, 3000
RIDGE = 1.0  # inverse variance of the prior of each weight
FOLDS, BINS = 10, 10
Row = Mapping[str, Any]


def study(folder: Path, cases: int, first: int, rows: int) -> None:
    """Every case that FOLDER does not have yet, one after the other."""
    folder.mkdir(parents=True, exist_ok=True)
    for seed in range(first, first + cases):
        file = folder / f"{seed:05d}.json"
        if file.exists():
            continue
        source = SOURCES[seed % len(SOURCES)]
        length = LONG if seed % 7 == 0 else rows
        try:
            if seed % 2:
                case = make(seed, source, length)
                answers = _answer(case, case.model, case.right)
            else:
                case = make_plant(seed, source if source in PLANT_KINDS else "single", rows=length)
                answers = _answer(case, Path(case.model).stem, case.right)
        except OverflowError:  # drawn so strong that the rig flies apart: no case
            answers = []
        except gb.errors.GreyboxError as error:  # a defect, which the folder has to show
            answers = [{"case": str(seed), "effect": "", "verdict": f"error: {error}"}]
        part = file.with_suffix(".part")
        part.write_text(json.dumps(answers, indent=1) + "\n", encoding="utf-8")
        part.rename(file)


def _answer(case: Case, plant: str, right: Sequence[Sequence[str]]) -> list[Row]:
    model = find_model(case.model).fix(**case.known).start(**case.start)
    shared = {"validation": case.validation, "noise": case.noise, "quiet": case.quiet or ()}
    identity = {"case": case.name, "source": case.kind, "plant": plant, "truth": sorted(case.effects)}
    names = {name for each in right for name in each}
    return _answer_twice(identity, model, case.estimation, shared, names, at_rest=plant in RIGS)


def _answer_twice(
    identity: Mapping[str, Any],
    model: gb.Model,
    estimation: gb.Experiment,
    shared: Mapping[str, Any],
    right: set[str],
    at_rest: bool,
) -> list[Row]:
    """One row for each effect of each answer; an answer without an effect is a row without one."""
    catalogue = {e.name for e in gb.effects.CATALOGUE}
    listed = {name.partition("_at_")[0] for name in right} & catalogue
    family = sorted({relative for name in listed for relative in family_of(name)})
    options = gb.FitOptions(at_rest=at_rest)
    rows: list[Row] = []
    for without in ((), family) if family else ((),):
        began = time.process_time()
        found = gb.discover(model, estimation, without=without, options=options, workers=1, **shared)
        answer = {
            **identity,
            "left_out": bool(without),
            "verdict": found.verdict,
            "noise_known": shared["noise"] is not None,
            "seconds": time.process_time() - began,
        }
        rows += [
            {
                **answer,
                "effect": e.effect,
                "right": e.effect in right,
                "probability": e.probability,
                "grade": e.grade,
                "measures": {n: v if math.isfinite(v) else None for n, v in e.measures.items()},
            }
            for e in found.evidence
        ] or [{**answer, "effect": ""}]
    return rows


def read(folder: Path) -> list[Row]:
    """All rows with an effect."""
    rows = [row for file in sorted(folder.glob("*.json")) for row in json.loads(file.read_text(encoding="utf-8"))]
    return [row for row in rows if row["effect"]]


def features_of(row: Row, policy: CertaintyPolicy) -> dict[str, float]:
    """The features of a row as the library computes them."""
    infinite = {"loss": 1e300, "loss_t": 1e300, "rival_loss": 1e300, "rival_t": 1e300}
    measures = {n: infinite.get(n, math.nan) if v is None else v for n, v in row["measures"].items()}
    return to_features(measures, policy)


def fit_weights(features: np.ndarray, right: np.ndarray, mean: np.ndarray, ridge: float = RIDGE) -> np.ndarray:
    """Intercept and weights (1 + n,) of a logistic regression by Newton's method.

    A normal prior about ``mean``, the weights of the library, keeps what the cases do not decide.
    """
    x = np.column_stack([np.ones(len(features)), features])
    prior = np.full(x.shape[1], ridge)
    w = mean.copy()
    for _ in range(50):
        p = 1 / (1 + np.exp(-np.clip(x @ w, -30, 30)))
        gradient = x.T @ (p - right) + prior * (w - mean)
        w = w - np.linalg.solve((x * (p * (1 - p))[:, None]).T @ x + np.diag(prior), gradient)
    return w


def _library_weights(policy: CertaintyPolicy) -> np.ndarray:
    return np.array([policy.intercept, *policy.weights.values()])


def cross_validate(rows: Sequence[Row], policy: CertaintyPolicy) -> np.ndarray:
    """The probability (N,) of each row from weights fitted without its case."""
    names = list(policy.weights)
    features = np.array([[features_of(r, policy)[n] for n in names] for r in rows])
    right = np.array([r["right"] for r in rows], float)
    cases = sorted({r["case"] for r in rows})
    fold = np.array([cases.index(r["case"]) % FOLDS for r in rows])
    result = np.zeros(len(rows))
    for k in range(FOLDS):
        w = fit_weights(features[fold != k], right[fold != k], _library_weights(policy))
        result[fold == k] = 1 / (1 + np.exp(-(w[0] + features[fold == k] @ w[1:])))
    return result


def write_page(folder: Path, docs: Path) -> None:
    """Weights to the terminal; page and figure to ``docs``."""
    rows, policy = read(folder), CertaintyPolicy()
    names = list(policy.weights)
    features = np.array([[features_of(r, policy)[n] for n in names] for r in rows])
    right = np.array([r["right"] for r in rows], float)
    w = fit_weights(features, right, _library_weights(policy))
    lines = [f"intercept: {w[0]:.2f}", *(f'"{n}": {v:.2f},' for n, v in zip(names, w[1:], strict=True))]
    sys.stdout.write("\n".join(lines) + "\n")
    predicted = cross_validate(rows, policy)
    stated = np.array([probability_of(features_of(r, policy), policy) for r in rows])
    (docs / "figures").mkdir(parents=True, exist_ok=True)
    _figure(predicted, right).savefig(docs / "figures" / "certainty.svg", metadata={"Date": None})
    cases = len({r["case"] for r in rows})
    sure = [r for r, p in zip(rows, predicted, strict=True) if p >= policy.established]
    wrong = sum(not r["right"] for r in sure)
    plants = sorted({r["plant"] for r in rows})
    text = [
        "# How certain is an established effect?",
        f"Each effect of an answer has a probability of being right. Here it is held against the truth: {len(rows)} effects in the answers"
        f" to {cases} simulated cases on {len(plants)} plants ({', '.join(plants)}), most of them answered twice: with the true effect"
        " among the candidates, and with it and its family taken away. The probabilities are those of weights that were fitted without"
        " the case in question. Written by `python -m fits.hidden_certainty FOLDER --page`.",
        _reliability_table(predicted, right),
        "![Predicted probability against observed frequency](figures/certainty.svg)",
        f"Brier score: {np.mean((predicted - right) ** 2):.3f} (with the weights of the library: {np.mean((stated - right) ** 2):.3f}). Of"
        f" {len(sure)} effects with a probability of at least {policy.established:g}, {wrong} are wrong.",
    ]
    (docs / "certainty.md").write_text("\n\n".join(text) + "\n", encoding="utf-8")


def _bins(predicted: np.ndarray) -> np.ndarray:
    return np.minimum((predicted * BINS).astype(int), BINS - 1)


def _reliability_table(predicted: np.ndarray, right: np.ndarray) -> str:
    lines = ["| predicted | effects | mean prediction | right |", "|---|---|---|---|"]
    for k in range(BINS):
        chosen = _bins(predicted) == k
        if chosen.any():
            lines.append(
                f"| {k / BINS:.1f} to {(k + 1) / BINS:.1f} | {chosen.sum()} | {predicted[chosen].mean():.2f} | {right[chosen].mean():.2f} |"
            )
    return "\n".join(lines)


def _figure(predicted: np.ndarray, right: np.ndarray) -> Figure:
    figure = Figure(figsize=(4.5, 4.5), layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.subplots()
    axis.plot([0, 1], [0, 1], color="0.7")
    for k in range(BINS):
        chosen = _bins(predicted) == k
        if chosen.any():
            axis.plot(
                predicted[chosen].mean(), right[chosen].mean(), "o", color="C0", markersize=3 + chosen.sum() ** 0.5
            )
    axis.set_xlabel("predicted probability of being right")
    axis.set_ylabel("share that is right")
    return figure


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("folder", type=Path)
    arguments.add_argument("--cases", type=int, default=CASES)
    arguments.add_argument("--first", type=int, default=FIRST)
    arguments.add_argument("--rows", type=int, default=ROWS)
    arguments.add_argument(
        "--page", action="store_true", help="fit the weights and write the page from what the folder holds"
    )
    chosen = arguments.parse_args()
    if chosen.page:
        write_page(chosen.folder, Path(__file__).resolve().parents[1] / "docs")
    else:
        study(chosen.folder, chosen.cases, chosen.first, chosen.rows)


if __name__ == "__main__":
    main()
