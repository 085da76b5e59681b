"""Minimisation of sums of squares and of sparse programs. The only package that calls IPOPT."""
