"""Every text of every page with markup of a stranger: it stays text, and what got through all the same would not run."""

from __future__ import annotations

import itertools
import re
from html import unescape
from xml.etree import ElementTree as ET

import numpy as np
import pytest

import greybox as gb
from greybox.base.document import Document
from greybox.base.values import Finding
from greybox.comparison.compare import compare
from greybox.data.signals import SignalLimit
from greybox.estimation.check import check
from greybox.extensions.design.campaign import Campaign, CampaignPlan, CampaignStatus, CampaignStep
from greybox.extensions.design.problem import CampaignCode
from greybox.extensions.export.document import Export
from greybox.show import describe_page
from greybox.show.printers.html import mathml, render_page, write_page
from models.micro_actuator import micro_actuator
from tests.extensions.design.test_design import QUICK
from tests.support.browser import opened, wait_until
from tests.support.hostile import CODE, MARKUP, poison

KINDS = (
    "campaign",
    "changed",
    "check",
    "comparison",
    "design",
    "discovery",
    "export",
    "fit",
    "linearisation",
    "simulation",
)


@pytest.fixture(scope="module")
def pages(tmp_path_factory) -> dict[str, Document]:
    """A page of every kind, from small results."""
    t = 5e-4 * np.arange(400)
    rig = (micro_actuator + gb.effect("cubic_stiffness")).start(K3=5e9)
    runs = [
        gb.simulate(rig, gb.Experiment(n, t, {"u": s * np.sin((40 + 600 * t) * t)}, {}))
        for n, s in (("a", 4), ("b", 3))
    ]
    noise = {"x": 2e-7, "i": 5e-3}
    made = [r.record(noise, np.random.default_rng(k)) for k, r in enumerate(runs)]
    known = micro_actuator.fix("M", "Ra", "Kf", "Kv", "La")
    discovery = gb.discover(
        known,
        made[0],
        validation=made[1],
        noise=noise,
        effects=[gb.effect("cubic_stiffness")],
        options=gb.FitOptions(at_rest=True),
    )
    fits = {"plain": discovery.base, "with it": discovery.best}
    linear = gb.linearise(discovery.best)
    exported = tmp_path_factory.mktemp("export") / "plant.json"
    exported.write_text("{}")
    limits = {"u": SignalLimit(-4, 4)}
    plan = CampaignPlan(known, limits, 0.1, 5e-4, noise, tuple(made))
    step = CampaignStep(1, "precision", "multisine", "named", ("cubic_stiffness",), (("play",),), {"K": 0.01}, 1.0)
    todo = Finding(CampaignCode.MEASURE, subject="01/input.csv", values={"record": "01/record.csv"})
    values = {
        "campaign": (Campaign(CampaignStatus.MEASURING, plan, exported.parent, (step,), (todo,)), {}),
        "changed": (
            gb.detect_changes(discovery.best, runs[1].record(noise, np.random.default_rng(5)), search_effects=False),
            {},
        ),
        "design": (gb.design(discovery.best, limits=limits, policy=QUICK), {}),
        "check": (check(micro_actuator), {}),
        "comparison": (compare(fits, made[1], training=made[0]), {"fits": fits}),
        "discovery": (discovery, {}),
        "export": (Export(discovery.best, "JSON", (exported,), linear, None), {}),
        "fit": (discovery.best, {"tests": gb.residual_tests(discovery.best)}),
        "linearisation": (linear, {}),
        "simulation": (runs[0], {"model": rig}),
    }
    return {kind: describe_page(value, command="greybox", **more) for kind, (value, more) in values.items()}


# All pages are written by one printer: by day those with most kinds of blocks.
BY_DAY = ("comparison", "discovery", "fit")


@pytest.mark.crossed(3)
@pytest.mark.rest
@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=[pytest.mark.slow] * (kind not in BY_DAY)) for kind in KINDS]
)
def test_no_text_of_a_page_runs_or_becomes_markup(tab, pages, tmp_path, kind):
    count = itertools.count()
    page = poison(pages[kind], (f"t{next(count)} {text}" for text in itertools.cycle(MARKUP)))
    file = write_page(page, tmp_path / f"{kind}.html")
    with opened(tab, file) as shown:
        for fold in shown.locator("details").all():
            fold.evaluate("fold => fold.open = true")
        assert shown.evaluate("window.hurt") is None
        strange = (
            "script[src], iframe, img, a[href^=javascript], [onerror], [onload], object, embed, math table, math style"
        )
        assert shown.locator(strange).count() == 0
        assert shown.locator("script:not([type])").count() == 1 + (shown.locator("figure.drawn").count() > 0)
        assert "<img src=x onerror" in shown.locator("body").inner_text()
    assert next(count) > 20


@pytest.mark.rest
def test_what_is_injected_all_the_same_does_not_run(tab, pages, tmp_path):
    html = render_page(pages["check"])
    for place in ("</header>", "</body>"):
        assert place in html
        html = html.replace(place, f"{MARKUP[0]}<a id='link' href='javascript:window.hurt=1'>x</a>{place}", 1)
    (tmp_path / "page.html").write_text(html)
    tab.goto((tmp_path / "page.html").as_uri())
    wait_until(tab, "window.greyboxReady === true")
    tab.click("#link >> nth=0", force=True)
    tab.evaluate(
        "() => { const s = document.createElement('script'); s.textContent = 'window.hurt=1'; document.body.append(s); }"
    )
    assert tab.evaluate("window.hurt") is None


@pytest.mark.rest
def test_a_page_names_its_scripts_and_nothing_else(pages):
    for kind, page in pages.items():
        head = unescape(render_page(page).partition("</head>")[0])
        (policy,) = [line for line in head.splitlines() if "Content-Security-Policy" in line]
        assert "default-src 'none'" in policy, kind
        script = policy.partition("script-src")[2].partition(";")[0]
        assert "unsafe" not in script and script.count("sha256-") in (1, 2)


@pytest.mark.parametrize("text", [*MARKUP, *CODE, "\\", "{", "}", "$", "%", "#", "^", "&", "~", "_", "p<p0", "名", ""])
def test_a_formula_is_mathml_or_its_text(text):
    for latex in (text, rf"\text{{{text}}}", rf"\underset{{\text{{{text}}}}}{{x}}"):
        html = str(mathml(latex))
        root = ET.fromstring(html)
        assert root.tag in ("{http://www.w3.org/1998/Math/MathML}math", "code")
        assert all(re.fullmatch("m[a-z]+|code", element.tag.rpartition("}")[2]) for element in root.iter())
        assert not {name for element in root.iter() for name in element.attrib} & {
            "href",
            "style",
            "class",
            "id",
            "src",
        }


@pytest.mark.crossed(3)
@pytest.mark.parametrize("text", [*MARKUP, *CODE[:7], "<", "p<p0", "名", "a b"])
def test_a_term_of_any_name_is_typeset(text):
    def balances(x, u, p):
        return [gb.Balance("level", "m/s", 1, "x", **{text: -p.k * x.x, "drive": p.k * u.u})]

    model = gb.Model(
        "tank",
        states=[gb.State("x", "m")],
        inputs=[gb.Input("u", "m")],
        outputs=[gb.Output("x", "m")],
        parameters=[gb.Parameter("k", "1/s", 1.0, (0.1, 10.0))],
        balances=balances,
    )
    html = render_page(describe_page(check(model)))
    assert "<math" in html and "<img" not in html and html.count("<script") == html.count("</script>")
