"""Expressions once: a table of operations, one walk over the graph, one printer with a dialect for each language."""
