"""Does the false-name rate that a discovery says agree with the false names that are found?

    python -m fits.false_names FOLDER [--data DATA] [--cases 10] [--first 91001] [--rows 1200] [--limit 120]

Simulated cases (`fits.hidden_study`) are answered with the truth taken away: every name that is established is false. Of the measured
rigs (`fits.measured_rigs`, below DATA) a handful that is cheap is searched with the whole catalogue; what is known of the rig says which
established names are false. Beside that stands what the answers said themselves: how often signals without meaning, made from the same
records, would have been established (`greybox.discovery.false_names`). Every search leaves a file in FOLDER, so the study goes on where
it was stopped.

What to expect: the rate that was said and the rate that was found within a factor of two, as far as their numbers tell.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from time import process_time
from typing import Any

from scipy.special import betaincinv

import greybox as gb
from fits.hidden_study import RIGS as HIDDEN_RIGS
from fits.hidden_study import _make_case as make_case
from fits.measured_certainty import judge_claim
from fits.measured_rigs import RIGS, SEARCHES
from greybox.base.files import write_file
from greybox.base.json_shape import to_values
from greybox.discovery.candidates import family_of
from greybox.discovery.claims import Depth
from greybox.model.effects.catalogue import CATALOGUE
from greybox.shell.project import find_model

# Rigs whose searches take a minute or two, and how many searches of each.
MEASURED = {"light ball": 2, "heavy ball": 2, "tacho": 1, "two cylinders": 1, "silverbox": 1}
# The goal: the two rates within a factor of two.
FACTOR = 2.0


def search_simulated(seed: int, rows: int, limit: float) -> dict[str, Any]:
    """One simulated case with the true effects and their families taken away: whatever is established by name is false."""
    case = make_case(seed, rows)
    right = {name.partition("_at_")[0] for names in case.right for name in names} & {e.name for e in CATALOGUE}
    without = sorted({relative for name in right for relative in family_of(name)})
    found = gb.discover(
        find_model(case.model).fix(**case.known).start(**case.start),
        case.estimation,
        validation=case.validation,
        noise=case.noise,
        quiet=case.quiet or (),
        without=without,
        options=gb.FitOptions(at_rest=case.model in HIDDEN_RIGS),
        workers=1,
        time_limit=limit,
    )
    false = [c.name for c in found.claims if c.depth is Depth.NAME and c.is_established]
    return describe(f"simulated {seed}: {' + '.join(case.effects) or 'nothing'}", "simulated", found, false)


def search_measured(name: str, number: int, data: Path, limit: float) -> dict[str, Any]:
    """One search of a measured rig; established names that are known to be wrong are false."""
    rig, case = RIGS[name], [each for each in SEARCHES if each.rig == name][number]
    learn, choose = (rig.record(data, stretch) for stretch in (case.learn, case.choose))
    model = rig.model(data / rig.folder / "model")
    found = gb.discover(model, learn, validation=choose, workers=1, time_limit=limit)
    named = [c for c in found.claims if c.depth is Depth.NAME and c.is_established]
    false = [c.name for c in named if judge_claim(rig, to_values(c)) is False]
    return describe(f"{name}: {case.learn}", "measured", found, false)


def describe(title: str, kind: str, found: gb.Discovery, false: Sequence[str]) -> dict[str, Any]:
    """A line of the study."""
    return {
        "title": title,
        "kind": kind,
        "verdict": str(found.verdict),
        "effects": {e["name"]: str(e["grade"]) for e in found.effects},
        "established": [c.name for c in found.claims if c.depth is Depth.NAME and c.is_established],
        "false": list(false),
        "rates": [to_values(rate) for rate in found.false_names],
    }


def run(folder: Path, data: Path | None, cases: int, first: int, rows: int, limit: float) -> Iterator[dict[str, Any]]:
    """Every search, from its file where there is one."""
    jobs: list[tuple[str, Callable[..., dict[str, Any]], tuple[Any, ...]]] = [
        (f"{seed:05d}", search_simulated, (seed, rows, limit)) for seed in range(first, first + cases)
    ]
    if data is not None:
        there = {name: count for name, count in MEASURED.items() if (data / RIGS[name].folder).is_dir()}
        jobs += [
            (f"{name.replace(' ', '_')}_{k}", search_measured, (name, k, data, limit))
            for name, count in there.items()
            for k in range(count)
        ]
    for name, search, arguments in jobs:
        file = folder / f"{name}.json"
        if not file.exists():
            began = process_time()
            try:
                line = search(*arguments)
            except OverflowError:  # a plant drawn so strong that it flies apart is no case
                continue
            write_file(file, json.dumps(line | {"seconds": process_time() - began}, indent=1) + "\n")
        line = json.loads(file.read_text(encoding="utf-8"))
        said = ", ".join(f"{r['established']} of {r['tried']} for {r['effect']}" for r in line["rates"]) or "nothing"
        print(f"{line['title']}: {line['verdict']}, {line['effects']}, false {line['false']}, said {said}", flush=True)
        yield line


def bounds(count: int, of: int) -> tuple[float, float]:
    """The 95 % interval of a rate (C. J. Clopper, E. S. Pearson 1934)."""
    low = float(betaincinv(count, of - count + 1, 0.025)) if count else 0.0
    return low, float(betaincinv(count + 1, of - count, 0.975)) if count < of else 1.0


def compare(lines: Sequence[Mapping[str, Any]]) -> bool:
    """Whether what was said and what was found are within the factor of each other, as far as their intervals tell."""
    rates = [rate for line in lines for rate in line["rates"]]
    said = sum(rate["established"] for rate in rates), sum(rate["tried"] for rate in rates)
    found = sum(bool(line["false"]) for line in lines), len(lines)
    of_said, of_found = bounds(*said), bounds(*found)
    print(f"  said: {said[0]} of {said[1]} contests ({100 * of_said[0]:.1f} to {100 * of_said[1]:.1f} %)")
    print(
        f"  found: a false name in {found[0]} of {found[1]} answers ({100 * of_found[0]:.1f} to {100 * of_found[1]:.1f} %)"
    )
    return of_said[0] <= FACTOR * of_found[1] and of_found[0] <= FACTOR * of_said[1]


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("folder", type=Path)
    arguments.add_argument("--data", type=Path, help="folder of the measured rigs; without it they are left out")
    arguments.add_argument("--cases", type=int, default=10)
    arguments.add_argument("--first", type=int, default=91001)
    arguments.add_argument("--rows", type=int, default=1200)
    arguments.add_argument("--limit", type=float, default=120.0)
    chosen = arguments.parse_args()
    chosen.folder.mkdir(parents=True, exist_ok=True)
    lines = list(run(chosen.folder, chosen.data, chosen.cases, chosen.first, chosen.rows, chosen.limit))
    agree = []
    for kind in ("simulated", "measured"):
        if chosen_lines := [line for line in lines if line["kind"] == kind]:
            print(f"{kind}:")
            agree.append(compare(chosen_lines))
    assert all(agree), f"the rate that is said and the rate that is found are further apart than {FACTOR:g} times"


if __name__ == "__main__":
    main()
