"""Values as bytes for another process of the same version.

A model is made of functions, often lambdas, which `pickle` refuses; `cloudpickle` (small, and what Dask itself uses) sends
them by value, so a worker needs greybox but not the user's project. CasADi expressions are not sent: a model is stated anew
where it arrives. Such bytes travel between processes of one user only; nothing of the kind is read from a file.
"""

from __future__ import annotations

import hashlib
import io
import os
import platform
import sys
import sysconfig
from dataclasses import fields
from functools import lru_cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from types import MappingProxyType, ModuleType
from typing import Any

import cloudpickle

from greybox.model import Model


def pack(value: Any) -> bytes:
    """``value`` as bytes; functions of the user's project travel by value."""
    modules = _local_packages()
    for module in modules:
        cloudpickle.register_pickle_by_value(module)
    try:
        buffer = io.BytesIO()
        _Pickler(buffer).dump(value)
        return buffer.getvalue()
    finally:
        for module in modules:
            cloudpickle.unregister_pickle_by_value(module)


def unpack(data: bytes) -> Any:
    """The value that was packed."""
    return cloudpickle.loads(data)


@lru_cache(maxsize=2)
def unpack_shared(data: bytes) -> Any:
    """What all jobs share, unpacked once in each worker."""
    return cloudpickle.loads(data)


@lru_cache
def describe_version() -> str:
    """Python and greybox as two processes must agree on them: the version, and the text of the program."""
    python = ".".join(platform.python_version_tuple()[:2])
    digest = hashlib.sha256()
    _add_texts(digest, files("greybox"))
    return f"Python {python}, greybox {digest.hexdigest()[:12]}"


def _add_texts(digest: Any, folder: Traversable) -> None:
    for entry in sorted(folder.iterdir(), key=lambda entry: entry.name):
        if entry.is_dir() and not entry.name.startswith("_"):
            _add_texts(digest, entry)
        elif entry.name.endswith((".py", ".c", ".h")):
            digest.update(entry.name.encode() + b"\0" + entry.read_bytes())


class _Pickler(cloudpickle.Pickler):
    """Models as what they were stated with, read-only mappings as mappings."""

    def reducer_override(self, obj: Any) -> Any:
        if isinstance(obj, Model):
            return _restated, (type(obj), {f.name: getattr(obj, f.name) for f in fields(obj) if f.init})
        if isinstance(obj, MappingProxyType):
            return MappingProxyType, (dict(obj),)
        return super().reducer_override(obj)


def _restated(kind: type, stated: dict[str, Any]) -> Any:
    return kind(**stated)


def _local_packages() -> list[ModuleType]:
    """Top packages of the user's project (models/, fits/, a script): their functions travel by value."""
    standard = tuple({os.path.realpath(sysconfig.get_path(name)) for name in ("stdlib", "platstdlib")})
    result = []
    for name, module in list(sys.modules.items()):
        if "." in name or name in ("__main__", "__mp_main__", "greybox"):
            continue
        file = getattr(module, "__file__", None) or next(iter(getattr(module, "__path__", ())), None)
        installed = file is None or "site-packages" in file or "dist-packages" in file
        if file and not installed and not os.path.realpath(file).startswith(standard):
            result.append(module)
    return result
