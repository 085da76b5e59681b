"""Published networks: does a fit by the usual options hold their constants, find them from three times off, and from anywhere?

    python -m fits.studies.published_networks [--random N] [--only NAME] [--page FOLDER]

Signalling, gene regulation, glycolysis, infections and immune cells, nerve and chemistry, each with the equations, constants and sampling
of its source. What is measured is a run of an independent solver at these constants with noise of known size
(`fits.studies.stiff_problems.StiffProblem`): a fit has *reached* the optimum where the sum of squares of its
constants, by that solver, is not
above that of the published ones.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fits.papers.paper_page import write_section
from fits.studies import published_problems, stiff_problems
from fits.studies.stiff_problems import StiffProblem, exp, sqrt, study


def _stat5(x: Any, u: Any, p: Any) -> Mapping[str, Any]:
    """Two kinds of STAT5 pair under a hormone that decays, enter the nucleus and fall apart there."""
    hormone = 1.25e-7 * x.hormone
    aa, ab, bb = (hormone * p.phos * first * second for first, second in ((x.a, x.a), (x.a, x.b), (x.b, x.b)))
    cytoplasm, nucleus = 1.4, 0.45
    return {
        "hormone": -p.degrade * x.hormone,
        "a": -2 * aa - ab + nucleus / cytoplasm * (2 * p.out_homo * x.naa + p.out_hetero * x.nab),
        "b": -2 * bb - ab + nucleus / cytoplasm * (2 * p.out_homo * x.nbb + p.out_hetero * x.nab),
        "aa": aa - p.in_homo * x.aa,
        "ab": ab - p.in_hetero * x.ab,
        "bb": bb - p.in_homo * x.bb,
        "naa": cytoplasm / nucleus * p.in_homo * x.aa - p.out_homo * x.naa,
        "nab": cytoplasm / nucleus * p.in_hetero * x.ab - p.out_hetero * x.nab,
        "nbb": cytoplasm / nucleus * p.in_homo * x.bb - p.out_homo * x.nbb,
    }


# Share of each kind that the antibody binds.
_A, _B = 0.107, 0.893

_STAT5_OUTPUTS = {
    "pa": lambda x, p: 100 * (x.ab + 2 * x.aa * _A) / (x.ab + x.a * _A + 2 * x.aa * _A),
    "pb": lambda x, p: 100 * (x.ab + 2 * x.bb * _B) / (x.ab + x.b * _B + 2 * x.bb * _B),
    "ra": lambda x, p: (
        100 * (x.ab + x.a * _A + 2 * x.aa * _A) / (2 * x.ab + x.a * _A + 2 * x.aa * _A + x.b * _B + 2 * x.bb * _B)
    ),
}


def _virus(x: Any, u: Any, p: Any) -> Mapping[str, Any]:
    """Infected cells, virus that still infects and virus that no longer does, in units of a million."""
    return {
        "cells": 3.9e-7 * 11000.0 * x.old - p.delta * x.cells,
        "old": -p.c * x.old,
        "new": 480.0 * p.delta * x.cells - p.c * x.new,
    }


def _immune(x: Any, u: Any, p: Any) -> Mapping[str, Any]:
    """Naive, early, late and memory cells of one clone, and a pathogen that grows without end unless these come in time."""
    return {
        "naive": -(p.mu_n + p.delta_ne * x.pathogen) * x.naive,
        "early": p.delta_ne * x.pathogen * x.naive + (p.rho_e * x.pathogen - p.mu_ee * x.early - p.delta_el) * x.early,
        "late": p.delta_el * x.early - (p.mu_ll * x.late + p.mu_le * x.early + p.delta_lm) * x.late,
        "memory": p.delta_lm * x.late,
        "pathogen": (p.rho_p * x.pathogen - p.mu_pe * x.early - p.mu_pl * x.late - p.mu_p) * x.pathogen,
    }


def _repressilator(x: Any, u: Any, p: Any) -> Mapping[str, Any]:
    """Three genes, each of which represses the next: messengers and proteins, in minutes."""

    def made(repressor: Any) -> Any:
        ratio = repressor / p.half
        return p.leak + p.strength / (1.0 + ratio * ratio)

    return {
        "ma": made(x.pc) - p.decay * x.ma,
        "mb": made(x.pa) - p.decay * x.mb,
        "mc": made(x.pb) - p.decay * x.mc,
        "pa": p.translate * x.ma - p.lose * x.pa,
        "pb": p.translate * x.mb - p.lose * x.pb,
        "pc": p.translate * x.mc - p.lose * x.pc,
    }


def _goodwin(x: Any, u: Any, p: Any) -> Mapping[str, Any]:
    """A messenger that the end of its chain holds back to the tenth power."""
    square = x.z * x.z
    fifth = square * square * x.z
    return {
        "x": p.a1 / (1.0 + p.a2 * fifth * fifth) - p.alpha * x.x,
        "y": p.k1 * x.x - p.alpha * x.y,
        "z": p.k2 * x.y - p.alpha * x.z,
    }


def _glycolysis(x: Any, u: Any, p: Any) -> Mapping[str, Any]:
    """Seven substances of yeast that swing together."""
    ratio = x.atp / p.inhibit
    square = ratio * ratio
    v1 = p.k1 * x.s1 * x.atp / (1.0 + square * square)
    v2, v3, v4 = p.k2 * x.s2 * (1.0 - x.n), p.k3 * x.s3 * (4.0 - x.atp), p.k4 * x.s4 * x.n
    v6, out = p.k6 * x.s2 * x.n, p.kappa * (x.s4 - x.s7)
    return {
        "s1": p.supply - v1,
        "s2": 2.0 * v1 - v2 - v6,
        "s3": v2 - v3,
        "s4": v3 - v4 - out,
        "n": v2 - v4 - v6,
        "atp": -2.0 * v1 + 2.0 * v3 - p.k5 * x.atp,
        "s7": 0.1 * out - p.k * x.s7,
    }


def _kinases(x: Any, u: Any, p: Any) -> Mapping[str, Any]:
    """Three kinases in a row, the last of which holds the first back; seconds, the rest of each from its sum."""
    one, two, three = 100.0 - x.a, 300.0 - x.b1 - x.b2, 300.0 - x.c1 - x.c2
    v1 = p.v1 * one / ((1.0 + x.c2 / p.ki) * (10.0 + one))
    v2 = p.v2 * x.a / (8.0 + x.a)
    v3, v4 = p.k3 * x.a * two / (15.0 + two), p.k4 * x.a * x.b1 / (15.0 + x.b1)
    v5, v6 = p.v5 * x.b2 / (15.0 + x.b2), p.v6 * x.b1 / (15.0 + x.b1)
    v7, v8 = p.k7 * x.b2 * three / (15.0 + three), p.k8 * x.b2 * x.c1 / (15.0 + x.c1)
    v9, v10 = p.v9 * x.c2 / (15.0 + x.c2), p.v10 * x.c1 / (15.0 + x.c1)
    return {"a": v1 - v2, "b1": v3 - v4 + v5 - v6, "b2": v4 - v5, "c1": v7 - v8 + v9 - v10, "c2": v8 - v9}


def _cell_cycle(x: Any, u: Any, p: Any) -> Mapping[str, Any]:
    """A cyclin and the kinase that it activates, by itself the more the more there is; minutes."""
    grown = (p.k4s + p.k4 * x.m * x.m) * x.pm
    return {
        "c": p.k6 * x.m - p.k8 * x.c + p.k9 * x.cp,
        "cp": -p.k3 * x.cp * x.y + p.k8 * x.c - p.k9 * x.cp,
        "pm": p.k3 * x.cp * x.y - grown,
        "m": grown - p.k6 * x.m,
        "y": p.k1 - p.k3 * x.cp * x.y,
        "yp": p.k6 * x.m - p.k7 * x.yp,
    }


def _nerve(x: Any, u: Any, p: Any) -> Mapping[str, Any]:
    return {"v": p.c * (x.v - x.v * x.v * x.v / 3.0 + x.r), "r": -(x.v - p.a + p.b * x.r) / p.c}


def _nitrile(x: Any, u: Any, p: Any) -> Mapping[str, Any]:
    """Six substances of an oxidation by air whose slowest step takes hours."""
    r1 = p.k1 * x.y1 * x.y1 * x.y1 * x.y1 * sqrt(x.y2)
    r2, r3, r4 = p.k2 * x.y3 * x.y4, p.k2 / p.kk * x.y1 * x.y5, p.k3 * x.y1 * x.y4 * x.y4
    r5 = p.k4 * x.y6 * x.y6 * sqrt(x.y2)
    air = 3.3 * (0.9 / 737.0 - x.y2)
    return {
        "y1": -2.0 * r1 + r2 - r3 - r4,
        "y2": -0.5 * r1 - r4 - 0.5 * r5 + air,
        "y3": r1 - r2 + r3,
        "y4": -r2 + r3 - 2.0 * r4,
        "y5": r2 - r3 + r5,
        "y6": 1e3 * (115.83 * x.y1 * x.y4 - x.y6),
    }


def _pyridine(x: Any, u: Any, p: Any) -> Mapping[str, Any]:
    """Seven substances of the removal of nitrogen from pyridine over a catalyst."""
    r3, r4, r10, r11 = p.p3 * x.b * x.c, p.p4 * x.c * x.c, p.p10 * x.d * x.f, p.p11 * x.e * x.f
    return {
        "a": -p.p1 * x.a + p.p9 * x.b,
        "b": p.p1 * x.a - (p.p2 + p.p9) * x.b - r3 + p.p7 * x.d + r10,
        "c": p.p2 * x.b - r3 - 2.0 * r4 - p.p6 * x.c + p.p8 * x.e + r10 + 2.0 * r11,
        "d": r3 - (p.p5 + p.p7) * x.d - r10,
        "e": r4 + p.p5 * x.d - p.p8 * x.e - r11,
        "f": r3 + r4 + p.p6 * x.c - r10 - r11,
        "g": p.p6 * x.c + p.p7 * x.d + p.p8 * x.e,
    }


def _pathway(x: Any, u: Any, p: Any) -> Mapping[str, Any]:
    """Three genes, their enzymes and two metabolites between a substrate and a product, which holds the genes back."""
    product = u.p

    def gene(v: Any, ki: Any, ka: Any, activator: Any) -> Any:
        held, moved = product / ki, ka / activator
        return v / (1.0 + held * held + moved * moved)

    flow1 = p.kcat1 * x.e1 * (u.s - x.m1) / (1.0 + u.s + x.m1 / p.km2)
    flow2 = p.kcat2 * x.e2 * (x.m1 - x.m2) / (1.0 + x.m1 + x.m2 / p.km4)
    flow3 = p.kcat3 * x.e3 * (x.m2 - product) / (1.0 + x.m2 + product)
    return {
        "g1": gene(p.v1, p.ki1, 1.0, u.s) - x.g1,
        "g2": gene(p.v2, p.ki2, p.ka2, x.m1) - x.g2,
        "g3": gene(p.v3, p.ki3, p.ka3, x.m2) - x.g3,
        "e1": p.v4 * x.g1 / (1.0 + x.g1) - p.k4 * x.e1,
        "e2": p.v5 * x.g2 / (1.0 + x.g2) - p.k5 * x.e2,
        "e3": p.v6 * x.g3 / (1.0 + x.g3) - p.k6 * x.e3,
        "m1": flow1 - flow2,
        "m2": flow2 - flow3,
    }


def _jakstat(x: Any, u: Any, p: Any) -> Mapping[str, Any]:
    """STAT5 that a receptor phosphorylates, that pairs, enters the nucleus and leaves it through a chain of stages."""
    pairs = p.k2 * x.p * x.p
    chain = {f"n{k}": p.k4 * ((x.n1 if k == 2 else getattr(x, f"n{k - 1}")) - getattr(x, f"n{k}")) for k in range(2, 6)}
    return {
        "s": -p.k1 * u.receptor * x.s + 2.0 * p.k4 * x.n5,
        "p": p.k1 * u.receptor * x.s - 2.0 * pairs,
        "d": pairs - p.k3 * x.d,
        "n1": p.k3 * x.d - p.k4 * x.n1,
        **chain,
    }


def _clock(x: Any, u: Any, p: Any) -> Mapping[str, Any]:
    """Messenger, protein with none, one and two phosphates, and what of it is in the nucleus of a fly; hours."""
    n2 = x.pn / p.ki * x.pn / p.ki
    to1 = p.v1 * x.p0 / (2.0 + x.p0) - p.v2 * x.p1 / (2.0 + x.p1)
    to2 = p.v3 * x.p1 / (2.0 + x.p1) - p.v4 * x.p2 / (2.0 + x.p2)
    return {
        "m": p.vs / (1.0 + n2 * n2) - p.vm * x.m / (0.5 + x.m),
        "p0": p.ks * x.m - to1,
        "p1": to1 - to2,
        "p2": to2 - p.k1 * x.p2 + p.k2 * x.pn - p.vd * x.p2 / (0.2 + x.p2),
        "pn": p.k1 * x.p2 - p.k2 * x.pn,
    }


def _axon(x: Any, u: Any, p: Any) -> Mapping[str, Any]:
    """The giant axon of a squid: millivolts from rest, milliseconds."""
    v = x.v
    return {
        "v": (
            u.i
            - p.gna * x.m * x.m * x.m * x.h * (v - 115.0)
            - p.gk * x.n * x.n * x.n * x.n * (v + 12.0)
            - p.gl * (v - 10.613)
        )
        / p.c,
        "m": 0.1 * (25.0 - v) / (exp((25.0 - v) / 10.0) - 1.0) * (1.0 - x.m) - 4.0 * exp(-v / 18.0) * x.m,
        "h": 0.07 * exp(-v / 20.0) * (1.0 - x.h) - x.h / (exp((30.0 - v) / 10.0) + 1.0),
        "n": 0.01 * (10.0 - v) / (exp((10.0 - v) / 10.0) - 1.0) * (1.0 - x.n) - 0.125 * exp(-v / 80.0) * x.n,
    }


_PATHWAY_TIME = np.linspace(0.0, 120.0, 61)
_AXON_TIME = np.linspace(0.0, 40.0, 201)
_STAT5_TIME = np.array([0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 25, 30, 40, 50, 60.0])

NETWORKS: dict[str, StiffProblem] = {
    # Boehm and others, Journal of Proteome Research 13, 2014; import of equal pairs is faster than anything measured.
    "STAT5 pairs": StiffProblem(
        _stat5,
        {"hormone": 1.0, "a": 207.6 * 0.693, "b": 207.6 * 0.307}
        | dict.fromkeys(("aa", "ab", "bb", "naa", "nab", "nbb"), 0.0),
        {
            "degrade": 0.026983,
            "out_hetero": 1e-5,
            "out_homo": 0.0061702,
            "in_hetero": 0.016368,
            "in_homo": 97749.0,
            "phos": 15766.5,
        },
        np.array([0, 2.5, 5, 10, 15, 20, 30, 40, 50, 60, 80, 100, 120, 160, 200, 240.0]),
        ("pa", "pb", "ra"),
        {},
        noise=0.05,
        read=_STAT5_OUTPUTS,
    ),
    # Perelson and others, Science 271, 1996: virus after an inhibitor, days; millions a millilitre.
    "virus": StiffProblem(
        _virus,
        {"cells": 0.01506132, "old": 1.86, "new": 0.0},
        {"c": 2.06, "delta": 0.53},
        np.array([0, 0.083, 0.166, 0.25, 0.5, 0.75, 1, 1.25, 1.5, 1.75, 2, 3, 4, 5, 6, 7.0]),
        ("v",),
        {},
        noise=0.1,
        read={"v": lambda x, p: x.old + x.new},
    ),
    # Crauste and others, Cell Systems 4, 2017: at these constants, a thousandth off in one of them the pathogen grows without end.
    "immune cells": StiffProblem(
        _immune,
        {"naive": 8090.0, "early": 0.0, "late": 0.0, "memory": 0.0, "pathogen": 1.0},
        {
            "delta_el": 0.51794597529254,
            "delta_lm": 0.0225806365892933,
            "delta_ne": 0.0119307857579241,
            "mu_ee": 3.91359322673521e-05,
            "mu_le": 1e-10,
            "mu_ll": 8.11520135326853e-06,
            "mu_n": 0.739907308603256,
            "mu_p": 1.00000002976846e-05,
            "mu_pe": 1.36571832778378e-10,
            "mu_pl": 3.6340308186265e-05,
            "rho_e": 0.507415703707752,
            "rho_p": 0.126382288121756,
        },
        np.array([0, 4, 5, 6, 7, 8, 9, 10, 12, 14, 16, 19, 22, 28.0]),
        ("naive", "early", "late", "memory"),
        {},
        noise=0.05,
    ),
    # Elowitz and Leibler, Nature 403, 2000: their constants, one protein measured every ten minutes.
    "repressilator": StiffProblem(
        _repressilator,
        {"ma": 0.0, "mb": 20.0, "mc": 0.0, "pa": 0.0, "pb": 0.0, "pc": 0.0},
        {"strength": 29.97, "leak": 0.03, "half": 40.0, "decay": 0.34657, "translate": 6.931, "lose": 0.069315},
        np.arange(0.0, 601.0, 10.0),
        ("pa", "pb"),
        {},
        noise=0.05,
    ),
    # Goodwin 1965 with the constants and rows of Girolami and Calderhead, Journal of the Royal Statistical Society B 73, 2011.
    "Goodwin": StiffProblem(
        _goodwin,
        {"x": 0.0, "y": 0.0, "z": 0.0},
        {"a1": 1.0, "a2": 3.0, "k1": 2.0, "k2": 1.0, "alpha": 0.5},
        np.arange(0.0, 81.0),
        ("x", "y"),
        {},
        noise=0.1,
    ),
    # Ruoff and others, Biophysical Chemistry 106, 2003; minutes.
    "glycolysis": StiffProblem(
        _glycolysis,
        {"s1": 1.187, "s2": 0.193, "s3": 0.05, "s4": 0.115, "n": 0.077, "atp": 2.475, "s7": 0.077},
        {
            "supply": 2.5,
            "k1": 100.0,
            "k2": 6.0,
            "k3": 16.0,
            "k4": 100.0,
            "k5": 1.28,
            "k6": 12.0,
            "k": 1.8,
            "kappa": 13.0,
            "inhibit": 0.52,
        },
        np.linspace(0.0, 5.0, 51),
        ("s1", "n", "atp", "s7"),
        {},
        noise=0.05,
    ),
    # Kholodenko, European Journal of Biochemistry 267, 2000; half-saturations held.
    "kinase cascade": StiffProblem(
        _kinases,
        {"a": 10.0, "b1": 10.0, "b2": 10.0, "c1": 10.0, "c2": 10.0},
        {
            "v1": 2.5,
            "ki": 9.0,
            "v2": 0.25,
            "k3": 0.025,
            "k4": 0.025,
            "v5": 0.75,
            "v6": 0.75,
            "k7": 0.025,
            "k8": 0.025,
            "v9": 0.5,
            "v10": 0.5,
        },
        np.linspace(0.0, 3600.0, 61),
        ("a", "b2", "c2"),
        {},
        noise=0.05,
    ),
    # Tyson, PNAS 88, 1991: one exchange a million times faster than the cycle of half an hour.
    "cell cycle": StiffProblem(
        _cell_cycle,
        {"c": 0.0, "cp": 0.75, "m": 0.0, "pm": 0.25, "y": 0.0, "yp": 0.0},
        {
            "k1": 0.015,
            "k3": 200.0,
            "k4": 180.0,
            "k4s": 0.018,
            "k6": 1.0,
            "k7": 0.6,
            "k8": 1e6,
            "k9": 1e3,
        },
        np.linspace(0.0, 100.0, 101),
        ("m", "yp"),
        {},
        ("k1", "k4", "k4s", "k6", "k7"),
        0.05,
    ),
    # FitzHugh 1961 and Nagumo 1962 with the constants and rows of Ramsay and others, Journal of the Royal Statistical Society B 69, 2007.
    "nerve": StiffProblem(
        _nerve,
        {"v": -1.0, "r": 1.0},
        {"a": 0.2, "b": 0.2, "c": 3.0},
        np.linspace(0.0, 20.0, 401),
        ("v", "r"),
        {},
        noise=0.1,
    ),
    # Stortelder 1998 (Akzo Nobel), as in the test set of Mazzia and Magherini; the equilibrium is a fast exchange here.
    "nitrile": StiffProblem(
        _nitrile,
        {"y1": 0.444, "y2": 0.00123, "y3": 0.0, "y4": 0.007, "y5": 0.0, "y6": 115.83 * 0.444 * 0.007},
        {"k1": 18.7, "k2": 0.58, "k3": 0.09, "k4": 0.42, "kk": 34.4},
        np.linspace(0.0, 180.0, 61),
        ("y1", "y3", "y4", "y5"),
        {},
        noise=0.02,
    ),
    # The five below took no part in setting anything of the library.
    # Bock, in: Modelling of Chemical Reaction Systems, 1981.
    "pyridine": StiffProblem(
        _pyridine,
        {"a": 1.0} | dict.fromkeys("bcdefg", 0.0),
        {
            "p1": 1.81,
            "p2": 0.894,
            "p3": 29.4,
            "p4": 9.21,
            "p5": 0.058,
            "p6": 2.43,
            "p7": 0.0644,
            "p8": 5.55,
            "p9": 0.0201,
            "p10": 0.577,
            "p11": 2.15,
        },
        np.linspace(0.0, 6.0, 25),
        tuple("abcdefg"),
        {},
        noise=(0.02, 0.05, 0.03, 0.05, 0.08, 0.02, 0.03),
    ),
    # Moles, Mendes and Banga, Genome Research 13, 2003: half of their 36 constants, exponents held.
    "three-step pathway": StiffProblem(
        _pathway,
        {
            "g1": 0.66667,
            "g2": 0.57254,
            "g3": 0.41758,
            "e1": 0.4,
            "e2": 0.36409,
            "e3": 0.29457,
            "m1": 1.419,
            "m2": 0.93464,
        },
        {
            "v1": 1.0,
            "v2": 1.0,
            "v3": 1.0,
            "ki1": 1.0,
            "ki2": 1.0,
            "ki3": 1.0,
            "ka2": 1.0,
            "ka3": 1.0,
            "v4": 0.1,
            "v5": 0.1,
            "v6": 0.1,
            "k4": 0.1,
            "k5": 0.1,
            "k6": 0.1,
            "kcat1": 1.0,
            "kcat2": 1.0,
            "kcat3": 1.0,
            "km2": 1.0,
            "km4": 1.0,
        },
        _PATHWAY_TIME,
        ("g1", "g2", "g3", "e1", "e2", "e3", "m1", "m2"),
        {
            "s": np.resize(np.repeat([0.1, 2.15, 0.46, 10.0], 10), 61),
            "p": np.resize(np.repeat([0.05, 0.37, 1.0], 12), 61),
        },
        noise=(0.05, 0.05, 0.05, 0.03, 0.03, 0.03, 0.02, 0.02),
    ),
    # Swameye and others, PNAS 100, 2003: the receptor as they measured it, roughly; one stage of the chain is a fifth of the delay.
    "STAT5 cycle": StiffProblem(
        _jakstat,
        {"s": 1.0} | dict.fromkeys(("p", "d", "n1", "n2", "n3", "n4", "n5"), 0.0),
        {"k1": 2.43, "k2": 1.35, "k3": 0.27, "k4": 0.75},
        _STAT5_TIME,
        ("phosphorylated", "total"),
        {"receptor": 1.0 * (_STAT5_TIME / 6.0) * np.exp(1.0 - _STAT5_TIME / 6.0)},
        noise=(0.08, 0.05),
        read={"phosphorylated": lambda x, p: x.p + 2.0 * x.d, "total": lambda x, p: x.s + x.p + 2.0 * x.d},
    ),
    # Goldbeter, Proceedings of the Royal Society B 261, 1995: his constants, half-saturations held.
    "fly clock": StiffProblem(
        _clock,
        {"m": 0.1, "p0": 0.25, "p1": 0.25, "p2": 0.25, "pn": 0.25},
        {
            "vs": 0.76,
            "vm": 0.65,
            "ki": 1.0,
            "ks": 0.38,
            "v1": 3.2,
            "v2": 1.58,
            "v3": 5.0,
            "v4": 2.5,
            "k1": 1.9,
            "k2": 1.3,
            "vd": 0.95,
        },
        np.linspace(0.0, 72.0, 73),
        ("m", "total"),
        {},
        noise=(0.08, 0.04),
        read={"total": lambda x, p: x.p0 + x.p1 + x.p2 + x.pn},
    ),
    # Hodgkin and Huxley, Journal of Physiology 117, 1952.
    "axon": StiffProblem(
        _axon,
        {"v": 0.0, "m": 0.05293, "h": 0.59612, "n": 0.31768},
        {"gna": 120.0, "gk": 36.0, "gl": 0.3, "c": 1.0},
        _AXON_TIME,
        ("v",),
        {"i": np.where((_AXON_TIME >= 2.0) & (_AXON_TIME < 3.0), 20.0, np.where(_AXON_TIME > 15.0, 10.0, 0.0))},
        noise=0.03,
    ),
}

PART = """## Published networks and stiff models

Equations, constants and sampling are those of each source (in `fits/studies/published_networks.py` and `fits/studies/stiff_problems.py`);
the data are runs of an independent solver (Radau of SciPy) at these constants with noise of known size. Every fit is
`gb.fit(model, record, noise=..., options=gb.FitOptions(at_rest=True))`.

- *Reached*: the sum of squares of the constants, by the independent solver, is not above that of the published ones.
- *Three times off*: every constant, up and down in turn. *Random starts*: as above, up to {random} of them until one reaches the optimum.
- *Seconds*: CPU time of the longest of these fits. *Missed*: as above.

### Networks: {networks}

| problem | states, constants | from the published constants | three times off | random starts | seconds | missed |
|---|---|---|---|---|---|---|
{network_rows}

### Stiff models: {models}

| problem | states, constants | from the published constants | three times off | random starts | seconds | missed |
|---|---|---|---|---|---|---|
{model_rows}

{why}
"""

WHY = """What misses are starts from which the model swings in another rhythm, or not at all, or whose constants leave what is measured
where it is: each such end is an optimum of its own or a plateau, and one of ten starts leads past it where the table says so."""


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="Published networks with their constants.")
    parser.add_argument("--random", type=int, default=10, help="number of random starts")
    parser.add_argument("--only", choices=list(NETWORKS), action="append", help="this network alone; may be repeated")
    parser.add_argument("--page", type=Path, help="folder of the page for both tables")
    given = parser.parse_args(arguments)
    tables = []
    for problems in (NETWORKS, stiff_problems.PROBLEMS) if given.page else (NETWORKS,):
        lines, reached = [], []
        for name in (given.only if given.only and problems is NETWORKS else None) or problems:
            each, line = study(problems[name], name, given.random)
            sys.stdout.write(line + "\n")
            sys.stdout.flush()
            lines.append(line)
            reached.append(each)
        held, near, best = (sum(ends) for ends in zip(*((r[0], r[1], r[2]) for r in reached), strict=True))
        summary = (
            f"{held} of {len(reached)} held, {near} found from three times off, {best} from the best of {given.random}"
        )
        sys.stdout.write(summary + "\n")
        tables.append((summary, "\n".join(lines)))
    if given.page:
        (networks, network_rows), (models, model_rows) = tables
        text = PART.format(
            random=given.random,
            networks=networks,
            network_rows=network_rows,
            models=models,
            model_rows=model_rows,
            why=WHY,
        )
        write_section(given.page, "2 networks", text, published_problems.PAGE, published_problems.HEAD)


if __name__ == "__main__":
    main()
