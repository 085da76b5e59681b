"""What greybox takes: passes of the kernel, whole fits, fits without a compiler, random starts, memory, first results."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from fits.benchmarks.problems import Case
from greybox.estimation.fit import fit
from greybox.estimation.multistart import draw_starts
from greybox.estimation.noise_loop import solve
from greybox.estimation.options import FitOptions
from greybox.estimation.result import Fit
from greybox.estimation.transcription.preparation import prepare_problem
from greybox.estimation.transcription.problem import EstimationProblem, Solution
from greybox.model.model import Model
from greybox.simulation.kernel.make_kernel import make_kernel
from greybox.simulation.kernel.record import Record
from greybox.simulation.records import to_record

# The actuator is linear: greybox discretises it exactly. The other two take the same RK4 step as the peers.
REPEATS = 7


def cpu(run: Callable[[], object]) -> float:
    """CPU seconds of one call."""
    began = time.process_time()
    run()
    return time.process_time() - began


def options(case: Case, method: str = "automatic") -> FitOptions:
    """How greybox fits this case: initial state known, and the peers' RK4 step where the model is not linear."""
    exact = method == "automatic" and case.truth.system.linear
    return FitOptions(at_rest=True, method=method, substeps=0 if exact else case.substeps)


def prepared(case: Case, model: Model | None = None, method: str = "automatic") -> EstimationProblem:
    """The laid out problem."""
    return prepare_problem(model or case.start, case.experiment, case.noise, options(case, method))


def simulation(case: Case) -> Callable[[], float]:
    """The unit: gives the CPU seconds of one compiled RK4 pass over the data (median of some)."""
    kernel, record = make_kernel(case.step), _one_row(case)
    p = np.array(list(case.start.values.values()))
    x0 = np.asarray(case.start.system.start_function(p)[0]).ravel()
    repeats = 3 if len(record.u) > 100_000 else REPEATS

    def unit() -> float:
        return float(np.median([cpu(lambda: kernel.simulate(record, p[None], p, x0)) for _ in range(repeats)]))

    unit()
    return unit


def pass_ratio(case: Case) -> float:
    """Cost, gradient and Gauss-Newton matrix in one RK4 pass, over one RK4 simulation."""
    problem = prepared(case, method="rk4")
    shooting = problem.shooting()
    arguments = (shooting.records[0], shooting.at(problem.variables.here, 0), shooting.weight)
    unit = simulation(case)
    problem.kernel.sums(*arguments)
    ratios = []
    for _ in range(REPEATS):
        before = unit()
        spent = np.median([cpu(lambda: problem.kernel.sums(*arguments)) for _ in range(5)])
        ratios.append(2 * spent / (before + unit()))
    return float(np.median(ratios))


def cost(case: Case, values: np.ndarray, method: str) -> float:
    """Sum of squared residuals over noise of a result, by the discretisation it was fitted with."""
    model = case.truth.start(**dict(zip(case.free, map(float, values), strict=True)))
    problem = prepared(case, model, method)
    return problem.shooting().evaluate(problem.variables.here).cost


def fitted(case: Case, solution: Solution) -> np.ndarray:
    """The values of the free constants."""
    return solution.variables.fixed[solution.variables.which]


def fitter(case: Case, method: str = "automatic") -> Callable[[], np.ndarray]:
    """A fit on a prepared problem, as the peers are timed."""
    problem, chosen = prepared(case, method=method), options(case, method)
    return lambda: fitted(case, solve(problem, chosen))


def solver(case: Case) -> str:
    """Which optimisers ran in a fit."""
    return str(whole_call(case)().solver.statistics["optimiser"])


def whole_call(case: Case) -> Callable[[], Fit]:
    """`greybox.fit` from model and record to the result with intervals and notes."""
    return lambda: fit(case.start, case.experiment, noise=case.noise, options=options(case))


@contextmanager
def no_compiler():
    """Everything interpreted."""
    before = os.environ.get("GREYBOX_KERNEL", "")
    os.environ["GREYBOX_KERNEL"] = "interpreted"
    try:
        yield
    finally:
        os.environ["GREYBOX_KERNEL"] = before


def without_compiler(case: Case, unit: float) -> float:
    """Simulation equivalents of a fit in CasADi's virtual machine."""
    with no_compiler():
        run = fitter(case)
        run()  # the functions of the virtual machine are built in the first one
        return cpu(run) / unit


def starts_won(case: Case, starts: int = 20) -> int:
    """How many random starts within a factor 3 of the truth end within 1 % of the best cost."""
    chosen, ends = options(case), []
    for begin in draw_starts(case.truth, starts, seed=5):
        solution = solve(prepared(case, case.truth.start(**begin)), chosen)
        ends.append(solution.evaluation.cost if np.isfinite(solution.evaluation.cost) else np.inf)
    return int(np.sum(np.array(ends) <= 1.01 * min(ends)))


def memory(rows: int = 400_000) -> float:
    """Megabytes that a linear fit needs at its peak above imports and data, in a process of its own (Linux; else NaN)."""
    if sys.platform != "linux":
        return float("nan")
    text = (
        "from fits.benchmarks import ours, problems\n"
        f"ours.fitter(problems.actuator(4000))(); case = problems.actuator({rows}); case.start\n"
        "def status(key): return next(int(l.split()[1]) for l in open('/proc/self/status') if l.startswith(key)) / 1024\n"
        "import ctypes, gc; gc.collect(); ctypes.CDLL(None).malloc_trim(0)\n"
        "before = status('VmRSS'); open('/proc/self/clear_refs', 'w').write('5')\n"  # the peak so far is forgotten
        "ours.fitter(case)(); print(status('VmHWM') - before)\n"
    )
    return float(_child(text, os.environ.copy()).split()[-1])


def first_results() -> dict[str, float]:
    """Seconds from the end of the imports to the first result of `fit` in a new process, with an empty and a filled cache.

    The record is made without compiled code, so nothing of the fit is compiled before.
    """
    text = (
        "import os, time\nos.environ['GREYBOX_KERNEL'] = 'interpreted'\nfrom fits.benchmarks import ours, problems\n"
        "case = problems.pneumatic(); del os.environ['GREYBOX_KERNEL']\n"
        "began = time.perf_counter(); ours.whole_call(case)(); print(time.perf_counter() - began)\n"
    )
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"GREYBOX_CACHE": str(Path(folder) / "cache")}
        return {state: float(_child(text, environment).split()[-1]) for state in ("cold", "warm")}


def _child(text: str, environment: dict[str, str]) -> str:
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=True, env=environment)
    return done.stdout


def _one_row(case: Case) -> Record:
    record = to_record(case.truth, case.experiment)
    return Record(record.u, record.y, record.h, np.zeros_like(record.row), record.lengths)
