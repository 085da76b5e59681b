"""Memory of a command over that of its record: ``python -m fits.benchmarks.memory [--rows 5000000] [check fit ...]``.

A lag, one input and one output, in a Parquet file. A command runs with many rows and with few, in processes of their own; the difference
of the largest resident memories over the record's own bytes (time, input, output) is what a row costs.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

ROOT = Path(__file__).resolve().parents[2]
FEW = 2000  # rows: what a command loads and compiles
PERIOD, LAG, NOISE = 1e-3, 0.05, 1e-3
MODEL = """
from greybox import Balance, Input, Model, Output, Parameter, State

lag = Model(
    "lag", [State("x", "m")], [Input("u", "m")], [Output("x", "m")], [Parameter("T", "s", 0.1, (1e-3, 10.0))],
    lambda x, u, p: [Balance("lag", "m", p.T, "x", drive=u.u, own=-x.x)],
)
"""
COMMANDS = {
    "check": "check lag.py {record} --output {folder}/check",
    "simulate": "simulate lag.py {record} --output {folder}/simulated.csv",
    "fit": "fit lag.py {record} --output {folder}/fit",
    "changed": "changed {folder}/fit/fit.json {record} --model lag.py --no-effects --output {folder}/changed",
    "compare": "compare lag.py {record} --validate {record} --workers 1 --output {folder}/compare",
    "discover": "discover lag.py {record} --validate {record} --workers 1 --output {folder}/discover",
}
"""What is measured, in this order: `changed` reads what `fit` has written."""


def write_record(path: Path, rows: int) -> None:
    """A record of the lag under random steps."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    rng, share = np.random.default_rng(1), np.exp(-PERIOD / LAG)
    u = np.repeat(rng.normal(size=rows // 50 + 1), 50)[:rows]
    x = lfilter([0, 1 - share], [1, -share], u) + NOISE * rng.normal(size=rows)
    columns = {"time [s]": PERIOD * np.arange(rows), "u [m]": u, "x [m]": x}
    pq.write_table(pa.table(columns), path)


def measure_peak(command: str, folder: Path) -> int:
    """Largest resident memory (bytes) of a command."""
    environment = os.environ | {"PYTHONPATH": str(ROOT), "GREYBOX_CACHE": str(folder / "cache")}
    program = subprocess.Popen(
        [sys.executable, "-m", "greybox", *command.split()], cwd=folder, env=environment, stdout=subprocess.DEVNULL
    )
    _, status, usage = os.wait4(program.pid, 0)
    if status:
        raise RuntimeError(f"{command}: status {status}")
    return 1024 * usage.ru_maxrss


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure some commands, or all."""
    parser = argparse.ArgumentParser(description="Memory of commands over that of their record.")
    parser.add_argument("commands", nargs="*", help=f"of {', '.join(COMMANDS)}; all if left out")
    parser.add_argument("--rows", type=int, default=5_000_000)
    chosen = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        (folder / "cache").mkdir(mode=0o700)
        (folder / "lag.py").write_text(MODEL, encoding="utf-8")
        sizes = {"few": FEW, "many": chosen.rows}
        for name, rows in sizes.items():
            write_record(folder / f"{name}.parquet", rows)
        for command in chosen.commands or COMMANDS:
            few, many = (
                measure_peak(COMMANDS[command].format(record=f"{name}.parquet", folder=name), folder) for name in sizes
            )
            data = 8 * 3 * (chosen.rows - FEW)
            print(f"{command}: {(many - few) / data:.2f} times the record; {few / 1e6:.0f} MB without it", flush=True)


if __name__ == "__main__":
    main()
