"""LU factors of one small dense matrix in place, for use inside a compiled loop.

LAPACK would allocate and cost more in its call than the solution of 7 equations does.
"""

from __future__ import annotations

from cosserat_fx.compiled import inline
from cosserat_fx.typing import Array, IntArray


@inline
def factorise(matrix: Array, pivots: IntArray, n: int) -> bool:
    """Replace a square matrix by its LU factors with partial pivoting.

    Args:
        matrix: (n, n) overwritten; the unit diagonal of L is not stored.
        pivots: (n,) receives the row exchanged with each row.
        n: the size, given so that the caller's constant unrolls the loops.

    Returns:
        False where a pivot is zero or not a number.
    """
    for k in range(n):
        pivot, largest = k, abs(matrix[k, k])
        for i in range(k + 1, n):
            if abs(matrix[i, k]) > largest:
                pivot, largest = i, abs(matrix[i, k])
        if not largest > 0.0:
            return False
        pivots[k] = pivot
        if pivot != k:
            for j in range(n):
                matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
        inverse = 1.0 / matrix[k, k]
        for i in range(k + 1, n):
            matrix[i, k] *= inverse
            for j in range(k + 1, n):
                matrix[i, j] -= matrix[i, k] * matrix[k, j]
    return True


@inline
def solve(matrix: Array, pivots: IntArray, columns: Array, n: int, m: int) -> None:
    """Solve in place for several right-hand sides with the factors of :func:`factorise`.

    Args:
        matrix: (n, n) factors.
        pivots: (n,) row exchanges.
        columns: (n, m) right-hand sides, replaced by the solutions.
        n, m: number of equations and of right-hand sides.
    """
    for k in range(n):
        pivot = pivots[k]
        if pivot != k:
            for j in range(m):
                columns[k, j], columns[pivot, j] = columns[pivot, j], columns[k, j]
    for i in range(1, n):
        for k in range(i):
            for j in range(m):
                columns[i, j] -= matrix[i, k] * columns[k, j]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            for j in range(m):
                columns[i, j] -= matrix[i, k] * columns[k, j]
        inverse = 1.0 / matrix[i, i]
        for j in range(m):
            columns[i, j] *= inverse
