"""Does `discover --laws` write down the term that a system of equations lacks?

By a rule, for each system of `law_systems`: the last nonlinear term of the list is dropped (of a system without one the last term); what is
left is the plain model. SciPy integrates the full system from two first states, one run to learn from, one to judge by, with white noise of
0.01, 1 and 5 % of each state's motion ("0 %" has the noise of five digits; every level is stated as known). The constants of the plain
model start up to 40 % from the truth. No effect of the catalogue is tried.

Right is a law at the right balance that is the dropped term up to algebra: with suitable constants, and as much of the terms that the
plain model has there, it equals the dropped term everywhere in a box of twice the range of the records. Beside it pysindy gets all states
of the same records and the cubic library that holds the truth of most systems, with thresholds chosen on the second record.

``plants``: terms hidden in two rigs and six plants by twins that know nothing of greybox (`fits.studies.law_plants`), catalogue off.

    python -m fits.studies.law_study run STUDY.jsonl [--kind dropped|complete|hidden|pysindy|plants] [--noise 1] [--only NAME]
    python -m fits.studies.law_study report STUDY.jsonl
"""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import time
import warnings
from collections import Counter
from pathlib import Path

import numpy as np
import sympy
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

import greybox as gb
from fits.studies.law_plants import RIGS, TERMS, HiddenTerm, is_family, make_case
from fits.studies.law_systems import SYSTEMS, PublishedSystem
from greybox import Balance, Experiment, Model, Output, Parameter, State
from greybox.model.expressions.text import evaluate_formula
from greybox.shell.project import find_model

CONSTANT = re.compile(r"\{([^}]*)\}")
NOISES = {"0": 1e-4, "1": 0.01, "5": 0.05}
ROWS = 241
SEED = 52001
VISIBLE = 1.1
"""Error of the plain model on the second record, over the noise, from which a term counts as visible."""
UNKNOWN = 0.4
FUNCTIONS = {"log", "sin", "cos", "sqrt", "abs", "exp", "tanh"}


class Statement:
    """A system with names for its constants: ``terms`` by state as text, ``values`` of the constants."""

    def __init__(self, system: PublishedSystem) -> None:
        self.system, self.values = system, {}
        self.terms = {state: [self._name(t) for t in terms] for state, terms in system.equations.items()}
        self.states = list(system.equations)
        self.symbols = {n: sympy.Symbol(n, real=True) for n in (*self.states, *self.values)}

    @property
    def numbers(self) -> dict[sympy.Symbol, float]:
        return {self.symbols[n]: v for n, v in self.values.items()}

    def _name(self, term: str) -> str:
        def name(match: re.Match) -> str:
            key = f"p{len(self.values)}"
            self.values[key] = float(match.group(1))
            return key

        return CONSTANT.sub(name, term)

    def read(self, text: str) -> sympy.Expr:
        return sympy.sympify(text, locals=self.symbols)

    def dropped(self) -> tuple[str, int]:
        """State and number of the term that is dropped."""
        places = [(s, k) for s, terms in self.terms.items() for k in range(len(terms)) if len(terms) > 1]
        return (
            [p for p in places if self._is_nonlinear(*p)][-1:][0]
            if any(self._is_nonlinear(*p) for p in places)
            else places[-1]
        )

    def _is_nonlinear(self, state: str, k: int) -> bool:
        term = self.read(self.terms[state][k])
        return any(
            sympy.simplify(sympy.diff(term, self.symbols[a], self.symbols[b])) != 0
            for a in self.states
            for b in self.states
        )


def simulate(statement: Statement, start: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    rates = [sympy.Add(*map(statement.read, statement.terms[s])).subs(statement.numbers) for s in statement.states]
    function = sympy.lambdify([statement.symbols[s] for s in statement.states], rates, "numpy")
    t = np.linspace(0, statement.system.duration, ROWS)
    run = solve_ivp(lambda _, x: function(*x), (0, t[-1]), start, method="DOP853", t_eval=t, rtol=1e-10, atol=1e-12)
    return t, run.y.T


def make_records(
    statement: Statement, noise: float, seed: int
) -> tuple[list[Experiment], dict[str, float], list[np.ndarray]]:
    generator = np.random.default_rng(seed)
    runs = [simulate(statement, start) for start in statement.system.starts]
    std = noise * np.std(np.concatenate([y for _, y in runs]), axis=0)
    records = []
    for name, (t, y) in zip(("learn", "judge"), runs, strict=True):
        read = y + std * generator.normal(size=y.shape)
        records.append(Experiment(name, t, {}, dict(zip(statement.states, read.T, strict=True))))
    return records, dict(zip(statement.states, std.tolist(), strict=True)), [y for _, y in runs]


class _Named(dict):
    @property
    def names(self) -> list[str]:
        return list(self)


def make_model(statement: Statement, without: tuple[str, int] | None, seed: int, measured: list[str]) -> Model:
    """The system as a model without roles and units; constants up to 40 % off."""
    generator = np.random.default_rng(seed)
    kept = {s: [t for k, t in enumerate(terms) if (s, k) != without] for s, terms in statement.terms.items()}
    used = {n for terms in kept.values() for t in terms for n in re.findall(r"\bp\d+\b", t)}
    parameters = [
        Parameter(
            n, "1/s" if _is_amplitude(n, kept) else "1", v * generator.uniform(1 - UNKNOWN, 1 + UNKNOWN), (1e-4, 1e3)
        )
        for n, v in statement.values.items()
        if n in used
    ]
    one = Parameter("unit_rate", "1/s", 1.0, fixed=True)

    def balances(x, u, p):
        values = _Named({s: x[s] for s in statement.states} | {q.name: p[q.name] for q in parameters})

        def rate(term: str):
            value = evaluate_formula("system", term, values)
            return value if re.search(r"\bp\d+\b", term) else p.unit_rate * value

        return [
            Balance(s, "1/s", 1, s, **({f"t{k}": rate(t) for k, t in enumerate(kept[s])} or {"none": 0.0}))
            for s in statement.states
        ]

    return Model(
        statement.system.name,
        states=[State(s, "1", float(statement.system.starts[0][j])) for j, s in enumerate(statement.states)],
        inputs=[],
        outputs=[Output(s, "1") for s in measured],
        parameters=[*parameters, one],
        balances=balances,
    )


def _is_amplitude(name: str, kept: dict[str, list[str]]) -> bool:
    return any(re.match(rf"-?{name}\b", t) for terms in kept.values() for t in terms)


def is_right(statement: Statement, without: tuple[str, int], laws: list[dict], runs: list[np.ndarray]) -> bool:
    """Whether the laws together are the dropped term, with suitable constants."""
    state, k = without
    if not laws or any(law["site"] != state for law in laws):
        return False
    truth = statement.read(statement.terms[state][k]).subs(statement.numbers)
    rest = [statement.read(t).subs(statement.numbers) for j, t in enumerate(statement.terms[state]) if j != k]
    constants, text, start = [], [], []
    for j, law in enumerate(laws):
        if "memory" in law:
            return False
        formula = law["formula"]
        for name, value in law["parameters"].items():
            fresh = f"q{j}_{name}"
            formula = re.sub(rf"\b{name}\b", fresh, formula)
            constants.append(sympy.Symbol(fresh, real=True))
            start.append(value["value"])
        text.append(formula)
    locals_ = statement.symbols | {c.name: c for c in constants}
    law = sympy.sympify(" + ".join(text), locals=locals_)
    everything = np.concatenate(runs)
    low, high = everything.min(axis=0), everything.max(axis=0)
    width = high - low
    box = np.where(low >= 0, np.maximum(low - 0.5 * width, 0.1 * low), low - 0.5 * width), high + 0.5 * width
    points = np.random.default_rng(1).uniform(*box, size=(200, len(low))).T
    states = [statement.symbols[s] for s in statement.states]
    of_law = sympy.lambdify([states, constants], law, "numpy")
    true = np.broadcast_to(sympy.lambdify([states], truth, "numpy")(points), 200)
    others = np.array([np.broadcast_to(sympy.lambdify([states], r, "numpy")(points), 200) for r in rest])

    def left(z: np.ndarray) -> np.ndarray:
        error = true - np.broadcast_to(of_law(points, z), 200)
        if len(others):
            error = error - others.T @ np.linalg.lstsq(others.T, error, rcond=None)[0]
        return error / np.std(true) if np.std(true) > 0 else error / np.abs(true).max()

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            best = least_squares(
                left, start, x_scale=np.maximum(np.abs(start), 1e-3), xtol=1e-14, ftol=1e-14, gtol=1e-14
            )
        except ValueError:  # not finite somewhere in the box: it is another function
            return False
    return bool(np.sqrt(np.mean(best.fun**2)) < 1e-4)


def law_of_text(statement: Statement, site: str, text: str) -> dict:
    """An alternative as a law: its numbers become constants."""
    if "lag(" in text:
        return {"site": site, "formula": text, "parameters": {}, "memory": "1"}
    parameters = {}

    def name(match: re.Match) -> str:
        key = f"n{len(parameters)}"
        parameters[key] = {"value": float(match.group(0))}
        return key

    formula = re.sub(r"(?<![\w*.])(?<!\*\*)\d+\.?\d*(?:e-?\d+)?(?![\w.])", name, text)
    return {"site": site, "formula": formula, "parameters": parameters}


def run_case(system: PublishedSystem, kind: str, level: str) -> dict:
    statement = Statement(system)
    seed = int(hashlib.sha256(f"{system.name} {level}".encode()).hexdigest()[:8], 16)
    records, std, runs = make_records(statement, NOISES[level], seed)
    without = None if kind == "complete" else statement.dropped()
    measured = list(statement.states)
    if kind == "hidden":
        measured = [s for s in measured if s != _hidden(statement)]
        records = [Experiment(r.name, r.time, {}, {s: r.outputs[s] for s in measured}) for r in records]
    model = make_model(statement, without, seed, measured)
    began = time.process_time()
    found = gb.discover(
        model, records[0], validation=records[1], noise={s: std[s] for s in measured}, effects=(), laws=True, workers=1
    )
    seconds = time.process_time() - began
    laws = [e for e in found.effects if "equation" in e]
    case = {
        "system": system.name,
        "kind": kind,
        "noise": level,
        "states": len(statement.states),
        "verdict": str(found.verdict),
        "grade": str(laws[0]["grade"]) if laws else None,
        "laws": [law["equation"] + " @ " + law["site"] for law in laws],
        "alternatives": [list(a) for a in found.alternatives],
        "misfit": found.base.misfit[measured[0]].noise_ratio,
        "cpu": round(seconds, 2),
        "share": min(e.share for e in found.holdout.values()) if laws else 0.0,
    }
    if without is not None:
        case["dropped"] = (
            f"{statement.read(statement.terms[without[0]][without[1]]).subs(statement.numbers)} @ {without[0]}"
        )
        case["right"] = is_right(statement, without, laws, runs)
        site = laws[0]["site"] if laws else ""
        case["in_set"] = case["right"] or any(
            is_right(statement, without, [law_of_text(statement, site, t) for t in a], runs) for a in found.alternatives
        )
    return case


def _hidden(statement: Statement) -> str:
    """The state without a sensor: the last one in whose balance nothing is dropped, and that acts on another one."""
    state = statement.dropped()[0]
    others = [s for s in statement.states if s != state]
    return others[-1]


def is_determined(system: PublishedSystem) -> bool:
    """Whether with one state hidden the full model's dropped term has an amplitude that the record determines to a quarter."""
    statement = Statement(system)
    state, k = statement.dropped()
    name = re.findall(r"\bp\d+\b", statement.terms[state][k])[0]
    records, std, _ = make_records(statement, NOISES["1"], 1)
    measured = [s for s in statement.states if s != _hidden(statement)]
    record = Experiment("learn", records[0].time, {}, {s: records[0].outputs[s] for s in measured})
    model = make_model(statement, None, 1, measured).start(**statement.values)
    fit = gb.fit(model, record, noise={s: std[s] for s in measured})
    estimate = fit.parameters[name]
    return estimate.std is not None and estimate.std < 0.25 * abs(estimate.value)


def run_plant(term: HiddenTerm) -> dict:
    """One plant with a term hidden in it."""
    case = make_case(term, SEED)
    model = find_model(case.model).fix(**case.known).start(**case.start)
    began = time.process_time()
    found = gb.discover(
        model,
        case.estimation,
        validation=case.validation,
        noise=case.sigma,
        effects=(),
        laws=True,
        options=gb.FitOptions(at_rest=term.plant in RIGS),
        workers=1,
    )
    seconds = time.process_time() - began
    laws = [e for e in found.effects if "equation" in e]
    worst = max(found.holdout.values(), key=lambda e: e.before / e.floor)
    return {
        "system": term.name,
        "kind": "plants",
        "noise": "1",
        "verdict": str(found.verdict),
        "grade": str(laws[0]["grade"]) if laws else None,
        "laws": [law["equation"] + " @ " + law["site"] for law in laws],
        "alternatives": [list(a) for a in found.alternatives],
        "misfit": worst.before / worst.floor,
        "after": worst.after / worst.floor,
        "explained": worst.explained_fraction if laws else 0.0,
        "right": is_family(term, case, laws),
        "cpu": round(seconds, 2),
    }


def run_pysindy(system: PublishedSystem, level: str) -> dict:
    import pysindy

    statement = Statement(system)
    seed = int(hashlib.sha256(f"{system.name} {level}".encode()).hexdigest()[:8], 16)
    records, _, runs = make_records(statement, NOISES[level], seed)
    state, _ = statement.dropped()
    column = statement.states.index(state)
    data = [np.column_stack([r.outputs[s] for s in statement.states]) for r in records]
    step = float(records[0].time[1])
    truth = sympy.lambdify(
        [[statement.symbols[s] for s in statement.states]],
        sympy.Add(*map(statement.read, statement.terms[state])).subs(statement.numbers),
        "numpy",
    )
    polynomial = sympy.Add(*map(statement.read, statement.terms[state])).subs(statement.numbers)
    symbols = [statement.symbols[s] for s in statement.states]
    is_polynomial = polynomial.is_polynomial(*symbols) and sympy.Poly(polynomial, *symbols).total_degree() <= 3
    best, score = None, -np.inf
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for threshold in (0.005, 0.02, 0.05, 0.1, 0.2):
            model = pysindy.SINDy(
                feature_library=pysindy.PolynomialLibrary(degree=3),
                optimizer=pysindy.STLSQ(threshold=threshold),
                differentiation_method=pysindy.SmoothedFiniteDifference(),
            )
            try:
                model.fit(data[0], t=step)
                value = model.score(data[1], t=step)
            except Exception:  # a threshold above every coefficient
                continue
            if value > score + 1e-3:
                best, score = model, value
    right = False
    terms: list[str] = []
    if best is not None:
        coefficients = best.coefficients()[column]
        names = best.get_feature_names()
        terms = [f"{c:.3g} {n}" for c, n in zip(coefficients, names, strict=True) if c]
        if is_polynomial:
            poly = sympy.Poly(polynomial, *symbols)
            true = {tuple(m): float(c) for m, c in poly.terms()}
            powers = best.feature_library.powers_
            seen = {tuple(int(q) for q in m): float(c) for m, c in zip(powers, coefficients, strict=True) if c}
            right = set(seen) == set(true)
    del truth, runs
    return {
        "system": system.name,
        "kind": "pysindy",
        "noise": level,
        "states": len(statement.states),
        "right": right,
        "could": bool(is_polynomial),
        "laws": terms,
        "score": float(score),
    }


def run(path: Path, kinds: list[str], levels: list[str], only: str) -> None:
    done = {(c["system"], c["kind"], c["noise"]) for c in _cases(path)} if path.exists() else set()
    for term in TERMS if "plants" in kinds else ():
        if (only and term.name not in only.split(",")) or (term.name, "plants", "1") in done:
            continue
        try:
            case = run_plant(term)
        except Exception as error:  # the study goes on; the report counts it
            case = {"system": term.name, "kind": "plants", "noise": "1", "error": repr(error)}
        with path.open("a") as file:
            file.write(json.dumps(case) + "\n")
        print(json.dumps({k: v for k, v in case.items() if k != "alternatives"}), flush=True)
    kinds = [kind for kind in kinds if kind != "plants"]
    for kind in kinds:
        for level in levels if kind != "hidden" else [n for n in levels if n == "1"]:
            for system in SYSTEMS:
                if (only and system.name not in only.split(",")) or (system.name, kind, level) in done:
                    continue
                if kind == "hidden" and len(system.equations) < 2:
                    continue
                try:
                    case = run_pysindy(system, level) if kind == "pysindy" else run_case(system, kind, level)
                    if kind == "hidden":
                        case["determined"] = is_determined(system)
                except Exception as error:  # the study goes on; the report counts it
                    case = {
                        "system": system.name,
                        "kind": kind,
                        "noise": level,
                        "states": len(system.equations),
                        "error": repr(error),
                    }
                with path.open("a") as file:
                    file.write(json.dumps(case) + "\n")
                print(json.dumps({k: v for k, v in case.items() if k not in ("alternatives",)}), flush=True)


def _cases(path: Path) -> list[dict]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def report(path: Path) -> None:
    cases = _cases(path)
    for kind in ("dropped", "hidden", "complete", "plants", "pysindy"):
        for level in NOISES:
            some = [c for c in cases if c["kind"] == kind and c["noise"] == level]
            if not some:
                continue
            failed = [c for c in some if "error" in c]
            some = [c for c in some if "error" not in c]
            line = f"{kind:9s} {level:>2s} %: {len(some)} cases, {len(failed)} failed"
            if kind == "complete":
                line += f", laws claimed {sum(bool(c['laws']) for c in some)}, verdicts {dict(Counter(c['verdict'] for c in some))}"
            elif kind == "plants":
                seen = [c for c in some if c["misfit"] > VISIBLE]
                line += (
                    f", visible {len(seen)}, family right {sum(c['right'] for c in seen)}, error above the noise down by nine tenths"
                    f" {sum(c['explained'] >= 0.9 for c in seen)}, verdicts {dict(Counter(c['verdict'] for c in some))}, established and"
                    f" of another family {[c['system'] for c in seen if not c['right'] and c['grade'] == 'established']}"
                )
            elif kind == "pysindy":
                line += f", right support {sum(c['right'] for c in some)}, of polynomial systems {sum(c['could'] for c in some)}"
            else:
                seen = [c for c in some if c["verdict"] != "complete" and c.get("determined", True)]
                wrong = [c for c in seen if not c["right"] and c["grade"] == "established"]
                line += (
                    f", visible {len(seen)}, right {sum(c['right'] for c in seen)} ({100 * np.mean([c['right'] for c in seen]):.0f} %),"
                    f" established and right {sum(c['right'] and c['grade'] == 'established' for c in seen)}, in the declared set"
                    f" {sum(c['in_set'] for c in seen)}, wrong and established {len(wrong)}: {[c['system'] for c in wrong]};"
                    f" not right: {[c['system'] for c in seen if not c['right']]}"
                )
            if kind != "pysindy" and some:
                cpu = [c["cpu"] for c in some]
                line += f"; CPU s median {np.median(cpu):.1f}, 90 % {np.quantile(cpu, 0.9):.1f}, most {max(cpu):.1f}"
            print(line)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("verb", choices=("run", "report"))
    parser.add_argument("path", type=Path)
    parser.add_argument("--kind", action="append")
    parser.add_argument("--noise", action="append")
    parser.add_argument("--only", default="")
    given = parser.parse_args()
    if given.verb == "report":
        report(given.path)
    else:
        run(
            given.path,
            given.kind or ["dropped", "complete", "hidden", "plants", "pysindy"],
            given.noise or ["1", "0", "5"],
            given.only,
        )


if __name__ == "__main__":
    main()
