"""CasADi functions called with numpy arrays in place."""

from __future__ import annotations

import casadi as ca
import numpy as np


def call_function(function: ca.Function, *arguments: np.ndarray) -> list[np.ndarray]:
    """Every output of ``function``, which must be dense, as an array (rows, columns).

    The detour over CasADi's own matrices that an ordinary call makes costs many times a small function; this has a buffer of its
    own for each call, hence for each thread.
    """
    buffer, evaluate = function.buffer()
    columns = [np.asarray(a, dtype=np.float64).ravel(order="F") for a in arguments]
    for i, array in enumerate(columns):
        buffer.set_arg(i, array.data)
    results = [np.empty((function.size2_out(i), function.size1_out(i))) for i in range(function.n_out())]
    for i, array in enumerate(results):
        if array.size:
            buffer.set_res(i, array.data)
    evaluate()
    return [array.T for array in results]
