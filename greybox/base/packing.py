"""Values as bytes for another process of the same version.

A model is made of functions, often lambdas, which `pickle` refuses; `cloudpickle` (small, and what Dask itself uses) sends
them by value, so a worker needs greybox but not the user's project. CasADi expressions are not sent: a model is stated anew
where it arrives. Such bytes travel between processes of one user only; nothing of the kind is read from a file.
"""

from __future__ import annotations

import io
import os
import sys
import sysconfig
from functools import cache, lru_cache
from types import MappingProxyType, ModuleType
from typing import Any

import cloudpickle

from greybox.base.values import ReadOnly


class MadeOfFunctions:
    """A value that is stated by functions, often lambdas, which `pickle` refuses: they travel by value, as to another process."""

    def restate(self) -> tuple[Any, ...]:
        """The function that makes it anew, and its arguments."""
        raise NotImplementedError

    def __reduce__(self) -> tuple[Any, ...]:
        return unpack, (pack(self),)

    def __copy__(self) -> Any:
        make, values = self.restate()
        return make(*values)

    def __deepcopy__(self, memo: Any) -> Any:
        return self.__copy__()  # what it is made of does not change


def pack(value: Any) -> bytes:
    """``value`` as bytes; functions of the user's project travel by value."""
    modules = _local_packages()
    for module in modules:
        cloudpickle.register_pickle_by_value(module)
    try:
        return pack_values(value)
    finally:
        for module in modules:
            cloudpickle.unregister_pickle_by_value(module)


def pack_values(value: Any) -> bytes:
    """``value``, in which there is no function of the user's project, as bytes: looking for these takes longer than short runs do."""
    buffer = io.BytesIO()
    _Pickler(buffer).dump(value)
    return buffer.getvalue()


def unpack(data: bytes) -> Any:
    """The value that was packed."""
    return cloudpickle.loads(data)


@lru_cache(maxsize=2)
def unpack_shared(data: bytes) -> Any:
    """What all jobs share, unpacked once in each worker."""
    return cloudpickle.loads(data)


class _Pickler(cloudpickle.Pickler):
    """Read-only mappings as mappings, models as they were stated; `pickle` refuses both."""

    def reducer_override(self, obj: Any) -> Any:
        if isinstance(obj, MappingProxyType):
            return MappingProxyType, (dict(obj),)
        if isinstance(obj, ReadOnly):
            return ReadOnly.__reduce__(obj)
        if isinstance(obj, MadeOfFunctions):
            return obj.restate()
        return super().reducer_override(obj)


def _local_packages() -> list[ModuleType]:
    """Top packages of the user's project (models/, fits/, a script): their functions travel by value."""
    result = []
    for name, module in list(sys.modules.items()):
        if "." in name or name in ("__main__", "__mp_main__", "greybox"):
            continue
        file = getattr(module, "__file__", None) or next(iter(getattr(module, "__path__", ())), None)
        if file and _is_of_project(file):
            result.append(module)
    return result


# What a run is called with is packed at each: where hundreds of modules lie is found once.
@cache
def _is_of_project(file: str) -> bool:
    """Whether a module in ``file`` is neither installed nor Python's own."""
    if "site-packages" in file or "dist-packages" in file:
        return False
    standard = tuple({os.path.realpath(sysconfig.get_path(name)) for name in ("stdlib", "platstdlib")})
    return not os.path.realpath(file).startswith(standard)
