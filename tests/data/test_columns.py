"""Which column is which signal, where the headers do not say it."""

from __future__ import annotations

import numpy as np
import pytest

from greybox.data.columns import propose_columns
from greybox.data.file_kinds import open_record_file
from greybox.model.balance import Balance
from greybox.model.model import Model
from greybox.model.signals import Input, Output, Parameter, State

CART = Model(
    "cart",
    [State("v", "m/s")],
    [Input("f", "N")],
    [Output("v", "m/s")],
    [Parameter("M", "kg", 1.0)],
    lambda x, u, p: [Balance("force", "N", p.M, "v", drive=u.f)],
)


def propose(tmp_path, headers, mapping=None):
    """Columns and choices for a file with these headers; each choice as signal -> (column, by name)."""
    path = tmp_path / "run.csv"
    rows = "\n".join(",".join(f"{value}" for value in row) for row in np.arange(3.0 * len(headers)).reshape(3, -1))
    path.write_text(f"{','.join(headers)}\n{rows}\n", encoding="utf-8")
    proposal = propose_columns(open_record_file(path).table, CART, mapping)
    return proposal and (proposal[0], {c.signal.name: (c.column, c.matched) for c in proposal[1]})


@pytest.mark.parametrize(
    ("headers", "columns", "choices"),
    [
        (
            ["time", "Kraft [mN]", "Tempo [km/h]"],
            ("time", "Kraft [mN]", "Tempo [km/h]"),
            {"time": ("time", True), "f": ("Kraft [mN]", False), "v": ("Tempo [km/h]", False)},
        ),
        (
            ["time", "a [N]", "b [N]", "v"],  # two of one unit: a person must say which
            ("time", "a [N]", "b [N]", "v"),
            {"time": ("time", True), "f": ("", False), "v": ("v", True)},
        ),
        (
            ["time", "F", "F", "v"],  # a header that stands twice is chosen by its number
            ("time", "2", "3", "v"),
            {"time": ("time", True), "f": ("", False), "v": ("v", True)},
        ),
    ],
)
def test_columns_are_proposed_by_name_and_unit(tmp_path, headers, columns, choices):
    assert propose(tmp_path, headers) == (columns, choices)


def test_nothing_is_proposed_where_every_signal_has_its_column(tmp_path):
    assert propose(tmp_path, ["time", "f", "v"]) is None
    assert propose(tmp_path, ["time", "drive", "v"], {"f": "drive"}) is None


def test_a_choice_that_another_file_has_not_is_asked_anew(tmp_path):
    _, choices = propose(tmp_path, ["time", "drive", "v"], {"f": "Kraft [N]"})
    assert choices["f"] == ("", False)
