"""From experiments and a discrete step to a cost with its derivatives, or to a program for a sparse solver, and to its solution."""
