"""Output error and Box-Jenkins: the noise does not pass through the plant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from greybox.blackbox.excitation import find_weak_excitation
from greybox.blackbox.initial_estimates import estimate_box_jenkins_starts, estimate_output_error_starts
from greybox.blackbox.linear_regression import to_orders
from greybox.blackbox.polynomial import PolynomialModel
from greybox.blackbox.prediction_error_fit import HistoryTreatment, check_history, fit_prediction_error
from greybox.blackbox.sampled_data import SampledData, to_sampled_data
from greybox.blackbox.structure import PolynomialStructure, to_order
from greybox.errors import DataError
from greybox.experiment import Experiment


def output_error(
    experiments: Experiment | Sequence[Experiment],
    *,
    nb: int | Sequence[int],
    nf: int | Sequence[int],
    nk: int | Sequence[int] = 1,
    output: str | None = None,
    inputs: Sequence[str] | str | None = None,
    history: HistoryTreatment = "estimated",
    offset: bool = False,
    units: Mapping[str, str] | None = None,
) -> PolynomialModel:
    """Fit ``y(k) = sum_i B_i(q) / F_i(q) u_i(k) + e(k)`` by minimising the mean square of the free-run error ``e``.

    ``nf`` poles of each input's ``F`` (one number for all, or one for each), held inside the unit circle. The rest as in `armax`.
    The standard deviations hold for a white error only. A gap in the output costs nothing but its rows.

    Raises DataError as `arx` does.
    """
    check_history(history)
    data = to_sampled_data(experiments, output, inputs)
    structure = make_output_structure("output error", data, nb, nf, nk, offset=offset)
    model = fit_prediction_error(structure, data, estimate_output_error_starts, history, units)
    return _with_excitation(structure, data, model)


def box_jenkins(
    experiments: Experiment | Sequence[Experiment],
    *,
    nb: int | Sequence[int],
    nf: int | Sequence[int],
    nc: int,
    nd: int,
    nk: int | Sequence[int] = 1,
    output: str | None = None,
    inputs: Sequence[str] | str | None = None,
    history: HistoryTreatment = "estimated",
    offset: bool = False,
    units: Mapping[str, str] | None = None,
) -> PolynomialModel:
    """Fit ``y(k) = sum_i B_i(q) / F_i(q) u_i(k) + C(q) / D(q) e(k)`` by minimising the mean square of the one-step error ``e``.

    The noise has poles (``nd``) and zeros (``nc``) of its own, both held inside the unit circle. The rest as in `output_error`, of
    which this is the extension for coloured noise (Box, Jenkins 1970; Ljung, System identification, 2nd ed., equation 4.31).

    Raises DataError as `arx` does.
    """
    check_history(history)
    data = to_sampled_data(experiments, output, inputs)
    kind = "box-jenkins"
    noise = {"nc": to_order("nc", nc, kind), "nd": to_order("nd", nd, kind)}
    structure = make_output_structure(kind, data, nb, nf, nk, offset=offset, **noise)
    model = fit_prediction_error(structure, data, estimate_box_jenkins_starts, history, units)
    return _with_excitation(structure, data, model)


def make_output_structure(
    kind: str,
    data: SampledData,
    nb: int | Sequence[int],
    nf: int | Sequence[int],
    nk: int | Sequence[int],
    *,
    nc: int = 0,
    nd: int = 0,
    offset: bool = False,
) -> PolynomialStructure:
    """Structure with ``A = 1``, its orders spread over the inputs. Raises DataError for orders that cannot be."""
    o = to_orders(data, nb, nk, 0, kind)
    poles = (nf,) * len(o.nb) if isinstance(nf, (int, np.integer)) else tuple(nf)
    if len(poles) != len(o.nb):
        raise DataError(f"{kind}: nf has {len(poles)} numbers for {len(o.nb)} inputs; give one number, or one for each")
    return PolynomialStructure(kind, o, tuple(to_order("nf", n, kind) for n in poles), nc=nc, nd=nd, offset=offset)


def _with_excitation(structure: PolynomialStructure, data: SampledData, model: PolynomialModel) -> PolynomialModel:
    needed = [b + f for b, f in zip(structure.orders.nb, structure.nf, strict=True)]
    return replace(model, notes=(*find_weak_excitation(data, sum(needed), needed), *model.notes))
