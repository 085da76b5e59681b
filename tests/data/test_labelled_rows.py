"""Logs of a serial port, whose every row says its names again."""

import numpy as np
import pytest

from greybox.data.text_table import read_text


@pytest.mark.parametrize(
    ("lines", "names"),
    [
        (["sec: 0.00  out: 0.0  pv: 25.0", "sec: 0.29  out: 64.0  pv: 26.3"], ["sec", "out", "pv"]),
        (["t=;0,00;u=;1,5", "t=;0,10;u=;1,5"], ["t", "u"]),
        (["T 20.5 P 1.0", "T 20.7 P nan"], ["T", "P"]),
    ],
)
def test_the_first_row_of_a_log_with_labels_is_a_row(tmp_path, lines, names):
    file = tmp_path / "serial.log"
    file.write_text("\n".join([*lines, lines[-1]]) + "\n")
    table = read_text(file)
    assert table.rows == 3 and [h for h in table.headers if not h.startswith("column")] == names
    columns, problems, _ = table.values([table.headers.index(names[0])])
    assert not problems and np.isfinite(next(iter(columns.values()))).all()


def test_a_header_above_a_column_of_one_word_is_a_header(tmp_path):
    file = tmp_path / "run.csv"
    file.write_text("mode,time,u\nauto,0.0,1.0\nauto,0.1,2.0\n")
    table = read_text(file)
    assert table.rows == 2 and list(table.headers) == ["mode", "time", "u"]
