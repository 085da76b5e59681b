"""How probable is a claim of `greybox.discover`? The map from its weight to a probability, and how far that map can be trusted.

Every claim of every answer of `fits.studies.hidden_study` is one observation: how often it won when the records
were drawn again, what was left
and whether it is true. ``calibrate`` fits four numbers a depth to one draw of cases and writes them to the library
(``greybox/discovery/certainty.json``); ``write_claims`` judges the numbers of the library on the answers of another draw, at the end
of ``discovery_study.md``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy.optimize import minimize
from scipy.special import expit

import greybox as gb
from fits.studies.hidden_cases import Case
from greybox.base.errors import ModelError
from greybox.base.json_shape import to_values
from greybox.discovery.claims import ESTABLISHED_FROM, Claim, Depth, EffectForm, Features, describe_effect, to_features
from greybox.discovery.decision import Grade
from greybox.model.effects.catalogue import all_effects

RIDGE = 0.3  # inverse variance of the prior of each number
# What wins more often is likelier, however few rare winners a draw has seen.
LEAST_SLOPE = 0.2
# Where the draw says nothing: about even odds at half of the resamples, doubt from what is left and of sensors.
PRIOR = (-0.5, 0.8, -1.0, -1.0)
BINS = (0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 1.01)
Row = Mapping[str, Any]
# What no entry of the catalogue comes near: an effect that acts at the same place, and of the same variables.
ACTS_AS = {
    "power_damping": "coulomb_friction",
    "resting_friction": "coulomb_friction",
    "magnet": "cubic_stiffness",
    "ishlinskii_spring": "cubic_stiffness",
    "coarse_drive": "input_dead_zone",
    "sensor_on_change": "backlash",
}


def true_forms(case: Case, model: gb.Model) -> list[EffectForm] | None:
    """What is true at each depth, one form for each right name of each effect; None where the place of a stranger is not known."""
    known = {e.name for e in all_effects()}
    forms = []
    for name, names in zip(case.effects, case.right, strict=True):
        listed = [n for n in names if n.partition("_at_")[0] in known]
        stands = [] if listed else [ACTS_AS.get(name, "")]
        if stands == [""]:
            return None
        for n in (*listed, *stands):
            try:
                extended = model + gb.effect(n)
            except ModelError:
                continue
            form = describe_effect(extended, extended.bound_effects[-1])
            forms.append(form if listed else EffectForm("", form.site, form.variables, form.form, ()))
    return forms or (None if case.effects else [])


def is_right(claim: Claim, forms: Sequence[EffectForm] | None) -> bool | None:
    """Whether a claim is true; None where nobody knows."""
    if forms is None:
        return None
    if claim.depth is Depth.MISSING:
        return bool(forms)
    here = [f for f in forms if f.site in claim.sites]
    if claim.depth is Depth.VARIABLES:
        here = [f for f in here if set(f.variables) & set(claim.variables) or not (f.variables or claim.variables)]
    if claim.depth is Depth.FAMILY:
        here = [f for f in here if f.name and f.name.partition("_at_")[0] in claim.family]
    if claim.depth is Depth.NAME:
        here = [f for f in here if f.name == claim.name]
    return bool(here)


def describe_claims(case: Case, model: gb.Model, claims: Sequence[Claim]) -> list[dict[str, Any]]:
    """The claims of an answer beside the truth."""
    forms = true_forms(case, model)
    return [
        {
            **to_values(claim),
            "frequency": claim.frequency,
            "left": claim.left,
            "right": is_right(claim, forms),
        }
        for claim in claims
    ]


def list_claims(rows: Sequence[Row], depth: Depth) -> list[dict[str, Any]]:
    """Every claim of this depth whose truth is known."""
    return [
        {**claim, "case": row["name"], "plant": row["plant"], "left_out": answer["left_out"]}
        for row in rows
        for answer in row["answers"]
        for claim in answer["claims"]
        if claim["depth"] == depth and claim["right"] is not None
    ]


def _features(claim: Row) -> Features:
    """What the probability of a claim is computed from."""
    sites = tuple(claim["site"].split(" or ")) if claim["site"] else ()
    made = Claim(Depth(claim["depth"]), claim["output"], sites, form=claim["form"], share=claim["share"])
    return to_features(replace(made, frequency=claim["frequency"], left=claim["left"]))


def fit_map(claims: Sequence[Row]) -> np.ndarray:
    """Intercept and slopes (4,) of a logistic regression, drawn towards `PRIOR` where the claims say nothing."""
    x = np.array([(1.0, *_features(c)) for c in claims]).reshape(len(claims), len(PRIOR))
    right, prior = np.array([c["right"] for c in claims], float), np.array(PRIOR)

    def cost(w: np.ndarray) -> tuple[float, np.ndarray]:
        """Minus the logarithm of the posterior, and its gradient."""
        score, distance = x @ w, w - prior
        value = np.sum(np.logaddexp(0, score) - right * score) + 0.5 * RIDGE * distance @ distance
        return float(value), x.T @ (expit(score) - right) + RIDGE * distance

    # More resamples for it, less that is left, a place in the plant never speak against a claim.
    bounds = [(None, None), (LEAST_SLOPE, None), (None, 0.0), (None, 0.0)]
    return np.asarray(minimize(cost, prior, jac=True, method="L-BFGS-B", bounds=bounds).x)


def calibrate(rows: Sequence[Row], file: Path, depths: Sequence[Depth]) -> None:
    """Fit the map of some depths to one draw of cases and write it to ``file``, with the cases that each has seen."""
    data = json.loads(file.read_text(encoding="utf-8"))
    for depth in depths:
        data["depths"][str(int(depth))] = {
            "constants": [round(float(v), 3) for v in fit_map(list_claims(rows, depth))],
            "cases": [rows[0]["name"], rows[-1]["name"]],
            "answers": sum(len(row["answers"]) for row in rows),
        }
    file.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")


TITLES = {
    Depth.MISSING: "something is missing",
    Depth.PLACE: "where",
    Depth.VARIABLES: "of which variables",
    Depth.FAMILY: "which family",
    Depth.NAME: "which effect",
}


def write_claims(rows: Sequence[Row], docs: Path) -> None:
    """The last part of ``discovery_study.md`` and ``figures/claims.svg`` in ``docs``, from cases that the map has not seen."""
    (docs / "figures").mkdir(parents=True, exist_ok=True)
    _figure(rows).savefig(docs / "figures" / "claims.svg", metadata={"Date": None})
    plants = sorted({row["plant"] for row in rows})
    without = sum(answer["left_out"] for row in rows for answer in row["answers"])
    text = [
        "## How certain is an established claim?",
        f"The probability of each claim, held against the truth on {len(rows)} cases"
        f" ({rows[0]['name']} to {rows[-1]['name']}, {sum(len(r['answers']) for r in rows)} answers, {without} of them without the truth,"
        f" on {len(plants)} plants); the map from weight to probability was fitted to another draw."
        f" A claim is established from {ESTABLISHED_FROM:g} on.",
        _depth_table(rows),
        "By stated probability, the share that is right and of how many claims:",
        _reliability_table(rows),
        "![Stated probability against observed frequency, by depth](figures/claims.svg)",
    ]
    with (docs / "discovery_study.md").open("a", encoding="utf-8") as page:
        page.write("\n" + "\n\n".join(text) + "\n")


def state(claims: Sequence[Row]) -> tuple[np.ndarray, np.ndarray]:
    """Stated probabilities (N,) of claims, and whether they are right (N,)."""
    return np.array([c["probability"] for c in claims]), np.array([c["right"] for c in claims], float)


def _depth_table(rows: Sequence[Row]) -> str:
    lines = ["| claim | made | Brier score | established | of these wrong |", "|---|---|---|---|---|"]
    for d in Depth:
        claims = list_claims(rows, d)
        stated, right = state(claims)
        brier = f"{np.mean((stated - right) ** 2):.3f}" if claims else "-"
        sure = [c for c in claims if c["grade"] == Grade.ESTABLISHED]
        wrong = sum(not c["right"] for c in sure)
        lines.append(f"| {TITLES[d]} | {len(claims)} | {brier} | {len(sure)} | {wrong} |")
    return "\n".join(lines)


def _reliability_table(rows: Sequence[Row]) -> str:
    depths = [d for d in Depth if d]
    claims = [state(list_claims(rows, d)) for d in depths]
    lines = [f"| stated | {' | '.join(TITLES[d] for d in depths)} |", "|---" * (1 + len(depths)) + "|"]
    for low, high in pairwise(BINS):
        inside = [right[(stated >= low) & (stated < high)] for stated, right in claims]
        if any(right.size for right in inside):
            cells = (f"{right.mean():.2f} of {right.size}" if right.size else "-" for right in inside)
            lines.append(f"| {low:g} to {min(high, 1):g} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _figure(rows: Sequence[Row]) -> Figure:
    figure = Figure(figsize=(5.0, 4.5), layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.subplots()
    axis.plot([0, 1], [0, 1], color="0.7")
    for d in Depth:
        stated, right = state(list_claims(rows, d) if d else ())
        places = [
            (stated[k].mean(), right[k].mean(), k.sum())
            for low, high in pairwise(BINS)
            if (k := (stated >= low) & (stated < high)).any()
        ]
        if places:
            x, y, count = map(np.array, zip(*places, strict=True))
            axis.scatter(x, y, s=(3 + count**0.5) ** 2, label=TITLES[d])
    axis.legend(loc="lower right")
    axis.set_xlabel("stated probability")
    axis.set_ylabel("share that is right")
    return figure
