"""ARMAX: the equation error is a moving average of white noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from greybox.blackbox.excitation import excitation_notes
from greybox.blackbox.polynomial import PolynomialModel
from greybox.blackbox.regression import orders
from greybox.blackbox.search import Beginning, check_history, searched
from greybox.blackbox.series import channels
from greybox.blackbox.starts import armax_starts
from greybox.blackbox.structure import Structure, whole
from greybox.experiment import Experiment


def armax(
    experiments: Experiment | Sequence[Experiment],
    *,
    na: int,
    nb: int | Sequence[int],
    nc: int,
    nk: int | Sequence[int] = 1,
    output: str | None = None,
    inputs: Sequence[str] | str | None = None,
    history: Beginning = "estimated",
    offset: bool = False,
    units: Mapping[str, str] | None = None,
) -> PolynomialModel:
    """Fit ``A(q) y(k) = sum_i B_i(q) u_i(k) + C(q) e(k)`` by minimising the mean square of the one-step error ``e``.

    ``nc`` coefficients of the noise polynomial ``C``, which is stable: its roots are mirrored into the unit circle. The rest as in
    `arx`. ``history``: ``"estimated"``, what lies before each record and after each gap is estimated with it; ``"zero"``, all was
    zero there. The search (Gauss and Newton's step, damped) starts from several linear estimates and keeps the best.

    Raises DataError as `arx` does.
    """
    check_history(history)
    data = channels(experiments, output, inputs)
    o = orders(data, nb, nk, na, "armax")
    structure = Structure("armax", o, (0,) * len(o.nb), nc=whole("nc", nc, "armax"), offset=offset)
    model = searched(structure, data, armax_starts, history, units)
    return replace(model, notes=(*excitation_notes(data, o.na + sum(o.nb), o.nb), *model.notes))
