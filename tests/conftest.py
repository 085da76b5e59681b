"""What every test shares: one BLAS thread, repeatable random examples, public records, the command, an empty cache on request."""

from __future__ import annotations

import gc
import importlib.util
import os
import signal
import sys
import time
import warnings
import zlib
from collections.abc import Callable, Generator, Iterator
from pathlib import Path

import pytest
from click.testing import Result
from hypothesis import settings

from tests.support.browser import browser, tab
from tests.support.command import CliRunner

# Before anything imports numpy: a pool of threads on 4x4 matrices costs a hundred times the arithmetic.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

# A shell that runs something in the background lets it ignore Ctrl+C, and whatever that starts: here it is heard.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# A file that is written waits for the disk, some milliseconds each, against a loss of power that no test brings about: here it only
# looks whether the file is open. The programs that tests start, and kill, wait.
os.fsync = os.fstat  # type: ignore[assignment]

# A worker of the run has one core to itself. What asks for their number would start processes beside those of the other worker, each of
# which imports for a second what it needs; tests of processes say how many they want.
if "PYTEST_XDIST_WORKER" in os.environ and hasattr(os, "sched_getaffinity"):
    os.sched_getaffinity = lambda pid: {0}

# The same examples in every run; HYPOTHESIS_PROFILE=default searches at random and for longer.
settings.register_profile("ci", derandomize=True, max_examples=25, deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci"))

__all__ = ["browser", "tab"]
ROOT = Path(__file__).resolve().parents[1]
SHARED = ROOT.parent / "shared"


def keep_out_of_rounds() -> None:
    """Let the garbage collector look no more at what is there now, and stays: each of its whole rounds would take a third of a second."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Some half a million objects are there once all tests are collected, and stay.

    The garbage collector neither looks for waste while they are made, nor at them again with each of its rounds.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        keep_out_of_rounds()
        # What is kept out does not count in the share of new objects that a whole round waits for: without this they come too often.
        gc.set_threshold(700, 10, 50)
        gc.enable()


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """The run of the slower tests opens no file that has none: to import them all takes as long as twenty such tests."""
    if not config.option.markexpr.startswith("rest") or not collection_path.match("test_*.py"):
        return None
    text = collection_path.read_text(encoding="utf-8")
    return None if "mark.rest" in text or "browser" in text else True


def pytest_itemcollected(item: pytest.Item) -> None:
    """A test that opens a browser is none of the everyday ones."""
    if "browser" in getattr(item, "fixturenames", ()):
        item.add_marker(pytest.mark.rest)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Leave one in so many cases of a crossed test to the run of each change, and the others to the night.

    ``@pytest.mark.crossed(3)`` keeps every third case of those that are not slow anyway. Which one is first differs from test to test, so
    that over a file of such tests each plant and each method is met.
    """
    crossed: dict[str, list[pytest.Item]] = {}
    for item in items:
        if item.get_closest_marker("crossed") and not any(item.iter_markers("slow")):
            crossed.setdefault(item.nodeid.partition("[")[0], []).append(item)
    for name, cases in crossed.items():
        (step,) = cases[0].get_closest_marker("crossed").args  # type: ignore[union-attr]
        first = zlib.crc32(name.encode()) % min(step, len(cases))
        for k, item in enumerate(cases):
            if (k - first) % step:
                item.add_marker(pytest.mark.slow)


# Tests of a run from which it is a whole one: nobody waits for imports that a single test does not need.
WHOLE_RUN = 200
# What hundreds of tests share, by the time that importing it takes: without this the first test of a worker pays for all.
HEAVY = (
    "scipy.stats",
    "asammdf",
    "control",
    "statsmodels.api",
    "pandas",
    "h5py",
    "distributed",
    "pyarrow.parquet",
    "plotly",
)


@pytest.fixture(scope="session", autouse=True)
def heavy_imports(request: pytest.FixtureRequest) -> None:
    """Import what takes long before the clock of any test runs."""
    if request.session.testscollected >= WHOLE_RUN:
        with warnings.catch_warnings(action="ignore"):
            for name in HEAVY:
                if importlib.util.find_spec(name.partition(".")[0]):
                    importlib.import_module(name)
        keep_out_of_rounds()


# Processor time, in s, that an everyday test may take: of its own thread, so that a busy machine and a compiler at work do not count.
EVERYDAY_SECONDS = 2.0
# Steps of a loop of whole numbers, and the processor time, in s, that they took where the limit holds as it stands (EPYC, 2.4 GHz).
YARDSTICK_STEPS = 300_000
YARDSTICK_SECONDS = 0.020


def _slowness() -> float:
    """How many times slower than the machine of the limit this one is now: the best of five rounds, and never below one."""
    rounds = []
    for _ in range(5):
        began, total = time.thread_time(), 0
        for k in range(YARDSTICK_STEPS):
            total += k * k % 7
        rounds.append(time.thread_time() - began)
    return max(1.0, min(rounds) / YARDSTICK_SECONDS)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, None, None]:
    """Fail an everyday test that is none, in a whole run: thousands of them must run in minutes."""
    began = time.thread_time()
    yield
    took = time.thread_time() - began
    is_everyday = not any(item.iter_markers("rest")) and not any(item.iter_markers("slow"))
    if not is_everyday or item.session.testscollected < WHOLE_RUN or took <= EVERYDAY_SECONDS:
        return
    limit = EVERYDAY_SECONDS * _slowness()
    if took > limit:
        pytest.fail(
            f"took {took:.1f} s, and an everyday test takes at most {limit:.1f} s here: make it faster, or mark it rest"
        )


def _folder(name: str, content: str) -> Path:
    folder = SHARED / name
    if not folder.is_dir():
        pytest.skip(f"../shared/{name} ({content}) is not beside this checkout")
    return folder


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of public benchmark records, `../shared/data`; a test that needs it is skipped where it is missing."""
    return _folder("data", "public benchmark records")


@pytest.fixture(scope="session")
def shared_blind() -> Path:
    """The folder of simulated cases with known answers, `../shared/blind`; skipped where it is missing."""
    return _folder("blind", "simulated cases with known answers")


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Result]]:
    """Runs the command in an empty folder; imports of models are as before afterwards."""
    from greybox.shell.commands import app

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    before = {name: module for name, module in sys.modules.items() if name.split(".")[0] == "models"}
    yield lambda *arguments: CliRunner().invoke(app, [str(a) for a in arguments])
    for name in [n for n in sys.modules if n.split(".")[0] == "models" or n.startswith("_greybox_file_")]:
        del sys.modules[name]
    sys.modules.update(before)


@pytest.fixture
def fresh_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache of compiled kernels for one test; the others reuse the user's and save the compile time."""
    folder = tmp_path / "cache"
    monkeypatch.setenv("GREYBOX_CACHE", str(folder))
    return folder
