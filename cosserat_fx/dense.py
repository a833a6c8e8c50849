"""LU factors of many small dense matrices at once, one in each lane, for use inside a compiled loop.

LAPACK would allocate and cost more in its call than the solution of 7 equations does, and takes one matrix at a time.
There is no pivoting, which would have to differ from lane to lane: the matrices are those of implicit stages, which
tend to the identity as the substep shrinks. A zero pivot leaves infinities behind, for the caller to notice.
"""

from __future__ import annotations

from cosserat_fx.compiled import kernel
from cosserat_fx.typing import Array


@kernel
def factorise(rows: Array, matrix: int, n: int, lanes: int) -> None:
    """Replace square matrices by their LU factors; the unit diagonal of L is not stored, that of U is inverted.

    Args:
        rows: (rows, LANES) the kernel's numbers.
        matrix: the matrices' first row; entry i, j is in the row ``matrix + i * n + j``.
        n: number of equations.
        lanes: number of points.
    """
    for k in range(n):
        pivot = matrix + k * n + k
        for lane in range(lanes):
            rows[pivot, lane] = 1.0 / rows[pivot, lane]
        for i in range(k + 1, n):
            factor = matrix + i * n + k
            for lane in range(lanes):
                rows[factor, lane] *= rows[pivot, lane]
            for j in range(k + 1, n):
                for lane in range(lanes):
                    rows[matrix + i * n + j, lane] -= rows[factor, lane] * rows[matrix + k * n + j, lane]


@kernel
def solve(rows: Array, matrix: int, columns: int, n: int, m: int, lanes: int) -> None:
    """Solve in place for several right-hand sides with the factors of :func:`factorise`.

    Args:
        rows: (rows, LANES) the kernel's numbers.
        matrix: first row of the factors.
        columns: first row of the right-hand sides, (n, m) row by row, replaced by the solutions.
        n, m: number of equations and of right-hand sides.
        lanes: number of points.
    """
    for i in range(1, n):
        for k in range(i):
            factor = matrix + i * n + k
            for j in range(m):
                for lane in range(lanes):
                    rows[columns + i * m + j, lane] -= rows[factor, lane] * rows[columns + k * m + j, lane]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            factor = matrix + i * n + k
            for j in range(m):
                for lane in range(lanes):
                    rows[columns + i * m + j, lane] -= rows[factor, lane] * rows[columns + k * m + j, lane]
        pivot = matrix + i * n + i
        for j in range(m):
            for lane in range(lanes):
                rows[columns + i * m + j, lane] *= rows[pivot, lane]
