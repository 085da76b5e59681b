"""What the page shows of a session, as plain values for JSON. Figures and sentences are those of the reports."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from greybox.base.units import format_unit
from greybox.data.columns import ColumnChoice
from greybox.discovery.localisation import ResidualLocalisation
from greybox.estimation.result_parts import Misfit
from greybox.extensions.app.session import Session, ValueRange
from greybox.model.effect import Effect
from greybox.model.effects.catalogue import all_effects
from greybox.model.effects.placement import find_placements
from greybox.model.equations import equations_text
from greybox.model.model import Model
from greybox.show.figures.discovery import plot_misfit_windows
from greybox.show.figures.figure import Figure
from greybox.show.figures.plotly_backend import height_on_page
from greybox.show.figures.records import plot_inputs, plot_residual, plot_run
from greybox.show.pages.html import figure_content, say
from greybox.show.pages.page import FigureBlock
from greybox.show.sentences.estimation import MISFIT_HEADS, to_constant_cells, to_misfit_cells

EffectPlace = tuple[Effect, str]
"""An effect and the site where it would act."""


def show_session(session: Session, places: Sequence[EffectPlace] = ()) -> dict[str, Any]:
    """Model, constants, effects, records and answers; ``places`` are the effects that can be put in."""
    model = session.model
    return {
        "model": model.name,
        "title": model.title,
        "description": model.description,
        "equations": equations_text(model),
        "constants": [_show_constant(session, q.name) for q in model.all_parameters],
        "effects": [
            {"name": b.effect.name, "site": b.site, "equation": b.effect.equation} for b in model.bound_effects
        ],
        "catalogue": [{"name": e.name, "site": site, "equation": e.equation} for e, site in places],
        "records": [
            {
                "name": r.experiment.name,
                "rows": r.experiment.rows,
                "seconds": float(r.experiment.time[-1] - r.experiment.time[0]),
                "validates": r.validates,
                "notes": [str(finding) for finding in r.experiment.findings],
            }
            for r in session.records
        ],
        "fit": None if session.fit is None else {"text": str(session.fit), "current": session.is_fitted},
        "discovery": None
        if session.discovery is None
        else {"verdict": str(session.discovery.verdict), "text": str(session.discovery)},
    }


def show_choice(columns: Sequence[str], choices: Sequence[ColumnChoice]) -> dict[str, Any]:
    """The columns of a file, and the signals that a person says the columns of."""
    return {
        "columns": list(columns),
        "signals": [
            {
                "name": c.signal.name,
                "unit": format_unit(c.signal.unit),
                "kind": str(c.signal.kind),
                "column": c.column,
                "matched": c.matched,
            }
            for c in choices
        ],
    }


def _show_constant(session: Session, name: str) -> dict[str, Any]:
    q, reach = session.model.parameter(name), session.ranges[name]
    estimate = session.fit.parameters.get(name) if session.fit is not None and session.is_fitted else None
    cells = None if estimate is None or estimate.fixed else to_constant_cells(name, estimate)
    return {
        "name": name,
        "unit": format_unit(q.unit),
        "description": q.description,
        "value": q.value,
        "fixed": q.fixed,
        "interval": "" if cells is None else cells[2],
        "remark": "" if cells is None else cells[4],
        **_show_range(reach),
    }


def _show_range(reach: ValueRange) -> dict[str, Any]:
    return {"low": reach.low, "high": reach.high, "logarithmic": reach.logarithmic}


def list_effects(model: Model, beside: tuple[Effect, ...] = ()) -> tuple[EffectPlace, ...]:
    """Every effect that has a place in ``model``, and the place."""
    places = find_placements(model, (*beside, *all_effects()))
    return tuple((place.effect, place.site) for place in places if place.effect is not None)


def show_run(session: Session, index: int, *, inputs: bool = False) -> dict[str, Any]:
    """One record beside the simulation: the run, the residual, the misfit; with what drove it."""
    result = session.simulate(index)
    trace, units = result.traces[0], _list_units(session.model)
    noise: Mapping[str, float] = session.noise or (session.fit.noise.std if session.fit is not None else {})
    figures = {
        "run": plot_run(trace, units, "run"),
        "residual": plot_residual(trace, units, noise, "residual"),
        "inputs": plot_inputs(trace, units, "inputs") if inputs else None,
    }
    return {
        "record": index,
        "figures": {name: show_figure(figure) for name, figure in figures.items() if figure is not None},
        "misfit": {"heads": ["", *MISFIT_HEADS], "rows": _show_misfits(result.misfit)},
        "overflows": not all(math.isfinite(m.rmse) for m in result.misfit.values()),
    }


def _list_units(model: Model) -> dict[str, str]:
    return {o.name: o.unit for o in model.outputs} | {i.name: i.unit for i in model.inputs}


def _show_misfits(misfit: Mapping[str, Misfit]) -> list[list[str]]:
    """A row an output; empty cells where the run overflows."""
    return [
        [output, *(to_misfit_cells(m) if math.isfinite(m.rmse) else [""] * len(MISFIT_HEADS))]
        for output, m in misfit.items()
    ]


def show_location(location: ResidualLocalisation, index: int) -> dict[str, Any]:
    """Where, when and as a function of what the model falls short."""
    windows = plot_misfit_windows(location)
    return {
        "record": index,
        "missing": location.is_missing,
        "text": str(location),
        "ratio": location.misfit if math.isfinite(location.misfit) else None,
        "figures": {} if windows is None else {"windows": show_figure(windows)},
    }


# Stretches by which a long curve is drawn, each by its smallest and largest value: a redraw while a slider moves must be quick.
APP_STRETCHES = 700


def show_figure(figure: Figure) -> dict[str, Any]:
    """A figure as the page's script draws it, and in words."""
    content = figure_content(FigureBlock(figure, stretches=APP_STRETCHES))
    words = say(figure.description) or say(figure.caption)
    return {**content, "height": height_on_page(figure), "words": words, "caption": say(figure.caption)}
