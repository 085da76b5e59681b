"""Worker processes end with the process that started them, whatever they are doing and however it ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from tests.support.child import is_alive

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals as POSIX has them")
# Half of what a worker would go on for: on a busy machine the system takes seconds to end one.
END_SECONDS = 30.0
JOBS = {
    "sleeps": "time.sleep(60)",
    "runs python": "exec('while True: pass')",
    "never lets other threads run": "sum(range(10**11))",
}


def start(folder: Path, doing: str, main: str = "") -> tuple[subprocess.Popen, list[int]]:
    """A process with two workers that do something for a minute, and the workers' process ids."""
    script = folder / "script.py"
    script.write_text(
        textwrap.dedent(f"""
        import os, sys, time
        from pathlib import Path
        from greybox.base.parallel.jobs import run_jobs

        def job(folder, item):
            Path(folder, f"worker-{{os.getpid()}}").touch()
            {JOBS[doing]}

        {main}
        results, interrupted = run_jobs(job, {str(folder)!r}, range(4), workers=2)
        print("interrupted" if interrupted else "done")
        """)
    )
    environment = {**os.environ, "PYTHONPATH": os.getcwd()}
    process = subprocess.Popen(
        [sys.executable, str(script)], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    deadline = time.monotonic() + 60
    while len(workers := [int(p.name.partition("-")[2]) for p in folder.glob("worker-*")]) < 2:
        assert time.monotonic() < deadline and process.poll() is None, process.communicate()
        time.sleep(0.05)
    return process, workers


# By day every signal and every job once.
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
ENDS = [
    pytest.param(by, doing, marks=[pytest.mark.slow] * (i != j))
    for i, by in enumerate(SIGNALS)
    for j, doing in enumerate(JOBS)
]


@pytest.mark.rest
@pytest.mark.parametrize(("by", "doing"), ENDS)
def test_workers_end_with_their_parent(tmp_path, doing, by):
    process, workers = start(tmp_path, doing)
    began = time.monotonic()
    process.send_signal(by)
    while any(map(is_alive, workers)) and time.monotonic() - began < END_SECONDS:
        time.sleep(0.05)
    left = [pid for pid in workers if is_alive(pid)]
    for pid in left:
        os.kill(pid, signal.SIGKILL)
    out, err = process.communicate(timeout=30)
    assert not left
    if by is signal.SIGINT:
        assert out == "interrupted\n"
        assert "Traceback" not in err
