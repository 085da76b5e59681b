"""The first line of a discovery and the table below it quote the error of one output."""

import math
from types import SimpleNamespace

from greybox.discovery import Discovery
from greybox.discovery.holdout import HoldoutError, worst_output
from greybox.discovery.result import RankedCandidate
from greybox.model.parts import Occurrence
from greybox.show.documents.discovery import _sets_table, discovery_answer
from greybox.show.sentences.wording import change_text


def test_the_answer_and_its_table_are_about_the_same_output():
    # The pressure falls to less of what it was, the angle was further above its noise.
    errors = {"p": HoldoutError(20.0, 1.0, 1.0, "Pa"), "th": HoldoutError(0.3, 0.03, 0.002, "rad")}
    discovery = SimpleNamespace(conclusion=(), effects=[{"name": "creep"}], holdout=errors, ranking=(), findings=())
    output = worst_output(errors)
    assert output == "th"
    assert f"error in {output} " in discovery_answer(discovery)
    assert change_text(0.3, 0.03, "rad") in discovery_answer(discovery)
    assert f"error in {output}" in _sets_table(discovery).head


def test_the_sets_of_effects_are_a_frame():
    usual = next(iter(Occurrence))
    sets = (
        RankedCandidate(("creep", "lag"), 1.01, 0.0, 3, usual, {"p": 1.0, "th": 0.03}),
        RankedCandidate(("creep",), 1.02, 5.0, 2, usual, {"p": 2.0}),
    )
    errors = {"p": HoldoutError(20.0, 1.0, 1.0, "Pa"), "th": HoldoutError(0.3, 0.03, 0.002, "rad")}
    table = Discovery.to_frame(SimpleNamespace(effects=[{"name": "creep"}], holdout=errors, ranking=sets))
    assert table.index.name == "effects" and list(table.index) == ["creep + lag", "creep"]
    assert table["answer"].tolist() == [False, True] and table["constants"].tolist() == [3, 2]
    assert table["error in p"].tolist() == [1.0, 2.0] and math.isnan(table.loc["creep", "error in th"])
