"""C text -> shared library that runs on any machine of this kind."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from greybox.kernel.c_compiler import CompilerError, find_compiler

# Nothing that only this processor has; no contraction of products and sums, so that every compiler gives the same digits.
FLAGS = ("-O2", "-std=c99", "-ffp-contract=off", "-shared", "-fvisibility=hidden")


def compile_shared_library(text: str, target: Path) -> Path:
    """Compile C ``text`` into ``target``. Raises CompilerError where there is no compiler, or it fails."""
    compiler = find_compiler()
    source = target.with_suffix(".c")
    source.write_text(text, encoding="utf-8")
    flags = (*FLAGS, *(() if sys.platform == "win32" else ("-fPIC",)))
    command = [*compiler.command, *flags, "-o", str(target), str(source), "-lm"]
    run = subprocess.run(
        command, capture_output=True, text=True, errors="replace", timeout=compiler.timeout, check=False
    )
    if run.returncode != 0:
        said = "; ".join([line for line in run.stderr.splitlines() if "error" in line.lower()][:3])
        raise CompilerError(f"C compiler {' '.join(compiler.command)} ended with code {run.returncode} ({said})")
    return target
