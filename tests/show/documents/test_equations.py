"""Long equations of a page: their terms stand below one another, and parts that repeat get names."""

from greybox.base.document import Equation
from greybox.shell.project import find_shipped_model
from greybox.show.documents.tables import EQUATION_LETTERS, _terms, count_letters, name_parts, typeset_equations
from greybox.show.printers.html import mathml
from models.micro_actuator import micro_actuator


def test_a_short_equation_stands_on_one_line() -> None:
    force = next(e for e in typeset_equations(micro_actuator).items if e.name == "force")
    assert r"\begin" not in force.latex and count_letters(force.latex) <= EQUATION_LETTERS


def test_the_parts_of_a_long_equation_put_back_give_the_equation() -> None:
    model = find_shipped_model("pneumatic_full")
    for balance in model.system.stated_balances:
        terms = _terms(balance)
        parts, texts = name_parts(terms, 3)
        whole = "".join(texts)
        for symbol, part in parts.items():  # a part is named before those that stand in it
            whole = whole.replace(symbol, part)
        assert whole == "".join(terms)
        assert all(part.count("{") == part.count("}") for part in parts.values())
        assert all(part.count(r"\left") == part.count(r"\right") for part in parts.values())
        if parts:
            assert count_letters("".join(texts)) < 0.7 * count_letters("".join(terms)) and r"\zeta_{4}" in parts


def test_a_long_equation_is_typeset_with_its_terms_below_one_another() -> None:
    items = typeset_equations(find_shipped_model("pneumatic_full")).items
    filling: Equation = next(e for e in items if e.name == "pressure_a")
    assert "<mtable" in mathml(filling.latex) and not any("<code>" in mathml(e.latex) for e in items)
    named = [e.latex.partition(" = ")[0] for e in items if e.name.endswith(", with")]
    assert len(named) == len({*named}) > 2
