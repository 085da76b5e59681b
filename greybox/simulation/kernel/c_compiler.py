"""C source -> loaded library: find a compiler, compile once for each machine, keep the result in the user's cache.

Environment: ``CC`` names the compiler (else ``cc``, ``gcc``, ``clang`` on the path, else the package ``ziglang``);
``GREYBOX_CACHE`` the folder of the compiled libraries.

A library is loaded into the process, so folder and files must belong to the user and be writable by nobody else; a cache that is not
private, full or broken gives way to a temporary folder. Whatever else fails is a CompilerError.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import hashlib
import importlib.metadata
import importlib.util
import json
import os
import platform
import shlex
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from greybox.base import GreyboxError, shorten, write_file


@dataclass(frozen=True)
class CachePolicy:
    """How large the cache of compiled kernels may become, and what is kept."""

    largest_bytes: int = 500_000_000
    """Size of all libraries together; the ones that were used longest ago go first. A library takes 20 to 200 kB, a search makes thirty."""


CACHE_POLICY = CachePolicy()


# Without errno and traps the compiler may use vector instructions; no -ffast-math, so that NaN and infinity keep their
# meaning. Packing scalars into vectors by itself (slp) only lengthens the recursion that everything waits for.
FLAGS = (
    "-march=native",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-fno-tree-slp-vectorize",
    "-std=gnu11",
    "-shared",
)
FULL = ("-O3",)
# Half the time of -O3 for code that takes a tenth longer. Without expensive optimisations GCC leaves out the instruction that ends wide
# vectors before a call of the mathematical library, which then runs several times slower.
QUICK_GCC = ("-O1", "-fexpensive-optimizations", "-fno-tree-pta", "-fira-region=one")
QUICK = ("-O1",)
WASTED = ".wasted"
SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")


class GreyboxWarning(UserWarning):
    """Something works, but not as well as it could."""


class CompilerError(GreyboxError):
    """The C compiler is missing or failed."""


class CompilerBudgetError(CompilerError):
    """The compiler was given up: it took more time or memory than it may."""


class NoCompilerError(CompilerError):
    """There is no C compiler on this machine."""


# Seconds of an idle processor after which a compilation is given up: few models are fitted for as long as a longer text takes, and what is
# waited for, the tape machine, takes half a second of one.
COMPILE_SECONDS = 60.0


@dataclass(frozen=True)
class Compiler:
    """A C compiler: its command, the version text that it gives, and the seconds after which a run is given up."""

    command: tuple[str, ...]
    version: str
    timeout: float = COMPILE_SECONDS
    is_background: bool = False
    """Whether nobody waits for it."""


def load_library(
    source: Callable[[], str], key: str, is_quick: bool = False, is_background: bool = False
) -> ctypes.CDLL:
    """The library compiled from the C text that ``source()`` writes, from the cache where it is there already.

    ``key`` says what the text is made from: it is not written where a library of that key is there. ``is_quick``: compile in half the
    time what runs a tenth slower. ``is_background``: nobody waits for it; a compiler that was waited for and hangs is not asked again.
    Raises CompilerError.
    """
    compiler = replace(find_compiler(), is_background=is_background)
    flags = _flags(compiler, is_quick)
    name = _name_of_library(compiler, flags, key)
    try:
        return _load(find_cache_folder() / name, compiler, flags, source)
    except OSError:  # a full or a broken disk: another one may do
        with _as_compiler_error("no folder for compiled kernels can be written"):
            return _load(_temporary_folder() / name, compiler, flags, source)


def find_library(key: str, is_quick: bool = False) -> ctypes.CDLL | None:
    """The library of `load_library` if it was compiled before, else None. Raises CompilerError where there is no compiler."""
    compiler = find_compiler()
    with contextlib.suppress(OSError):
        return _load_cached(find_cache_folder() / _name_of_library(compiler, _flags(compiler, is_quick), key))
    return None


def _flags(compiler: Compiler, is_quick: bool) -> tuple[str, ...]:
    is_gcc = "Free Software Foundation" in compiler.version
    level = FULL if not is_quick else QUICK_GCC if is_gcc else QUICK
    return (*level, *FLAGS, *(() if sys.platform == "win32" else ("-fPIC",)))


def _name_of_library(compiler: Compiler, flags: Sequence[str], key: str) -> str:
    # All that the machine code depends on: equations, generator, flags, compiler, processor. Nothing has to be
    # cleared by hand.
    cache_key = "\0".join([key, hash_generator(), *flags, *compiler.command, compiler.version, describe_machine()])
    return f"{hashlib.sha256(cache_key.encode(errors='backslashreplace')).hexdigest()}{SUFFIX}"


# What was compiled in vain: a program that ends, or a compiler that is given up, leaves nothing but the time that it took. Each kernel has
# a small file with the seconds that its work must take before a compiler is started again.

# Growth of these seconds from one attempt in vain to the next: all of them together cost no more than the work has.
GROWTH_OF_PATIENCE = 4.0


def find_wasted_seconds(key: str, kind: str) -> float:
    """The seconds that the work of a kernel must take before it is compiled once more; zero where no attempt was in vain."""
    with contextlib.suppress(OSError, ValueError):
        path = _wasted_path(key, kind)
        if _is_private(path, stat.S_ISREG):
            return float(path.read_text(encoding="utf-8"))
    return 0.0


def note_wasted_seconds(key: str, kind: str, seconds: float) -> None:
    """Let a kernel that is compiled after ``seconds`` of its work count as compiled in vain, until `forget_wasted_seconds`."""
    with contextlib.suppress(OSError):  # without a folder nothing is remembered
        write_file(
            _wasted_path(key, kind),
            repr(GROWTH_OF_PATIENCE * max(seconds, find_wasted_seconds(key, kind))),
            private=True,
        )


def forget_wasted_seconds(key: str, kind: str) -> None:
    """What was compiled is there."""
    with contextlib.suppress(OSError):
        _wasted_path(key, kind).unlink()


def _wasted_path(key: str, kind: str) -> Path:
    text = "\0".join([key, kind, hash_generator(), describe_machine()])
    return find_cache_folder() / f"{hashlib.sha256(text.encode(errors='backslashreplace')).hexdigest()}{WASTED}"


def _load_cached(path: Path) -> ctypes.CDLL | None:
    if _is_intact(path):
        with contextlib.suppress(OSError):  # another process may have cleared it away meanwhile
            library = ctypes.CDLL(str(path))
            # By this time the oldest go first when the cache is full.
            os.utime(path)  # used last now
            return library
    return None


def _load(path: Path, compiler: Compiler, flags: Sequence[str], source: Callable[[], str]) -> ctypes.CDLL:
    """The library at ``path``, compiled where it is not there. Raises OSError where it cannot be kept, CompilerError."""
    library = _load_cached(path)
    if library is not None:
        return library
    _compile(compiler, flags, source(), path)
    # Once in a process: a search compiles some thirty kernels.
    if path.parent not in _pruned:
        _pruned.add(path.parent)
        with contextlib.suppress(OSError):
            prune_cache(path.parent)
    try:
        return ctypes.CDLL(str(path))
    except OSError as error:
        raise CompilerError(
            f"compiled kernel {path} cannot be loaded: {error}; delete it, or set GREYBOX_KERNEL=interpreted"
        ) from error


def find_compiler() -> Compiler:
    """The C compiler of this machine. Raises CompilerError if there is none or ``CC`` does not work."""
    return _find_compiler(os.environ.get("CC", ""), os.environ.get("PATH", ""))


def find_cache_folder() -> Path:
    """Where compiled libraries are kept; a temporary folder for this process if the usual one cannot be used.

    Raises OSError where there is no folder that can be written at all.
    """
    usual = _usual_cache()
    return _temporary_folder() if usual is None else _writable(usual)


# Days after which a library that nobody used goes: a project that rests for a quarter compiles anew in a minute.
LONGEST_UNUSED_DAYS = 90.0
# Days after which the folder of a compilation that was killed goes: no compiler works so long.
LEFTOVER_DAYS = 1.0


def prune_cache(folder: Path, policy: CachePolicy = CACHE_POLICY) -> None:
    """Delete libraries that were not used for long, then those used longest ago until the rest is small enough."""
    now = time.time()
    libraries: list[tuple[float, int, Path]] = []
    for path in folder.iterdir():
        with contextlib.suppress(OSError):  # cleared away by another process, or not ours to delete
            status = path.lstat()
            days = (now - status.st_mtime) / 86_400
            if path.name.startswith("part-") and days > LEFTOVER_DAYS:
                shutil.rmtree(path, ignore_errors=True)
            elif path.suffix == WASTED and days > LONGEST_UNUSED_DAYS:
                path.unlink()
            elif path.suffix == SUFFIX:
                libraries.append((status.st_mtime, status.st_size, path))
    kept = 0
    # Newest first: what comes after the limit is what was used longest ago.
    for used, size, path in sorted(libraries, reverse=True):
        kept += size
        if kept > policy.largest_bytes or now - used > LONGEST_UNUSED_DAYS * 86_400:
            for file in (path, _digest_path(path)):
                with contextlib.suppress(OSError):
                    file.unlink()


@lru_cache
def hash_generator() -> str:
    """What distinguishes one version of the program that writes the C text from another: its own text."""
    digest = hashlib.sha256()
    for file in sorted(Path(__file__).parent.rglob("*")):
        # Any change of this package may change the text that it writes.
        if file.suffix in (".py", ".c", ".h"):
            digest.update(file.read_bytes())
    return digest.hexdigest()


@lru_cache
def describe_machine() -> str:
    """Processor model and instruction sets: a library compiled for one may not run on another."""
    text = [platform.machine(), platform.system(), os.environ.get("PROCESSOR_IDENTIFIER", "")]
    if sys.platform == "linux":
        with contextlib.suppress(OSError), open("/proc/cpuinfo", encoding="utf-8", errors="replace") as file:
            for line in file:
                if not line.strip():
                    break  # the first core is enough
                if line.partition(":")[0].strip().lower() in ("model name", "flags", "features", "cpu part", "isa"):
                    text.append(line.strip())
    elif sys.platform == "darwin":
        with contextlib.suppress(OSError, subprocess.SubprocessError):
            text.append(_run(["sysctl", "-n", "machdep.cpu.brand_string"]).stdout.strip())
    return "\n".join(text)


@lru_cache
def choose_vector_width(directions: int) -> int:
    """Doubles in one block of tangents: a vector register, or half of an AVX-512 one (the faster half) unless there are many."""
    words = set(describe_machine().lower().split())
    if "avx512f" in words:
        return 8 if directions > 16 else 4
    known_x86 = platform.machine().lower() in ("x86_64", "amd64")
    return 4 if "avx" in words or (known_x86 and sys.platform != "linux") else 2


def _usual_cache() -> Path | None:
    """The folder that the user or the platform has for it; None where the user has no home."""
    given = os.environ.get("GREYBOX_CACHE")
    if given:
        return Path(given)
    if sys.platform == "win32" and os.environ.get("LOCALAPPDATA"):
        return Path(os.environ["LOCALAPPDATA"]) / "greybox"
    if sys.platform not in ("win32", "darwin") and Path(os.environ.get("XDG_CACHE_HOME", "")).is_absolute():
        return Path(os.environ["XDG_CACHE_HOME"]) / "greybox"
    try:
        home = Path.home()
    except RuntimeError:  # no HOME, and a user whom the machine does not know, as in a container
        return None
    if not home.is_absolute():
        return None
    return home / {"win32": "AppData/Local", "darwin": "Library/Caches"}.get(sys.platform, ".cache") / "greybox"


@lru_cache
def _writable(folder: Path) -> Path:
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        # Tried, not asked for: rights say nothing of a full disk or one that is mounted read-only.
        with tempfile.TemporaryFile(dir=folder):
            pass
    except (OSError, ValueError):
        return _temporary_folder()
    if _is_private(folder, stat.S_ISDIR):
        return folder
    warnings.warn(
        f"kernel cache {folder}: another user owns it or may write to it, so it is not used and kernels are compiled anew in every"
        " process; take the right away (chmod go-w), or set GREYBOX_CACHE to a folder of your own",
        GreyboxWarning,
        stacklevel=2,
    )
    return _temporary_folder()


def _temporary_folder() -> Path:
    """A folder of this process; held by the module, hence removed when the process ends."""
    if not _temporary or not Path(_temporary[-1].name).is_dir():
        _temporary.append(tempfile.TemporaryDirectory(prefix="greybox-", ignore_cleanup_errors=True))
    return Path(_temporary[-1].name)


_temporary: list[tempfile.TemporaryDirectory[str]] = []
_pruned: set[Path] = set()


def _is_private(path: Path, is_kind: Callable[[int], bool]) -> bool:
    """Whether a file or folder is of this kind, belongs to the user and is writable by nobody else. Windows has no such mode."""
    try:
        status = path.stat() if is_kind is stat.S_ISDIR else path.lstat()
    except OSError:
        return False
    if not hasattr(os, "geteuid"):
        return is_kind(status.st_mode)
    # A library is code: one that somebody else may replace would run with this user's rights.
    others_write = status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return is_kind(status.st_mode) and status.st_uid == os.geteuid() and not others_write


@contextlib.contextmanager
def _as_compiler_error(what: str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise CompilerError(f"{what}: {error}") from error


@lru_cache
def _find_compiler(cc: str, path: str) -> Compiler:
    if cc.strip():
        try:
            command = shlex.split(cc, posix=os.name != "nt")
        except ValueError as error:
            raise CompilerError(f"CC={cc}: {error}; set CC to a C compiler, or unset it") from None
        program = shutil.which(command[0], path=path)
        if program is None:
            raise CompilerError(f"CC={cc}: no such program on the path; set CC to a C compiler, or unset it")
        return Compiler((program, *command[1:]), _version((program, *command[1:])))
    for name in ("cc", "gcc", "clang"):
        program = shutil.which(name, path=path)
        if program is not None:
            return Compiler((program,), _version((program,)))
    if importlib.util.find_spec("ziglang") is not None:
        zig = (sys.executable, "-m", "ziglang", "cc")
        return Compiler(zig, importlib.metadata.version("ziglang"))
    raise NoCompilerError(
        "no C compiler (cc, gcc, clang) on the path; install one, or the package ziglang, for fits many times as fast"
    )


def _version(command: tuple[str, ...]) -> str:
    """What ``--version`` says, remembered as long as the program is the same file."""
    program = os.path.realpath(command[0])
    with _as_compiler_error(f"C compiler {' '.join(command)} cannot be read"):
        # An update of the compiler has another time of change.
        stamp = f"{' '.join(command)} {program} {os.stat(program).st_mtime_ns}"
    try:
        versions_file: Path | None = find_cache_folder() / "compilers.json"
    except OSError:  # no folder can be written: the compiler is asked each time
        versions_file = None
    versions = _read_versions(versions_file)
    if stamp not in versions:
        result = run_compiler([*command, "--version"])
        if result.returncode != 0:
            raise CompilerError(
                f"C compiler {' '.join(command)} does not work: --version ended with code {result.returncode}"
                f" {summarise_errors(result)}"
            )
        versions[stamp] = result.stdout.strip()
        if versions_file is not None:
            with contextlib.suppress(OSError):  # kept where it can be kept
                write_file(versions_file, json.dumps(versions), private=True)
    return versions[stamp]


def _read_versions(file: Path | None) -> dict[str, str]:
    """What compilers said earlier; nothing where that is not there, or damaged."""
    if file is None or not _is_private(file, stat.S_ISREG):
        return {}
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return {k: v for k, v in data.items() if isinstance(v, str)} if isinstance(data, dict) else {}


def _is_intact(path: Path) -> bool:
    """Whether the library file is the user's and complete; loading one that a full disk cut short would end the process."""
    try:
        return (
            _is_private(path, stat.S_ISREG)
            and _is_private(_digest_path(path), stat.S_ISREG)
            and _digest_path(path).read_text(encoding="utf-8") == hashlib.sha256(path.read_bytes()).hexdigest()
        )
    except (OSError, ValueError):
        return False


def _digest_path(path: Path) -> Path:
    return path.with_suffix(".sha256")


# The last name that every text defines: a library that has it was made of the whole text.
LAST_NAME = "greybox_end_of_text"
LAST_LINES = f"""
#ifdef _WIN32
__declspec(dllexport)
#else
__attribute__((visibility("default")))
#endif
extern const int {LAST_NAME};
const int {LAST_NAME} = 1;
"""


def _compile(compiler: Compiler, flags: Sequence[str], source: str, path: Path) -> None:
    """Compile beside ``path`` and rename: another process sees all of the library or none of it.

    The names of the files are the same every time, and so is the library: two processes at once may both write it.
    """
    with _part_folder(path.parent) as folder:
        text, library, digest = (folder / f"kernel{suffix}" for suffix in (".c", SUFFIX, ".sha256"))
        write_file(text, source + LAST_LINES)
        run = run_compiler(
            [*compiler.command, *flags, "-o", str(library), str(text), "-lm"], compiler.timeout, compiler.is_background
        )
        if run.returncode != 0 and "memory" in run.stderr:
            raise CompilerBudgetError(f"C compiler {' '.join(compiler.command)} {summarise_errors(run)}")
        if run.returncode != 0 or not library.exists():
            raise CompilerError(
                f"C compiler {' '.join(compiler.command)} ended with code {run.returncode} {summarise_errors(run)}"
            )
        content = library.read_bytes()
        if LAST_NAME.encode() not in content:
            raise CompilerError(
                f"C compiler {' '.join(compiler.command)} made a library without the functions of its text; set CC to another compiler"
            )
        library.chmod(0o700)
        write_file(digest, hashlib.sha256(content).hexdigest(), private=True)
        _replace(library, path)
        _replace(digest, _digest_path(path))


@contextlib.contextmanager
def _part_folder(parent: Path) -> Iterator[Path]:
    # No `TemporaryDirectory`: a copy of this process (`os.fork`) would clear it away when it ends.
    folder = Path(tempfile.mkdtemp(dir=parent, prefix="part-"))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _replace(temporary: Path, path: Path) -> None:
    try:
        os.replace(temporary, path)
    except PermissionError:  # Windows: another process has just put it there and loaded it
        if not path.exists():
            raise


def run_compiler(
    command: Sequence[str], timeout: float = COMPILE_SECONDS, is_background: bool = False
) -> subprocess.CompletedProcess[str]:
    """Run a compiler. Raises CompilerBudgetError where it takes too long, CompilerError where it cannot be run; one that was waited for in
    vain is not tried again."""
    what = f"C compiler {' '.join(command[:3])} took more than {timeout:g} s"
    if command[0] in _hanging:
        raise CompilerBudgetError(f"{what} before")
    try:
        return _run(command, timeout)
    except subprocess.TimeoutExpired as error:
        if not is_background:
            _hanging.add(command[0])
        raise CompilerBudgetError(what) from error


_hanging: set[str] = set()


# Bytes of memory that a compiler may take, where the system can hold it to that. Models of 500 constants need a tenth of it; for 200
# states it goes on to 5 GB and does not end in time.
COMPILE_MEMORY = 1000000000.0


# A shell that ends with all it has started when its input ends: this process holds the other end, and lets go however it dies.
# What it starts has so much memory and no more (in blocks of 1024 bytes; not every system can hold it to that).
_LEASH = (
    f"ulimit -v {int(COMPILE_MEMORY / 1024)} 2>/dev/null; "
    'exec 3<&0; { read -r _ <&3; kill -9 0; } & watch=$!; "$@" </dev/null 3<&-; code=$?; kill $watch; exit $code'
)


def _run(command: Sequence[str], timeout: float = COMPILE_SECONDS) -> subprocess.CompletedProcess[str]:
    """Run a program that ends, with the programs that it starts, when this process does: ``cc`` is but the parent of a compiler."""
    leashed = ["/bin/sh", "-c", _LEASH, "sh", *command] if os.path.exists("/bin/sh") else list(command)
    leash, hand = os.pipe()
    _hands.add(hand)
    try:
        if shutil.which(command[0]) is None:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), command[0])
        process = subprocess.Popen(
            leashed,
            stdin=leash,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            start_new_session=True,
        )
    except (OSError, subprocess.SubprocessError, ValueError) as error:
        _let_go(hand)
        raise CompilerError(f"C compiler {' '.join(command[:3])} cannot be run: {error}") from error
    finally:
        os.close(leash)
    try:
        output, errors = _wait(process, timeout)
    except BaseException:  # too slow, or interrupted: raised again
        _kill_group(process)
        raise
    finally:
        _let_go(hand)
    return subprocess.CompletedProcess(command, process.returncode, output, errors)


_hands: set[int] = set()
"""The ends of pipes by which this process holds its compilers."""


def _let_go(hand: int) -> None:
    if hand in _hands:  # a copy of the process has none
        _hands.discard(hand)
        os.close(hand)


def _become_copy() -> None:
    """After `os.fork`, in the new process: the compilers at work and the temporary folder are the other one's."""
    for hand in list(_hands):
        _let_go(hand)
    while _temporary:
        _temporary.pop()._finalizer.detach()  # type: ignore[attr-defined]


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_become_copy)


# Seconds between looks at whether the program still goes on.
LOOK_SECONDS = 0.05


def _wait(process: subprocess.Popen[str], timeout: float) -> tuple[str, str]:
    """What a program prints. Beside a main thread that has ended it is given up: nobody waits for what it makes.

    ``timeout`` counts seconds of a processor that has nothing else to do: where several programs share one, it takes as many times longer.
    """
    began = time.monotonic()
    while True:
        try:
            return process.communicate(timeout=LOOK_SECONDS)
        except subprocess.TimeoutExpired:
            if time.monotonic() - began > timeout * _count_sharers():
                raise
            if not threading.main_thread().is_alive():
                raise CompilerError("the program has ended") from None


def _count_sharers() -> float:
    """How many programs share one processor; one where the system does not say."""
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
    return max(1.0, load / (os.cpu_count() or 1))


def _kill_group(process: subprocess.Popen[str]) -> None:
    """End a process that leads a session of its own, and all that it has started."""
    with contextlib.suppress(OSError):
        if hasattr(os, "killpg"):
            os.killpg(process.pid, signal.SIGKILL)
        process.kill()
    for stream in (process.stdout, process.stderr):
        if stream is not None:
            stream.close()
    process.wait()


def summarise_errors(run: subprocess.CompletedProcess[str]) -> str:
    """The first lines in which a compiler tells of errors, without characters that would steer a terminal."""
    lines = [line for line in run.stderr.splitlines() if "error" in line.lower()] or run.stderr.splitlines()
    return f"({'; '.join(shorten(line, 300) for line in lines[:3])})" if lines else "without a message"
