"""Finding a compiler, the cache of compiled libraries, and what happens without either."""

import multiprocessing
import os
import stat
import subprocess
import sys
import time
import warnings
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import greybox.simulation.kernel.make_kernel as kernels
from greybox.simulation.integrators.step import Step
from greybox.simulation.kernel import c_compiler as compiling
from greybox.simulation.kernel.c_compiler import COMPILE_MEMORY, CachePolicy, CompilerError, GreyboxWarning
from greybox.simulation.kernel.compiled import CompiledKernel
from greybox.simulation.kernel.interface import KernelPoint
from greybox.simulation.kernel.make_kernel import make_kernel
from greybox.simulation.kernel.record import Record
from greybox.simulation.kernel.tape import UnsupportedOperationError
from tests.support.child import is_alive

RECORD = Record(np.zeros((4, 1)), np.zeros((4, 1)), np.ones(3), np.zeros(3, np.int32), np.ones(1))


@pytest.fixture(autouse=True)
def fresh(monkeypatch, tmp_path):
    """An empty cache and nothing remembered from other tests; every kernel asks the compiler at once."""
    monkeypatch.setenv("GREYBOX_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("GREYBOX_KERNEL", raising=False)
    monkeypatch.setattr(kernels, "_warned", set())
    monkeypatch.setattr(kernels, "GradualKernel", compile_at_once)
    forget()
    yield
    forget()


def compile_at_once(step, free, on_failure):
    kernel = CompiledKernel(step, free)
    kernel.compile_simulation()
    return kernel


def forget():
    kernels._make_compiled.cache_clear()
    kernels._make_fallback.cache_clear()
    compiling._find_compiler.cache_clear()
    compiling._writable.cache_clear()


def halving(factor=0.5, term=None):
    x, u, q, p, h = ca.SX.sym("x"), ca.SX.sym("u"), ca.SX.sym("q"), ca.SX.sym("p"), ca.SX.sym("h")
    advance = ca.Function("advance", [x, u, ca.SX.sym("ub"), q, h], [factor * q * x if term is None else term(x)])
    return Step("halving", advance, ca.Function("outputs", [x, u, p], [x]), lambda p, h: (p[None], np.eye(1)[None]))


def run(kernel):
    return kernel.simulate(RECORD, np.ones((1, 1)), np.zeros(1), np.ones(1))[0].ravel().tolist()


def sums(kernel):
    dq, dp, dx0 = np.zeros((1, 1, 1)), np.zeros((1, 1)), np.ones((1, 1))
    return kernel.sums(RECORD, KernelPoint(np.ones((1, 1)), dq, np.zeros(1), dp, np.ones(1), dx0), np.ones(1))


def write_compiler(path, lines):
    """A program that stands in for a compiler; ``lines`` decide, ``go_on()`` hands over to the real one."""
    head = f"""#!{sys.executable}
import os, subprocess, sys
from pathlib import Path
count = Path({str(path)!r} + ".count")
is_asked = "--version" in sys.argv
if not is_asked:
    count.write_text(str(1 + int(count.read_text() if count.exists() else 0)))
def go_on():
    sys.exit(subprocess.run(["cc", *sys.argv[1:]]).returncode)
"""
    path.write_text(head + lines)
    path.chmod(0o755)
    return str(path)


def run_in_process(folder, barrier, answers):
    os.environ["GREYBOX_CACHE"] = folder
    barrier.wait()
    kernel = make_kernel(halving())
    answers.put((kernel.name, run(kernel)))


def test_second_kernel_does_not_compile_again(monkeypatch):
    commands = []
    original = compiling._run
    monkeypatch.setattr(
        compiling, "_run", lambda command, *timeout: commands.append(command) or original(command, *timeout)
    )
    first = make_kernel(halving())
    assert first.name == "compiled"
    assert run(first) == [1, 0.5, 0.25, 0.125]
    assert len(commands) == 2  # --version and one library
    forget()  # as a new process would start
    assert run(make_kernel(halving())) == [1, 0.5, 0.25, 0.125]
    assert len(commands) == 2
    assert run(make_kernel(halving(0.25))) == [1, 0.25, 0.0625, 0.015625]
    assert len(commands) == 3


def test_library_depends_on_the_machine(monkeypatch, tmp_path):
    make_kernel(halving())
    monkeypatch.setattr(compiling, "describe_machine", lambda: "another processor")
    make_kernel(halving())
    assert len(list((tmp_path / "cache").glob(f"*{compiling.SUFFIX}"))) == 2


def test_cache_holds_no_leftovers(tmp_path):
    make_kernel(halving())
    assert sorted(path.suffix for path in (tmp_path / "cache").iterdir()) == [".json", ".sha256", compiling.SUFFIX]


@pytest.mark.parametrize("damage", ["cut short", "empty", "one byte", "no digest"])
def test_a_damaged_library_is_compiled_anew(tmp_path, damage):
    first = make_kernel(halving())
    (library,) = (tmp_path / "cache").glob(f"*{compiling.SUFFIX}")
    good = library.read_bytes()
    library.unlink()  # this process still has the old file open
    spoilt = bytearray(good)
    spoilt[len(good) // 2] ^= 1
    library.write_bytes(
        {"cut short": good[: len(good) // 2], "empty": b"", "one byte": spoilt, "no digest": good}[damage]
    )
    if damage == "no digest":
        library.with_suffix(".sha256").unlink()
    again = make_kernel(halving())
    assert again.name == "compiled"
    assert run(again) == run(first) == [1, 0.5, 0.25, 0.125]
    assert library.read_bytes() == good  # the same source gives the same library
    assert make_kernel(halving()).name == "compiled"


@pytest.mark.parametrize("text", ["int nothing;", "int simulate(void) { return 0; }", ""])
def test_a_library_that_was_not_made_of_its_whole_text_is_refused_and_not_kept(tmp_path, text):
    """A compiler that loses its input once makes no traceback of every later fit."""
    flag, cc = tmp_path / "broken", tmp_path / "cc"
    flag.touch()
    (tmp_path / "other.c").write_text(text)
    real = compiling.find_compiler().command[0]
    cc.write_text(
        "#!/bin/bash\n"
        f'[ "$1" = --version ] && exec {real} --version\n'
        'out=; for a in "$@"; do [ "$p" = -o ] && out=$a; p=$a; done\n'
        f"[ -e {flag} ] && exec {real} -shared -fPIC -o $out {tmp_path}/other.c\n"
        f'exec {real} "$@"\n'
    )
    cc.chmod(0o755)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CC", str(cc))
        patch.setenv("GREYBOX_CACHE", str(tmp_path / "cache"))
        source = '__attribute__((visibility("default"))) int answer(void) { return 42; }'
        with pytest.raises(CompilerError, match="without the functions of its text"):
            compiling.load_library(lambda: source, "a text")
        flag.unlink()
        assert compiling.load_library(lambda: source, "a text").answer() == 42


@pytest.mark.rest
def test_two_processes_may_compile_the_same_kernel_at_once(tmp_path):
    context = multiprocessing.get_context("spawn")
    barrier, answers = context.Barrier(2), context.Queue()
    processes = [
        context.Process(target=run_in_process, args=(str(tmp_path / "shared"), barrier, answers)) for _ in range(2)
    ]
    for process in processes:
        process.start()
    results = [answers.get(timeout=60) for _ in processes]
    for process in processes:
        process.join(timeout=60)
    assert results == [("compiled", [1, 0.5, 0.25, 0.125])] * 2
    assert len(list((tmp_path / "shared").glob(f"*{compiling.SUFFIX}"))) == 1


def test_cache_that_cannot_be_written_is_replaced_by_a_temporary_one(monkeypatch, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("a file, where a folder should be")  # permissions do not stop the superuser
    monkeypatch.setenv("GREYBOX_CACHE", str(blocked / "cache"))
    kernel = make_kernel(halving())
    assert kernel.name == "compiled"
    assert run(kernel) == [1, 0.5, 0.25, 0.125]
    assert compiling.find_cache_folder() == compiling.find_cache_folder() != blocked / "cache"


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="the superuser writes everywhere")
def test_read_only_cache_is_replaced_by_a_temporary_one(monkeypatch, tmp_path):
    folder = tmp_path / "readonly"
    folder.mkdir()
    folder.chmod(stat.S_IRUSR | stat.S_IXUSR)
    monkeypatch.setenv("GREYBOX_CACHE", str(folder))
    assert make_kernel(halving()).name == "compiled"
    assert not list(folder.iterdir())


def test_broken_compiler_warns_once_and_falls_back(monkeypatch):
    monkeypatch.setenv("CC", "/bin/false")
    with pytest.warns(GreyboxWarning, match=r"C compiler /bin/false .*without compiled code") as caught:
        kernel = make_kernel(halving())
    assert len(caught) == 1
    assert kernel.name == "interpreted"
    assert "/bin/false" in kernel.reason
    assert run(kernel) == [1, 0.5, 0.25, 0.125]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert make_kernel(halving()).name == "interpreted"


def test_a_compiler_that_cannot_compile_falls_back(monkeypatch, tmp_path):
    script = tmp_path / "odd-cc"
    script.write_text(
        f"#!{sys.executable}\nimport sys\nsys.exit('' if '--version' in sys.argv else 'error: out of ink')\n".replace(
            "''", "0"
        )
    )
    script.chmod(0o755)
    monkeypatch.setenv("CC", str(script))
    with pytest.warns(GreyboxWarning, match="out of ink"):
        assert make_kernel(halving()).name == "interpreted"
    monkeypatch.setenv("GREYBOX_KERNEL", "compiled")
    with pytest.raises(CompilerError, match="out of ink"):
        make_kernel(halving())


def test_without_a_compiler_the_interpreted_kernel_is_taken_silently(monkeypatch, tmp_path):
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(compiling.importlib.util, "find_spec", lambda name: None)
    kernel = make_kernel(halving())  # no warning: nothing is broken
    assert kernel.name == "interpreted"
    assert "no C compiler" in kernel.reason
    assert "no C compiler" in kernel.description


def test_missing_compiler_is_named(monkeypatch):
    monkeypatch.setenv("CC", "no-such-compiler -O1")
    monkeypatch.setenv("GREYBOX_KERNEL", "compiled")
    with pytest.raises(CompilerError, match="CC=no-such-compiler -O1: no such program"):
        make_kernel(halving())


def test_an_operation_without_a_c_form_falls_back(monkeypatch):
    step = halving(term=lambda x: ca.erfinv(x / 2))
    with pytest.warns(GreyboxWarning, match=r"OP_ERFINV\) cannot be written in C"):
        kernel = make_kernel(step)
    dq, dp, dx0 = np.zeros((1, 1, 1)), np.zeros((1, 1)), np.ones((1, 1))
    _, jacobian = kernel.residuals(
        RECORD.first(2), KernelPoint(np.ones((1, 1)), dq, np.zeros(1), dp, np.ones(1), dx0), np.ones(1)
    )
    # d erfinv(z)/dz = sqrt(pi)/2 exp(erfinv(z)^2)
    assert jacobian[1, 0, 0] == pytest.approx(-np.sqrt(np.pi) / 4 * np.exp(0.4769362762044699**2), rel=1e-10)
    monkeypatch.setenv("GREYBOX_KERNEL", "compiled")
    with pytest.raises(UnsupportedOperationError, match="OP_ERFINV"):
        make_kernel(step)


def test_default_cache_follows_the_platform(monkeypatch, tmp_path):
    monkeypatch.delenv("GREYBOX_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(sys, "platform", "linux")
    assert compiling.find_cache_folder() == tmp_path / "greybox"


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("sys.exit('cc1: error: out of memory')", "out of memory"),
        (
            "Path(sys.argv[sys.argv.index('-o') + 1]).write_bytes(b'no library'); sys.exit(0)",
            "without the functions of its text",
        ),
        ("sys.exit(0)", "ended with code 0"),
        ("sys.exit('error: \\x1b[31mred\\x07')", "error"),
    ],
)
def test_a_compiler_that_fails_in_the_middle_of_a_fit_leads_to_the_interpreted_kernel(
    monkeypatch, tmp_path, fault, message
):
    wrapper = write_compiler(tmp_path / "tired-cc", f"if is_asked or count.read_text() == '1':\n    go_on()\n{fault}\n")
    monkeypatch.setenv("CC", wrapper)
    kernel = make_kernel(halving())
    expected = sums(kernels.InterpretedKernel(halving()))
    assert kernel.name == "compiled"
    with pytest.warns(GreyboxWarning, match=message) as caught:
        result = sums(kernel)
    assert len(caught) == 1
    assert "\x1b" not in str(caught[0].message)
    assert kernel.name == "interpreted"
    assert message in kernel.reason
    np.testing.assert_allclose(result.gauss_newton, expected.gauss_newton)
    with warnings.catch_warnings():  # the next model fails too, and that was said
        warnings.simplefilter("error")
        again = make_kernel(halving(0.125))
        np.testing.assert_allclose(sums(again).cost, sums(kernels.InterpretedKernel(halving(0.125))).cost)
    assert again.name == "interpreted"


def test_with_substeps_the_fallback_is_kept(monkeypatch, tmp_path):
    wrapper = write_compiler(
        tmp_path / "tired-cc", "if is_asked or count.read_text() == '1':\n    go_on()\nsys.exit(3)\n"
    )
    monkeypatch.setenv("CC", wrapper)
    kernel = make_kernel(halving()).with_substeps(2)
    with pytest.warns(GreyboxWarning):
        sums(kernel)
    assert kernel.name == kernel.with_substeps(1).name == "interpreted"


@pytest.mark.parametrize(("cc", "works"), [(" ", True), ('gcc "', False), ("/", False), ("gcc'", False), ("\t", True)])
def test_an_odd_name_of_a_compiler_is_no_traceback(monkeypatch, cc, works):
    monkeypatch.setenv("CC", cc)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        kernel = make_kernel(halving())
    assert (kernel.name == "compiled") == works
    assert len(caught) == (not works)
    assert run(kernel) == [1, 0.5, 0.25, 0.125]


@pytest.mark.parametrize("text", ["null", "5", "[]", '"x"', '{"a": 1}', "[" * 100_000, "\x00", "{}", '{"a"', "\udcff"])
def test_a_damaged_list_of_compilers_is_written_anew(tmp_path, text):
    (tmp_path / "cache").mkdir(mode=0o700)
    file = tmp_path / "cache" / "compilers.json"
    file.write_text(text, encoding="utf-8", errors="surrogateescape")
    file.chmod(0o600)
    assert make_kernel(halving()).name == "compiled"
    assert "version" in file.read_text() or "cc" in file.read_text()


def test_folders_in_the_place_of_files_do_no_harm(monkeypatch, tmp_path):
    make_kernel(halving())
    names = [path.name for path in (tmp_path / "cache").iterdir()]
    monkeypatch.setenv("GREYBOX_CACHE", str(tmp_path / "other"))
    for name in names:
        (tmp_path / "other" / name / "full").mkdir(parents=True)
    (tmp_path / "other").chmod(0o700)
    forget()
    kernels._make_compiled.cache_clear()
    kernels._make_fallback.cache_clear()
    kernel = make_kernel(halving())
    assert (kernel.name, run(kernel)) == ("compiled", [1, 0.5, 0.25, 0.125])


def test_a_full_disk_leads_to_another_folder_or_to_the_interpreted_kernel(monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(compiling, "write_file", full)
    with pytest.warns(GreyboxWarning, match="No space left on device"):
        kernel = make_kernel(halving(0.75))
    assert kernel.name == "interpreted"


def test_a_user_without_home_gets_a_temporary_cache(monkeypatch):
    for name in ("GREYBOX_CACHE", "XDG_CACHE_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)

    def unknown(*_):
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(compiling.Path, "home", unknown)
    kernel = make_kernel(halving(0.375))
    assert (kernel.name, run(kernel)[1]) == ("compiled", 0.375)


@pytest.mark.parametrize("name", ["HOME", "XDG_CACHE_HOME"])
def test_a_relative_home_is_none(monkeypatch, tmp_path, name):
    for variable in ("GREYBOX_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv(name, "relative")
    monkeypatch.setattr(sys, "platform", "linux")
    assert str(compiling._usual_cache()) == {"HOME": "None"}.get(name, str(tmp_path / ".cache" / "greybox"))


def test_a_cache_that_others_may_write_to_is_not_used(monkeypatch, tmp_path):
    folder = tmp_path / "shared"
    folder.mkdir()
    folder.chmod(0o777)
    monkeypatch.setenv("GREYBOX_CACHE", str(folder))
    with pytest.warns(GreyboxWarning, match="chmod go-w"):
        kernel = make_kernel(halving(0.625))
    assert (kernel.name, list(folder.iterdir())) == ("compiled", [])


def test_a_library_that_others_may_write_to_is_compiled_anew(tmp_path):
    make_kernel(halving(0.3125))
    (library,) = (tmp_path / "cache").glob(f"*{compiling.SUFFIX}")
    for spoilt in (library, library.with_suffix(".sha256")):
        spoilt.chmod(0o666)
        assert not compiling._is_intact(library)
        kernels._make_compiled.cache_clear()
        kernels._make_fallback.cache_clear()
        assert make_kernel(halving(0.3125)).name == "compiled"
        assert compiling._is_intact(library)


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only the superuser can give files away")
@pytest.mark.parametrize("kind", ["folder", "library"])
def test_a_cache_of_another_user_is_not_used(tmp_path, kind):
    make_kernel(halving(0.4375))
    (library,) = (tmp_path / "cache").glob(f"*{compiling.SUFFIX}")
    os.chown(library if kind == "library" else library.parent, 12345, 12345)
    forget()
    if kind == "library":
        assert not compiling._is_intact(library)
    else:
        with pytest.warns(GreyboxWarning, match="another user owns it"):
            assert compiling.find_cache_folder() != library.parent


def test_the_cache_is_pruned_by_age_and_size(tmp_path):
    day = 86_400
    now = time.time()
    for k, days in enumerate((0, 1, 2, 100)):
        file = tmp_path / f"{k}{compiling.SUFFIX}"
        file.write_bytes(bytes(1000))
        compiling._digest_path(file).write_text("")
        os.utime(file, (now - days * day,) * 2)
    for k, days in enumerate((0, 3)):
        part = tmp_path / f"part-{k}"
        part.mkdir()
        (part / "kernel.c").write_text("")
        os.utime(part, (now - days * day,) * 2)
    compiling.prune_cache(tmp_path, CachePolicy(largest_bytes=2500))
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(
        [f"{k}{suffix}" for k in (0, 1) for suffix in (compiling.SUFFIX, ".sha256")] + ["part-0"]
    )


def test_a_compiler_that_hangs_is_asked_once(monkeypatch, tmp_path):
    wrapper = write_compiler(tmp_path / "slow-cc", "import time\nif is_asked:\n    go_on()\ntime.sleep(60)\n")
    monkeypatch.setenv("CC", wrapper)
    compiler = compiling.find_compiler()
    monkeypatch.setattr(compiling, "find_compiler", lambda: replace(compiler, timeout=0.5))
    # Counted here: on a busy machine half a second may end before the program has begun.
    asked, run_program = [], compiling._run
    monkeypatch.setattr(
        compiling, "_run", lambda command, *timeout: asked.append(command[0]) or run_program(command, *timeout)
    )
    with pytest.warns(GreyboxWarning, match=r"took more than 0\.5 s"):
        assert make_kernel(halving(0.6875)).name == "interpreted"
    assert make_kernel(halving(0.8125)).name == "interpreted"
    assert asked == [wrapper]


def assert_ends(pid):
    """A program of a minute ends long before that; on a busy machine the system takes seconds to end one."""
    deadline = time.monotonic() + 30
    while is_alive(pid):
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.mark.skipif(sys.platform == "win32", reason="a group of processes of POSIX")
def test_what_a_slow_compiler_has_started_ends_with_it(tmp_path):
    """A compiler is the parent of the programs that compile."""
    wrapper = tmp_path / "cc"
    wrapper.write_text(f"#!/bin/sh\nsleep 60 & echo $! > {tmp_path}/pid\nwait\n")
    wrapper.chmod(0o700)
    # On a busy machine half a second may end before the program has begun.
    for seconds in (0.5, 5.0, 50.0):
        with pytest.raises(CompilerError, match="took more than"):
            compiling.run_compiler([str(wrapper)], seconds)
        compiling._hanging.clear()
        if (tmp_path / "pid").exists() and (tmp_path / "pid").read_text():
            break
    pid = int((tmp_path / "pid").read_text())
    assert_ends(pid)


@pytest.mark.skipif(sys.platform != "linux", reason="limits of Linux")
def test_a_compiler_may_take_so_much_memory_and_no_more():
    """Of a model with hundreds of states it takes gigabytes: the model then runs without compiled code."""
    script = "bytearray({:.0f})"
    outcomes = [
        compiling.run_compiler([sys.executable, "-c", script.format(share * COMPILE_MEMORY)]) for share in (0.3, 1.1)
    ]
    assert [run.returncode for run in outcomes] == [0, 1]
    assert "MemoryError" in outcomes[1].stderr


@pytest.mark.crossed(3)
@pytest.mark.rest
@pytest.mark.skipif(sys.platform == "win32", reason="a group of processes of POSIX")
@pytest.mark.parametrize("ending", ["os._exit(0)", "sys.exit(0)", "os.kill(os.getpid(), 9)"])
def test_a_compiler_ends_with_the_process_that_has_asked(tmp_path, ending):
    """Also one in the background, and the programs that it has started."""
    wrapper = tmp_path / "cc"
    wrapper.write_text(f"#!/bin/sh\nsleep 60 & echo $! > {tmp_path}/pid\nwait\n")
    wrapper.chmod(0o700)
    script = (
        "import os, sys, threading, time\nfrom greybox.simulation.kernel import c_compiler\n"
        f"threading.Thread(target=c_compiler.run_compiler, args=([{str(wrapper)!r}],), daemon=True).start()\n"
        f"note = {str(tmp_path / 'pid')!r}\n"
        "while not (os.path.exists(note) and open(note).read()): time.sleep(0.02)\n"
        f"{ending}"
    )
    subprocess.run([sys.executable, "-c", script], timeout=100, check=False)
    pid = int((tmp_path / "pid").read_text())
    assert_ends(pid)


@pytest.mark.skipif(not hasattr(os, "getloadavg"), reason="the system does not say how busy it is")
def test_the_time_of_a_compiler_is_that_of_an_idle_processor(monkeypatch):
    """Ten programs on each processor give it ten times as long."""
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    monkeypatch.setattr(os, "getloadavg", lambda: (20.0, 20.0, 20.0))
    assert compiling.run_compiler(["sleep", "0.4"], timeout=0.1, is_background=True).returncode == 0
    monkeypatch.setattr(os, "getloadavg", lambda: (0.1, 0.1, 0.1))
    with pytest.raises(compiling.CompilerBudgetError, match="took more than"):
        compiling.run_compiler(["sleep", "0.4"], timeout=0.1, is_background=True)


@pytest.mark.skipif(not Path("/proc/cpuinfo").exists(), reason="the processor is described elsewhere")
def test_a_processor_is_told_by_what_it_can_do():
    lines = Path("/proc/cpuinfo").read_text().split("\n\n")[0].splitlines()
    abilities = [
        line.strip() for line in lines if line.partition(":")[0].strip().lower() in ("flags", "features", "isa")
    ]
    assert abilities and all(line in compiling.describe_machine().splitlines() for line in abilities)
