"""The page of the app: one HTML text with style and scripts inside, and what a browser may do with it."""

from __future__ import annotations

from functools import cache
from importlib.resources import files

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from greybox.reports.html import pack_plotly, page_style, read_plotly, security_policy


@cache
def page_text() -> str:
    """The page. It holds nothing of a session: that comes as data, which its script shows as text."""
    environment = Environment(
        loader=PackageLoader("greybox.app", "template"), autoescape=True, undefined=StrictUndefined
    )
    style = page_style() + _part("app.css")
    return environment.get_template("app.html").render(style=style, script=_part("app.js"), plotly=pack_plotly())


@cache
def page_policy() -> str:
    """What a browser may do: run the two scripts of the page, ask this server, and nothing else."""
    return f"{security_policy([_part('app.js'), read_plotly()])}; connect-src 'self'; frame-ancestors 'none'"


def _part(name: str) -> Markup:
    return Markup(files("greybox.app").joinpath("template", name).read_text(encoding="utf-8"))
