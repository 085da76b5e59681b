"""Change detection on measured machines whose changes are known: a rotor whose electric brake is switched, a damper at four coil voltages.

    python -m fits.studies.measured_changes FOLDER

FOLDER/known holds ``rosa_rotor`` (Yeung et al., IROS 2022) and ``mr_damper_utfpr`` (Labcontrol, UTFPR). Nothing in a machine has
changed between pieces with the same resistance, or records at the same voltage; everything else is a change whose cause is known: more
viscous damping of the rotor, more damping of the damper. A change is counted by itself as well where it is of five standard deviations:
of what the damping differs by between records of the machine as it was, each fitted alone.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from itertools import combinations, pairwise, permutations
from pathlib import Path
from typing import NamedTuple

import numpy as np

import greybox as gb
from fits.studies.measured_rigs import damper, rotor, shaken, table

# Torque a per cent of effort and inertia: its unit is arbitrary, and at one speed it goes with the damping.
STRENGTH = 3.0
# Rows of a piece in which the brake stays as it is, at least (2 s), and at most where nothing is switched.
LEAST_ROWS, PIECE_ROWS = 120, 330


class Stretch(NamedTuple):
    """A stretch of a record in which nothing was switched: what the machine was asked, and how its damping was set."""

    asked: float
    setting: float
    record: gb.Experiment


def rotor_stretches(folder: Path) -> list[Stretch]:
    """Stretches of constant speed and brake, each cut at `PIECE_ROWS`, the settling after a switch left out."""
    stretches = []
    for path in sorted((folder / "known" / "rosa_rotor").glob("*.csv")):
        t, reference, speed, effort, resistance, *_ = table(path)
        switched = np.flatnonzero((np.diff(reference) != 0) | (np.diff(resistance) != 0)) + 1
        edges = [0, *switched, len(t)]
        whole = gb.Experiment(path.stem, t, {"u": effort}, {"w": speed * np.pi / 30})
        for begin, end in pairwise(edges):
            count = max((end - begin) // PIECE_ROWS, 1)
            bounds = np.linspace(begin, end, count + 1).astype(int)
            for first, last in pairwise(bounds):
                if last - first >= LEAST_ROWS:
                    piece = whole.window(int(first), int(last))
                    name = f"{path.stem} {first}"
                    record = gb.Experiment(name, piece.time, dict(piece.inputs), dict(piece.outputs))
                    stretches.append(Stretch(reference[first], resistance[first], record))
    return stretches


def damper_records(folder: Path) -> list[Stretch]:
    """The ten runs, by coil voltage."""
    names = sorted(path.stem for path in (folder / "known" / "mr_damper_utfpr").glob("*.csv"))
    return [
        Stretch(0.0, float(name.split("V_")[0]), shaken(folder / "known" / "mr_damper_utfpr" / f"{name}.csv"))
        for name in names
    ]


def compare(model: gb.Model, before: Sequence[Stretch], after: Sequence[Stretch]) -> gb.ChangeDetection:
    """What `changed` says of two groups of stretches."""
    reference = gb.fit(model, [s.record for s in before])
    return gb.detect_changes(reference, [s.record for s in after], search_effects=False)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="Change detection on measured machines whose changes are known.")
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args(arguments).folder
    model = rotor().start(kt=STRENGTH).fix("kt", "c")
    stretches = rotor_stretches(folder)
    pairs = [(one, other) for one, other in permutations(stretches, 2) if one.asked == other.asked]
    report("rotor, one stretch against another", "b", model, [([a], [b]) for a, b in pairs if a.setting >= b.setting])
    groups = []
    for asked in sorted({s.asked for s in stretches}):
        normal = [s for s in stretches if s.asked == asked and s.setting == 15.0]
        for today in (s for s in stretches if s.asked == asked):
            known = [s for s in normal if s is not today]
            if len(known) >= 3:
                groups.append((known[:4], [today]))
    report("rotor, three or four stretches against one", "b", model, groups)
    runs = damper_records(folder)
    levels = sorted({s.setting for s in runs})
    report("damper, one run against another", "c", damper(), [([a], [b]) for a, b in permutations(runs, 2)])
    at = {level: [s for s in runs if s.setting == level] for level in levels}
    several = [(at[a], at[b]) for a, b in combinations(levels, 2)]
    single = [([r for r in at[a] if r is not s], [s]) for a in levels for s in at[a] if len(at[a]) > 2]
    report("damper, all runs of a voltage", "c", damper(), [*several, *single])


# Standard deviations from which a change must be named.
LARGE = 5.0


def measure_logarithms(model: gb.Model, name: str, stretches: Sequence[Stretch]) -> tuple[dict[str, float], float]:
    """The logarithm of the damping of each stretch, fitted alone, and its standard deviation between stretches of one kind."""
    values = {s.record.name: float(np.log(gb.fit(model, s.record).parameters[name].value)) for s in stretches}
    kinds: dict[tuple[float, float], list[float]] = {}
    for s in stretches:
        kinds.setdefault((s.asked, s.setting), []).append(values[s.record.name])
    # Pooled over the kinds: sum of squares about each mean over the degrees of freedom of all.
    squares = sum(float(np.var(of)) * len(of) for of in kinds.values())
    return values, float(np.sqrt(squares / sum(len(of) - 1 for of in kinds.values())))


def report(
    title: str, name: str, model: gb.Model, pairs: Sequence[tuple[Sequence[Stretch], Sequence[Stretch]]]
) -> None:
    """Print how many known changes are named, and how often a machine that nobody touched is called changed."""
    counts: dict[tuple[str, str], int] = {}
    every = {s.record.name: s for sides in pairs for side in sides for s in side}
    logarithms, deviation = measure_logarithms(model, name, list(every.values()))
    for before, after in pairs:
        change = compare(model, before, after)
        one, other = ([logarithms[s.record.name] for s in side] for side in (before, after))
        size = abs(np.mean(other) - np.mean(one)) / (deviation * np.sqrt(1 / len(one) + 1 / len(other)))
        kinds = ["as it was"] if before[0].setting == after[0].setting else ["changed"]
        if kinds == ["changed"] and size >= LARGE:
            kinds.append(f"changed by {LARGE:g} standard deviations")
        verdict = "named" if name in change.moved else str(change.verdict)
        for truth in kinds:
            counts[truth, verdict] = counts.get((truth, verdict), 0) + 1
        sys.stderr.write(
            f"{title}: {[s.record.name for s in before]} ({before[0].setting}) -> {after[0].record.name}"
            f" ({after[0].setting}): {change.verdict} {change.moved}, {size:.1f} standard deviations\n"
        )
    for (truth, verdict), count in sorted(counts.items()):
        total = sum(n for (which, _), n in counts.items() if which == truth)
        sys.stdout.write(f"{title}: {truth}: {verdict} {count} of {total}\n")


if __name__ == "__main__":
    main()
