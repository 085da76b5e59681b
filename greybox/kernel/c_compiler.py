"""C source -> loaded library: find a compiler, compile once for each machine, keep the result in the user's cache.

Environment: ``CC`` names the compiler (else ``cc``, ``gcc``, ``clang`` on the path, else the package ``ziglang``);
``GREYBOX_CACHE`` the folder of the compiled libraries.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import importlib.metadata
import importlib.util
import json
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from greybox.errors import GreyboxError

# Without errno and traps the compiler may use vector instructions; no -ffast-math, so that NaN and infinity keep their
# meaning. Packing scalars into vectors by itself (slp) only lengthens the recursion that everything waits for.
FLAGS = (
    "-O3",
    "-march=native",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-fno-tree-slp-vectorize",
    "-std=gnu11",
    "-shared",
)
SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")


class GreyboxWarning(UserWarning):
    """Something works, but not as well as it could."""


class CompilerError(GreyboxError):
    """The C compiler is missing or failed."""


class NoCompilerError(CompilerError):
    """There is no C compiler on this machine."""


@dataclass(frozen=True)
class Compiler:
    """A C compiler: its command, the version text that it gives, and the seconds after which a run is given up."""

    command: tuple[str, ...]
    version: str
    timeout: float = 300.0


def load_library(source: Callable[[], str], key: str) -> ctypes.CDLL:
    """The library compiled from the C text that ``source()`` writes, from the cache where it is there already.

    ``key`` says what the text is made from: it is not written where a library of that key is there. Raises CompilerError.
    """
    compiler = find_compiler()
    flags = (*FLAGS, *(() if sys.platform == "win32" else ("-fPIC",)))
    cache_key = "\0".join([key, hash_generator(), *flags, *compiler.command, compiler.version, describe_machine()])
    name = f"{hashlib.sha256(cache_key.encode()).hexdigest()}{SUFFIX}"
    path = find_cache_folder() / name
    if not _is_intact(path):
        _compile(compiler, flags, source(), path)
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
    """Where compiled libraries are kept; a temporary folder for this process if the usual one cannot be written."""
    return _writable(_usual_cache())


@lru_cache
def hash_generator() -> str:
    """What distinguishes one version of the program that writes the C text from another: its own text."""
    digest = hashlib.sha256()
    for file in sorted(Path(__file__).parent.rglob("*")):
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
    """Doubles in one block of tangents: a vector register, or half of an AVX-512 one (often the faster half) if that is
    enough."""
    words = set(describe_machine().lower().split())
    if "avx512f" in words:
        return 8 if directions > 4 else 4
    known_x86 = platform.machine().lower() in ("x86_64", "amd64")
    return 4 if "avx" in words or (known_x86 and sys.platform != "linux") else 2


def _usual_cache() -> Path:
    given = os.environ.get("GREYBOX_CACHE")
    if given:
        return Path(given)
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local") / "greybox"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "greybox"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "greybox"


@lru_cache
def _writable(folder: Path) -> Path:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError:
        # held by the module, hence removed when the process ends
        _temporary.append(tempfile.TemporaryDirectory(prefix="greybox-", ignore_cleanup_errors=True))
        return Path(_temporary[-1].name)


_temporary: list[tempfile.TemporaryDirectory[str]] = []


@lru_cache
def _find_compiler(cc: str, path: str) -> Compiler:
    if cc:
        command = shlex.split(cc, posix=os.name != "nt")
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
    stamp = f"{' '.join(command)} {program} {os.stat(program).st_mtime_ns}"
    versions_file = find_cache_folder() / "compilers.json"
    versions: dict[str, str] = {}
    with contextlib.suppress(OSError, ValueError):  # not there yet, or unreadable: ask the compiler again
        versions = json.loads(versions_file.read_text(encoding="utf-8"))
    if stamp not in versions:
        result = _run([*command, "--version"])
        if result.returncode != 0:
            raise CompilerError(
                f"C compiler {' '.join(command)} does not work: --version ended with code {result.returncode} {_error_lines(result)}"
            )
        versions[stamp] = result.stdout.strip()
        with tempfile.TemporaryDirectory(
            dir=versions_file.parent, prefix="part-", ignore_cleanup_errors=True
        ) as folder:
            Path(folder, versions_file.name).write_text(json.dumps(versions), encoding="utf-8")
            _replace(Path(folder, versions_file.name), versions_file)
    return versions[stamp]


def _is_intact(path: Path) -> bool:
    """Whether the library file is complete; loading one that a full disk cut short would end the process."""
    try:
        return _digest_path(path).read_text(encoding="utf-8") == hashlib.sha256(path.read_bytes()).hexdigest()
    except (OSError, ValueError):
        return False


def _digest_path(path: Path) -> Path:
    return path.with_suffix(".sha256")


def _compile(compiler: Compiler, flags: Sequence[str], source: str, path: Path) -> None:
    """Compile beside ``path`` and rename: another process sees all of the library or none of it.

    The names of the files are the same every time, and so is the library: two processes at once may both write it.
    """
    with tempfile.TemporaryDirectory(dir=path.parent, prefix="part-", ignore_cleanup_errors=True) as folder:
        text, library, digest = (Path(folder, f"kernel{suffix}") for suffix in (".c", SUFFIX, ".sha256"))
        text.write_text(source, encoding="utf-8")
        run = _run([*compiler.command, *flags, "-o", str(library), str(text), "-lm"], compiler.timeout)
        if run.returncode != 0 or not library.exists():
            raise CompilerError(
                f"C compiler {' '.join(compiler.command)} ended with code {run.returncode} {_error_lines(run)}"
            )
        digest.write_text(hashlib.sha256(library.read_bytes()).hexdigest(), encoding="utf-8")
        _replace(library, path)
        _replace(digest, _digest_path(path))


def _replace(temporary: Path, path: Path) -> None:
    try:
        os.replace(temporary, path)
    except PermissionError:  # Windows: another process has just put it there and loaded it
        if not path.exists():
            raise


def _run(command: Sequence[str], timeout: float = 300.0) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(command, capture_output=True, text=True, errors="replace", timeout=timeout, check=False)
    except (OSError, subprocess.SubprocessError) as error:
        raise CompilerError(f"C compiler {' '.join(command[:3])} cannot be run: {error}") from error


def _error_lines(run: subprocess.CompletedProcess[str]) -> str:
    lines = [line for line in run.stderr.splitlines() if "error" in line.lower()] or run.stderr.splitlines()
    return f"({'; '.join(lines[:3])})" if lines else "without a message"
