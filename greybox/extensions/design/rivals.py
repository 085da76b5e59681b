"""What a design begins with: a model, a fit or a discovery, and rivals fitted to the same records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from greybox.base.errors import DataError, FitError, ModelError
from greybox.data.experiment import Experiment
from greybox.discovery.candidates import estimate_scales, generate_starting_points
from greybox.discovery.problem import DiscoveryProblem
from greybox.discovery.result import Discovery
from greybox.estimation.fit import fit
from greybox.estimation.options import FitOptions
from greybox.estimation.result import Fit
from greybox.model.effects.catalogue import effect
from greybox.model.effects.scales import tailor_to_record
from greybox.model.effects.starts import AMPLITUDE_GRID
from greybox.model.model import Model

Source = Model | Fit | Discovery


@dataclass(frozen=True)
class KnownPlant:
    """What is known before a design.

    Parameters
    ----------
    models
        The explanations, fitted where there are records; the best one first.
    earlier
        The records that were taken.
    noise
        Standard deviation of each sensor, by output; empty where nothing is known.
    options
        How records are fitted.
    inflation
        By constant, see `DesignProblem`.
    """

    models: tuple[Model, ...]
    earlier: tuple[Experiment, ...]
    noise: dict[str, float]
    options: FitOptions
    inflation: dict[str, float]


def read_source(
    source: Source,
    rivals: Sequence[str | Model] = (),
    options: FitOptions | None = None,
    plain: Fit | None = None,
) -> KnownPlant:
    """What a source and named rivals say.

    Parameters
    ----------
    source
        A model, its fit, or a discovery, whose alternatives become rivals.
    rivals
        Further explanations: effects of the plain model joined by ``+`` (``""`` or ``none`` for the plain model itself), or models.
    options
        How records are fitted; those of the fit where left out.
    plain
        The fit of the plain model that rivals extend, where ``source`` is the fit of another one.

    Returns
    -------
    KnownPlant
        Explanations, records, noise, options.

    Raises
    ------
    ModelError, DataError
        For a rival that cannot be made or fitted.
    """
    if isinstance(source, Model):
        named = [r for r in rivals if isinstance(r, str)]
        if named:
            raise DataError(
                f"rival {named[0]!r}: a rival is fitted to records first, and there are none; give records or a fit"
            )
        others = (r for r in rivals if isinstance(r, Model))
        return KnownPlant((source, *others), (), {}, options or FitOptions(), {})
    if isinstance(source, Discovery):
        best, base = source.best, source.base
        names = ["+".join(effects) for effects in source.alternatives]
    elif isinstance(source, Fit):
        best, base, names = source, plain or source, []
    else:
        raise ModelError(f"design: {type(source).__name__} is no model, fit or discovery; give one of them")
    if not best.success:
        raise FitError(
            f"the fit of {best.model.title} did not end at an optimum; repeat it before a record is designed"
        )
    models = [best.model, *(r for r in rivals if isinstance(r, Model))]
    for name in dict.fromkeys([*names, *(r for r in rivals if isinstance(r, str))]):
        # To the same records: a rival that explains them worse from a bad start would look easy to tell apart.
        models.append(fit_rival(base, name))
    chosen = options or FitOptions.from_data(best.provenance.options)
    noise = {name: float(std) for name, std in best.noise.std.items()}
    # A residual with a colour widens intervals; one that is whiter than white by chance narrows none.
    inflation = {name: max(1.0, float(factor)) for name, factor in best.uncertainty.inflation.items()}
    # Each set of effects once, the first of it.
    distinct: dict[str, Model] = {}
    for model in models:
        distinct.setdefault(model.title, model)
    return KnownPlant(tuple(distinct.values()), tuple(t.experiment for t in best.traces), noise, chosen, inflation)


def fit_rival(plain: Fit, text: str) -> Model:
    """The plain model with effects, ``a+b``, fitted to the records of its fit.

    Raises
    ------
    ModelError
        For an effect that has no place in it, or that cannot be fitted.
    """
    names = [part.strip() for part in text.split("+") if part.strip() not in ("", "none")]
    problem = DiscoveryProblem.from_fit(plain)
    candidate = problem.to_candidate(plain)
    scales = estimate_scales(candidate)
    for name in names:
        entry = tailor_to_record(effect(name), scales)
        extended = candidate.model + entry
        starts = [
            extended.values,
            *generate_starting_points(extended, entry, candidate, plain.model, scales, AMPLITUDE_GRID),
        ]
        refitted = problem.refit_best(extended, starts, like=candidate)
        if refitted is None:
            raise ModelError(f"rival {text!r}: {extended.title} cannot be fitted to the records; leave it out")
        candidate = refitted
    return candidate.model


def fit_explanation(plain: Fit, text: str) -> Fit:
    """The plain model with effects, ``a+b``, as a fit to the records of its fit. Raises ModelError as `fit_rival` does."""
    model = fit_rival(plain, text)
    options = FitOptions.from_data(plain.provenance.options)
    records = [t.experiment for t in plain.traces]
    return fit(model, records, noise=dict(plain.noise.std), options=replace(options, progressive=False))
