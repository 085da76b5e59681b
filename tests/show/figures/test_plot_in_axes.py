"""A figure of a page in axes of one's own: every one of every page, with the numbers that the page has."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.figure import Figure as Picture

import greybox as gb
from greybox.base.figure import Curve
from greybox.estimation.check import check
from greybox.show import describe_page, list_figures
from tests.support.first_order import first_order

NOISE = 0.02


@pytest.fixture(scope="module")
def results() -> Mapping[str, Any]:
    rng, time = np.random.default_rng(1), 0.05 * np.arange(300)
    records = []
    for name in ("a", "b $x_1$"):
        u = np.repeat(rng.normal(size=30), 10)
        run = gb.simulate(first_order(), gb.Experiment(name, time, {"u": u}, {})).outputs["y"]
        records.append(gb.Experiment(name, time, {"u": u}, {"y": run + rng.normal(0, NOISE, len(time))}))
    fit = gb.fit(first_order(), records[0], validation=records[1], noise={"y": NOISE})
    return {
        "fit": fit,
        "check": check(first_order(), records),
        "linearisation": gb.linearise(fit),
        "comparison": gb.compare([fit, gb.blackbox.arx(records[0], na=1, nb=1, output="y")], records[1]),
    }


@pytest.mark.parametrize("kind", ["fit", "check", "linearisation", "comparison"])
def test_every_panel_of_every_figure_of_a_page_is_drawn_where_one_wants_it(
    kind: str, results: Mapping[str, Any]
) -> None:
    page = describe_page(results[kind])
    figures = list_figures([*page.evidence, *(block for section in page.sections for block in section.blocks)])
    assert len(figures) >= 3
    for name, figure in figures.items():
        for panel in figure.panels:
            ax = Picture().subplots()
            assert gb.plot(results[kind], name, panel.name, ax=ax) is ax
            assert (ax.get_xlabel(), ax.get_ylabel().split()) == (panel.x.label, panel.y.label.split())
            ax.figure.canvas.draw()  # a formula that is none would fail here
            curves = [s for s in panel.series if isinstance(s, Curve) and not s.held]
            drawn = [line.get_ydata() for line in ax.get_lines()]
            assert all(any(np.array_equal(c.y, y, equal_nan=True) for y in drawn) for c in curves)


def test_the_first_figure_is_that_at_the_head_of_the_page(results: Mapping[str, Any]) -> None:
    fit = results["fit"]
    ax = gb.plot(fit, ax=Picture().subplots())
    measured = fit.validation.traces[0].measured["y"]
    assert any(np.allclose(line.get_ydata(), measured) for line in ax.get_lines())
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["measured", "simulated"]
    with pyplot.rc_context({"backend": "agg"}):
        new = gb.plot(fit)
        assert new.figure in map(pyplot.figure, pyplot.get_fignums())
        pyplot.close(new.figure)


def test_a_name_that_no_figure_has_is_refused_with_those_that_there_are(results: Mapping[str, Any]) -> None:
    with pytest.raises(gb.GreyboxError, match=r"no figure 'residual-7'; did you mean 'residual-\d'"):
        gb.plot(results["fit"], "residual-7")
    with pytest.raises(gb.GreyboxError, match=r"the figure residual-0 has no panel 'z'; known: y"):
        gb.plot(results["fit"], "residual-0", "z")
    with pytest.raises(gb.GreyboxError, match="has no page"):
        gb.plot(results["fit"].noise)
