"""The tape machine against compiled code, to the bit; how a structure earns its libraries; what happens where they cannot be had."""

import functools
import gc
import itertools
import time
import types
import warnings
import weakref

import numpy as np
import pytest

import greybox as gb
from greybox.simulation.integrators.exact_hold import exact_hold
from greybox.simulation.integrators.runge_kutta import rk4
from greybox.simulation.kernel import c_compiler as compiling
from greybox.simulation.kernel import gradual, llvm_routine
from greybox.simulation.kernel.compiled import CompiledKernel
from greybox.simulation.kernel.gradual import GradualKernel, GradualPolicy
from greybox.simulation.kernel.interface import KernelPoint
from greybox.simulation.kernel.llvm_routine import has_llvm
from greybox.simulation.kernel.record import Record
from greybox.simulation.kernel.tape_machine import TapeMachine
from models.micro_actuator import micro_actuator
from tests.simulation.kernel.test_kernels import OPERATIONS, operation_step

NEVER = GradualPolicy(earned_seconds=np.inf, translated_seconds=np.inf, long_pass_seconds=np.inf)
AT_ONCE = GradualPolicy(earned_seconds=0.0, translated_seconds=0.0, full_seconds=0.0)


@pytest.fixture(autouse=True)
def shared_cache(monkeypatch, tmp_path_factory):
    monkeypatch.setenv("GREYBOX_CACHE", str(tmp_path_factory.getbasetemp() / "gradual"))
    monkeypatch.setattr(gradual, "_orders", {})


def make_record(inputs, outputs, first_order=False, rows=60):
    rng = np.random.default_rng(3)
    y = rng.normal(size=(rows, outputs))
    y[rows // 3] = np.nan  # a gap
    h = np.full(rows - 1, 1e-3)
    return Record(rng.normal(size=(rows, inputs)), y, h, np.zeros(rows - 1, np.int32), np.array([1e-3]), first_order)


def run_all(kernel, record, p, x0, directions):
    """Every array that a kernel gives."""
    rng = np.random.default_rng(4)
    dp, dx0 = rng.normal(size=(len(p), directions)), rng.normal(size=(len(x0), directions))
    q, dq = kernel.coefficients(record, p, dp)
    weight = np.full(record.y.shape[1], 0.7)
    sums = kernel.sums(record, KernelPoint(q, dq, p, dp, x0, dx0), weight)
    residuals = kernel.residuals(record, KernelPoint(q, dq, p, dp, x0, dx0), weight)
    return [q, dq, *kernel.simulate(record, q, p, x0), *residuals, sums.squares, sums.gradient, sums.gauss_newton]


def assert_same_bits(step, record, p, x0, directions):
    arguments = record, np.asarray(p), np.asarray(x0), directions
    machine = GradualKernel(step, None, pytest.fail, NEVER)
    by_machine = run_all(machine, *arguments)
    assert not machine._functions  # no library has come in its place
    for a, b in zip(by_machine, run_all(CompiledKernel(step), *arguments), strict=True):
        np.testing.assert_array_equal(a, b)
    assert np.isfinite(by_machine[-1]).all()


@pytest.fixture(params=["interpreted", "translated by LLVM"])
def machine(request, monkeypatch):
    """How the machine runs its routines, with nothing in the cache to take over."""
    monkeypatch.setattr(gradual, "find_library", lambda *_: None)
    if request.param != "interpreted":
        if not has_llvm():
            pytest.skip("without llvmlite, or a processor without fused multiply-adds")
        monkeypatch.setattr(gradual, "TapeMachine", functools.partial(TapeMachine, is_translated=True))


@pytest.mark.parametrize("name", OPERATIONS)
def test_every_operation_to_the_bit(name, machine):
    step = operation_step(OPERATIONS[name])
    step = type(step)(step.name, step.advance, step.outputs, lambda p, h, which: (p[None], np.eye(1)[None, :, which]))
    for x0 in ([0.6, 1.7], [1.3, 0.8]):
        assert_same_bits(step, make_record(1, 2, rows=2), [1.1], x0, 3)


@pytest.mark.parametrize(
    ("effect", "directions"),
    [("coulomb_friction", 1), ("coulomb_friction", 18), ("quadratic_damping", 5), ("quadratic_damping", 13)],
)
def test_a_model_with_an_effect_to_the_bit(effect, directions, machine):
    model = micro_actuator + gb.effect(effect)
    p = np.array(list(model.values.values()))
    x0 = np.zeros(model.system.x.numel())
    assert_same_bits(rk4(model.system, 3, None), make_record(1, len(model.outputs), True), p, x0, directions)


def test_an_exact_hold_to_the_bit(machine):
    p = np.array(list(micro_actuator.values.values()))
    step = exact_hold(micro_actuator.system)
    assert_same_bits(step, make_record(1, len(micro_actuator.outputs)), p, np.zeros(step.advance.size1_in(0)), 4)


def wait_for(condition):
    end = time.monotonic() + 60
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)
    assert condition()


def count_libraries(folder):
    return len(list(folder.glob(f"*{compiling.SUFFIX}")))


@pytest.mark.parametrize("is_translated", [False, True])
def test_a_structure_earns_first_quick_code_and_then_a_full_library(monkeypatch, tmp_path, is_translated):
    if is_translated and not has_llvm():
        pytest.skip("without llvmlite")
    monkeypatch.setattr(gradual, "has_llvm", lambda: is_translated)
    step, folder = rk4(micro_actuator.system, 2, None), tmp_path / "cache"
    p, x0 = np.array(list(micro_actuator.values.values())), np.zeros(3)
    record = make_record(1, len(micro_actuator.outputs))
    kernel = GradualKernel(step, None, pytest.fail, AT_ONCE)
    monkeypatch.setenv("GREYBOX_CACHE", str(folder))  # the machine is loaded already

    def simulate():
        return kernel.simulate(record, p[None], p, x0)[1]

    first = simulate()
    assert count_libraries(folder) == 0
    (course,) = kernel._courses.values()
    for order in (course.order, course.full):
        simulate()
        wait_for(lambda order=order: order.result is not None and not gradual._compiler_is_busy.locked())
        np.testing.assert_array_equal(simulate(), first)
    assert count_libraries(folder) == (1 if is_translated else 2)
    assert list(kernel._functions)  # the full library, from now on without detour
    monkeypatch.setattr(gradual, "_orders", {})  # as a new process would start
    again = GradualKernel(step, None, pytest.fail, NEVER)
    np.testing.assert_array_equal(again.simulate(record, p[None], p, x0)[1], first)
    assert list(again._functions)


@pytest.mark.rest
@pytest.mark.skipif(not has_llvm(), reason="without llvmlite")
def test_translated_routines_that_nobody_uses_any_more_are_forgotten(monkeypatch):
    monkeypatch.setattr(gradual, "find_library", lambda *_: None)
    policy = GradualPolicy(translated_seconds=0.0, full_seconds=np.inf, most_translated=2)
    record, points = make_record(1, 2, rows=4), (np.ones((1, 1)), np.zeros(1), np.array([0.5, 0.2]))
    kernels, machines, answers = [], [], []
    for k in range(4):
        kernel = GradualKernel(operation_step(lambda a, b, k=k: a * 0.3 + k * b), None, pytest.fail, policy)
        answers.append(kernel.simulate(record, *points)[1])
        (course,) = kernel._courses.values()
        kernel.simulate(record, *points)  # it is translated now
        wait_for(lambda course=course: course.order.result is not None and not gradual._compiler_is_busy.locked())
        kernels.append(kernel)
        machines.append(weakref.ref(course.order.result))
    for kernel, answer in zip(kernels, answers, strict=True):  # a kernel keeps what it works with
        np.testing.assert_array_equal(kernel.simulate(record, *points)[1], answer)
    del kernel, course, kernels
    gc.collect()
    assert [machine() is not None for machine in machines] == [False, True, True, True]
    gradual._forget_translated(4)  # there is room for one more: nothing goes
    gc.collect()
    assert [machine() is not None for machine in machines] == [False, True, True, True]
    gradual._forget_translated(2)
    gc.collect()
    assert [machine() is not None for machine in machines] == [False, False, True, True]


def make_pass(rows=60):
    """One pass with two directions over a record of the actuator."""
    p, x0 = np.array(list(micro_actuator.values.values())), np.zeros(3)
    record = make_record(1, len(micro_actuator.outputs), rows=rows)

    def run(kernel):
        dp = np.eye(len(p))[:, :2]
        return kernel.sums(
            record, KernelPoint(p[None], dp[None], p, dp, x0, np.zeros((3, 2))), np.ones(record.y.shape[1])
        )

    return run


def test_a_long_pass_orders_its_library_first_and_waits_no_longer_than_it_runs(monkeypatch, tmp_path):
    step, run = rk4(micro_actuator.system, 2, None), make_pass()
    monkeypatch.setattr(gradual, "has_llvm", lambda: False)
    monkeypatch.setenv("GREYBOX_CACHE", str(tmp_path / "cache"))
    expected = run(GradualKernel(step, None, pytest.fail, NEVER)).gradient
    release, waits = gradual.threading.Event(), []
    load, wait = gradual.load_library, gradual.CompilerOrder.wait

    def load_late(*arguments, **options):
        release.wait(150)
        return load(*arguments, **options)

    monkeypatch.setattr(gradual, "load_library", load_late)
    monkeypatch.setattr(
        gradual.CompilerOrder, "wait", lambda order, seconds: waits.append(seconds) or wait(order, seconds)
    )
    kernel = GradualKernel(step, None, pytest.fail, GradualPolicy(earned_seconds=0.0, long_pass_seconds=0.0))
    np.testing.assert_array_equal(run(kernel).gradient, expected)  # the machine, after a wait of its own length
    (course,) = kernel._courses.values()
    assert course.order.result is None
    instructions = 60 * step.substeps * course.machine.instructions
    assert waits == [pytest.approx(gradual.WAITED_SHARE * instructions * gradual.SECONDS_OF_INSTRUCTION)]
    assert gradual.WAITED_SHARE <= 1
    release.set()
    wait_for(lambda: course.order.result is not None and not gradual._compiler_is_busy.locked())
    np.testing.assert_array_equal(run(kernel).gradient, expected)


def test_a_compiler_that_is_given_up_is_remembered_by_the_next_program(monkeypatch, tmp_path):
    step, run = rk4(micro_actuator.system, 2, None), make_pass()
    monkeypatch.setattr(gradual, "has_llvm", lambda: False)
    monkeypatch.setenv("GREYBOX_CACHE", str(tmp_path / "cache"))
    asked = []

    def give_up(*_, **__):
        asked.append(1)
        raise compiling.CompilerBudgetError("took more than its time")

    monkeypatch.setattr(gradual, "load_library", give_up)
    # Every call takes one second of this clock: what is earned is counted in passes, however busy the machine is.
    monkeypatch.setattr(gradual, "time", types.SimpleNamespace(perf_counter=itertools.count().__next__))
    policy = GradualPolicy(earned_seconds=0.0)
    answers = []
    for _ in range(3):
        monkeypatch.setattr(gradual, "_orders", {})  # as a new program would start
        kernel = GradualKernel(step, None, pytest.fail, policy)  # nobody is told: the machine is no failure
        for _ in range(2):
            answers.append(run(kernel).gradient)
            wait_for(lambda: not gradual._compiler_is_busy.locked())
    assert len(asked) == 1
    for answer in answers:
        np.testing.assert_array_equal(answer, answers[0])
    # Once its work has taken several times as long the compiler is asked again.
    monkeypatch.setattr(gradual, "_orders", {})
    kernel = GradualKernel(step, None, pytest.fail, policy)

    def is_asked_again() -> bool:
        run(kernel)
        wait_for(lambda: not gradual._compiler_is_busy.locked())
        return len(asked) > 1

    wait_for(is_asked_again)
    assert len(asked) == 2


def test_a_library_that_fails_leaves_the_machine_at_work(monkeypatch, tmp_path):
    failures = []
    step = operation_step(lambda a, b: a * 0.3 + b)
    kernel = GradualKernel(step, None, failures.append, AT_ONCE)
    monkeypatch.setenv("GREYBOX_CACHE", str(tmp_path / "cache"))

    def fail(*_, **__):
        raise compiling.CompilerError("out of ink")

    monkeypatch.setattr(gradual, "load_library", fail)
    monkeypatch.setattr(gradual, "has_llvm", lambda: False)
    record = make_record(1, 2, rows=4)
    arguments = record, np.ones((1, 1)), np.zeros(1), np.array([0.5, 0.2])
    first = kernel.simulate(*arguments)[1]
    kernel.simulate(*arguments)
    wait_for(lambda: not gradual._compiler_is_busy.locked())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for _ in range(3):
            np.testing.assert_array_equal(kernel.simulate(*arguments)[1], first)
    assert [str(error) for error in failures] == ["out of ink"]


def test_llvm_that_cannot_be_loaded_is_done_without(monkeypatch):
    """As with little memory: llvmlite is installed, and its library cannot be mapped."""

    def starve():
        raise OSError("Could not find/load shared object file")

    monkeypatch.setattr(llvm_routine.importlib.util, "find_spec", lambda _: object())
    monkeypatch.setattr(llvm_routine, "_load_llvm", starve)
    assert not has_llvm.__wrapped__()
