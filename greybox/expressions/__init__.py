"""Expressions once: a table of operations, one walk over the graph, one printer with a dialect for each language."""

from greybox.expressions.graph import walk
from greybox.expressions.latex import LATEX, expression_latex, symbol_latex
from greybox.expressions.operations import OPERATIONS, Operation
from greybox.expressions.printer import FORMULA, MODELICA, NUMPY, PYTHON, Printer
from greybox.expressions.text import TEXT, expression_text, number_text, signed_text

__all__ = [
    "FORMULA",
    "LATEX",
    "MODELICA",
    "NUMPY",
    "OPERATIONS",
    "PYTHON",
    "TEXT",
    "Operation",
    "Printer",
    "expression_latex",
    "expression_text",
    "number_text",
    "signed_text",
    "symbol_latex",
    "walk",
]
