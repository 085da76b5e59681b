"""Ranks and pseudo-inverses against exact arithmetic and against matrices whose singular values are known."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from greybox.base.linear_algebra import (
    COLUMN_RANK,
    INFORMATION_RANK,
    RankTolerance,
    are_independent,
    decompose_columns,
    decompose_symmetric,
    eliminate,
    pseudo_inverse,
    range_basis,
)


def exact_rank(matrix: np.ndarray) -> int:
    """Rank of a matrix of integers, by elimination with fractions."""
    rows = [[Fraction(int(v)) for v in row] for row in matrix]
    rank = 0
    for column in range(matrix.shape[1]):
        pivot = next((k for k in range(rank, len(rows)) if rows[k][column]), None)
        if pivot is None:
            continue
        rows[rank], rows[pivot] = rows[pivot], rows[rank]
        for k in range(rank + 1, len(rows)):
            factor = rows[k][column] / rows[rank][column]
            rows[k] = [a - factor * b for a, b in zip(rows[k], rows[rank], strict=True)]
        rank += 1
    return rank


def random_orthogonal(generator: np.random.Generator, rows: int, columns: int) -> np.ndarray:
    return np.linalg.qr(generator.normal(size=(rows, columns)))[0]


@pytest.mark.parametrize("seed", range(20))
def test_rank_of_whole_numbers_is_the_exact_one_in_any_units(seed):
    generator = np.random.default_rng(seed)
    rows, columns, rank = generator.integers(1, 9, size=3)
    rank = min(rank, rows, columns)
    matrix = generator.integers(-4, 5, (rows, rank)) @ generator.integers(-4, 5, (rank, columns))
    units = 10.0 ** generator.integers(-30, 30, columns)
    expected = exact_rank(matrix)
    decomposition = decompose_columns(matrix * units)
    assert decomposition.rank == expected and decomposition.is_certain
    null, row = decomposition.null_basis, decomposition.row_basis
    assert null.shape == (columns, columns - expected) and row.shape == (columns, expected)
    assert null.T @ null == pytest.approx(np.eye(columns - expected), abs=1e-12)
    # both in units of the unknowns, whose sizes range over 60 decades: compared after scaling
    weak = decomposition.weak / decomposition.scale[:, None]
    assert np.abs(matrix * units @ weak).max(initial=0.0) < 1e-11
    symmetric = decompose_symmetric((matrix * units).T @ (matrix * units))
    assert symmetric.rank == expected and symmetric.is_certain


def test_null_and_row_space_are_orthogonal_complements():
    # [1, 2, 3] does not see (2, -1, 0) and (3, 0, -1)
    decomposition = decompose_columns(np.array([[1.0, 2.0, 3.0]]))
    assert decomposition.rank == 1
    assert decomposition.null_basis.T @ np.array([1.0, 2.0, 3.0]) == pytest.approx(np.zeros(2), abs=1e-14)
    assert np.abs(decomposition.row_basis[:, 0]) == pytest.approx(np.array([1.0, 2.0, 3.0]) / np.sqrt(14))
    assert decomposition.is_open.all()


@pytest.mark.parametrize(("least", "rank", "certain_rank"), [(1e-7, 3, 3), (1e-9, 3, 2), (3e-12, 2, 2), (0.0, 2, 2)])
def test_between_rounding_and_information_lies_doubt(least, rank, certain_rank):
    # columns of an orthogonal times the symmetric matrix with ones on the diagonal and eigenvalues 2 - least^2, 1, least^2
    cosine = 1 - least**2
    sine = least * np.sqrt(
        2 - least**2
    )  # of the angle between the first two columns, without the rounding of 1 - cosine
    triangle = np.array([[1.0, cosine, 0.0], [0.0, sine, 0.0], [0.0, 0.0, 1.0]])
    matrix = random_orthogonal(np.random.default_rng(0), 50, 3) @ triangle
    decomposition = decompose_columns(matrix, COLUMN_RANK)
    assert decomposition.values == pytest.approx([np.sqrt(2 - least**2), 1.0, least], abs=1e-15)
    assert decomposition.rank == rank and decomposition.without_doubtful().rank == certain_rank
    assert decomposition.is_certain == (rank == certain_rank)


@pytest.mark.parametrize(("least", "rank", "certain_rank"), [(1e-8, 2, 2), (1e-11, 2, 1), (1e-14, 1, 1)])
def test_an_information_has_lines_of_its_own(least, rank, certain_rank):
    decomposition = decompose_symmetric(np.array([[4.0, 2e9 * (1 - least)], [2e9 * (1 - least), 1e18]]))
    assert decomposition.values == pytest.approx([2 - least, least], abs=1e-15)
    assert decomposition.rank == rank and decomposition.without_doubtful().rank == certain_rank
    assert decomposition.tolerance == INFORMATION_RANK


def test_pseudo_inverse_meets_the_conditions_of_moore_and_penrose():
    generator = np.random.default_rng(1)
    half = generator.normal(size=(6, 4))
    a = half @ half.T
    scale = np.sqrt(np.diag(a))
    scaled, inverse = a / np.outer(scale, scale), pseudo_inverse(a) * np.outer(scale, scale)
    for left, right in (
        (scaled @ inverse @ scaled, scaled),
        (inverse @ scaled @ inverse, inverse),
        (scaled @ inverse, (scaled @ inverse).T),
    ):
        assert left == pytest.approx(right, abs=1e-10)
    decomposition = decompose_symmetric(a)
    assert decomposition.solve(a[:, 0]) == pytest.approx(decomposition.pseudo_inverse @ a[:, 0], abs=1e-12)
    assert decomposition.solve(a) == pytest.approx(decomposition.pseudo_inverse @ a, abs=1e-12)
    assert decomposition.root @ decomposition.root.T == pytest.approx(a)


def test_inverse_of_the_hilbert_matrix_is_the_known_one():
    n = 5
    hilbert = 1 / (np.arange(n)[:, None] + np.arange(n) + 1.0)
    known = np.array(
        [
            [25, -300, 1050, -1400, 630],
            [-300, 4800, -18900, 26880, -12600],
            [1050, -18900, 79380, -117600, 56700],
            [-1400, 26880, -117600, 179200, -88200],
            [630, -12600, 56700, -88200, 44100],
        ]
    )
    assert pseudo_inverse(hilbert) == pytest.approx(known, rel=1e-9)


def test_information_that_rounding_made_negative_is_none():
    # of a run that has left all bounds: what remains of the second constant is a rounding error
    decomposition = decompose_symmetric(np.array([[4.0, 1e80, 0.0], [1e80, -1e160, 0.0], [0.0, 0.0, 9.0]]))
    assert decomposition.pseudo_inverse == pytest.approx(np.diag([1 / 4, 0, 1 / 9]))
    assert decomposition.is_open.tolist() == [False, True, False]


def test_least_squares_is_the_exact_solution_and_the_shortest_where_columns_depend():
    time = np.arange(20.0)
    line = decompose_columns(np.stack([np.ones(20), 1e12 * time], axis=1))
    assert line.solve(3 + 2 * time) == pytest.approx([3, 2e-12], rel=1e-10)
    twice = decompose_columns(np.stack([time, 10 * time], axis=1))  # shares alike of both scaled columns
    assert twice.solve(4 * time) == pytest.approx([2, 0.2])


def test_eliminated_unknowns_leave_the_schur_complement():
    generator = np.random.default_rng(2)
    rows = generator.normal(size=(30, 5)) * 10.0 ** np.array([0, 3, -3, 6, -6])
    information = rows.T @ rows
    kept, others = np.array([0, 3]), np.array([1, 2, 4])
    reduced = eliminate(information, kept, others) @ information
    assert reduced[:, others] / np.sqrt(np.diag(information))[others] == pytest.approx(np.zeros((2, 3)), abs=1e-4)
    expected = np.linalg.inv(np.linalg.inv(information / 1e3)[np.ix_(kept, kept)]) * 1e3
    assert reduced[:, kept] == pytest.approx(expected, rel=1e-8)
    assert eliminate(information, np.arange(5), np.array([], int)) == pytest.approx(np.eye(5))


def test_spans_and_independence():
    columns = np.array([[1.0, 1e9, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
    assert range_basis(columns).shape == (3, 2)
    assert range_basis(np.zeros((3, 2))).shape == (3, 0)
    assert are_independent([np.array([1.0, 0.0]), np.array([1.0, 1e-3])])
    assert not are_independent([np.array([1.0, 0.0]), np.array([1.0, 1e-3])], cutoff=1e-2)
    assert not are_independent([np.array([1.0, 0.0]), np.array([0.0, 1.0]), np.array([1.0, 1.0])])
    assert not are_independent([np.zeros(2)])


def test_nothing_is_no_matter():
    assert decompose_symmetric(np.zeros((0, 0))).pseudo_inverse.shape == (0, 0)
    assert decompose_columns(np.zeros((0, 3)), RankTolerance(1e-9, 1e-9)).null_basis == pytest.approx(np.eye(3))
    assert decompose_columns(np.zeros((4, 0))).range_basis.shape == (4, 0)
    assert decompose_columns(np.eye(3)[:, :2] * 1e-200).gap > 1e15
