"""Does the false-name rate that a discovery says agree with the false names that are found?

    python -m fits.studies.false_names STUDY [--measured RESULTS]

STUDY holds the answers of `fits.studies.hidden_study`, RESULTS those of `fits.studies.measured_certainty`. Found
is how many answers establish a name that
is not there; of the simulated cases those that had the truth taken away, where every name is false. Said is what the answers said
themselves: how often signals without meaning, made from the same records, would have been established (`greybox.discovery.false_names`).

What to expect: the rate that was said and the rate that was found within a factor of two, as far as their numbers tell.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from scipy.special import betaincinv

from fits.studies.hidden_study import read
from greybox.discovery.claims import Depth
from greybox.discovery.decision import Grade

# The goal: the two rates within a factor of two.
FACTOR = 2.0


def list_answers(study: Path) -> list[Mapping[str, Any]]:
    """The answers of a simulated study that had the truth taken away."""
    return [answer for row in read(study) for answer in row["answers"] if answer["left_out"]]


def has_false_name(answer: Mapping[str, Any]) -> bool:
    """Whether an answer establishes a name that is not there."""
    return any(
        c["depth"] == Depth.NAME and c["grade"] == Grade.ESTABLISHED and c["right"] is False for c in answer["claims"]
    )


def bounds(count: int, of: int) -> tuple[float, float]:
    """The 95 % interval of a rate (C. J. Clopper, E. S. Pearson 1934)."""
    low = float(betaincinv(count, of - count + 1, 0.025)) if count else 0.0
    return low, float(betaincinv(count + 1, of - count, 0.975)) if count < of else 1.0


def compare(answers: Sequence[Mapping[str, Any]]) -> bool:
    """Whether what was said and what was found are within the factor of each other, as far as their intervals tell."""
    rates = [rate for answer in answers for rate in answer["rates"]]
    said = sum(rate["established"] for rate in rates), sum(rate["tried"] for rate in rates)
    found = sum(map(has_false_name, answers)), len(answers)
    of_said, of_found = bounds(*said), bounds(*found)
    print(f"  said: {said[0]} of {said[1]} contests ({100 * of_said[0]:.1f} to {100 * of_said[1]:.1f} %)")
    print(
        f"  found: a false name in {found[0]} of {found[1]} answers ({100 * of_found[0]:.1f} to {100 * of_found[1]:.1f} %)"
    )
    return of_said[0] <= FACTOR * of_found[1] and of_found[0] <= FACTOR * of_said[1]


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("study", type=Path, help="folder of the answers of fits.studies.hidden_study")
    arguments.add_argument("--measured", type=Path, help="folder of the answers of fits.studies.measured_certainty")
    chosen = arguments.parse_args()
    kinds = {"simulated": list_answers(chosen.study)}
    if chosen.measured:
        kinds["measured"] = read(chosen.measured)
    agree = []
    for kind, answers in kinds.items():
        print(f"{kind}:")
        agree.append(compare(answers))
    assert all(agree), f"the rate that is said and the rate that is found are further apart than {FACTOR:g} times"


if __name__ == "__main__":
    main()
