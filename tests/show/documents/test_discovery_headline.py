"""The first line of a discovery and the table below it quote the error of one output."""

from types import SimpleNamespace

from greybox.discovery.holdout import HoldoutError, worst_output
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
