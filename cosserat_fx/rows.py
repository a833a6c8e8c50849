"""Where the constitutive kernel keeps its numbers: rows of one array, in which points lie side by side in lanes.

Every quantity of a point has a row and every point a lane, so that the kernel's innermost loops run along rows and
become vector instructions. All rows belong to one array at places known to the compiler, which sees by them that they
do not overlap. Vectors have room for the largest layout; what a layout does not use is never touched.
"""

from __future__ import annotations

LANES = 64
"""Most points treated at once: enough to make up for the start of a loop, so few that they stay in the cache."""
_MOST = 18
_SCALARS = 38

# One number for each point.
NORM, INVERSE_NORM, VOLUME = 0, 1, 2
"""Norm of the scaled strain and curvature increment, its inverse (0 where it is 0), and the volume strain."""
E_N, E, E_BY_VOLUME = 3, 4, 5
"""Void ratio at the start and at the time in question, and the derivative of the latter by the volume strain."""
SUBSTEPS, BEGIN, SIZE, SCALE = 6, 7, 8, 9
"""Number of substeps; start and size of one; share of the increment that a stage has."""
FAILURE, ACTIVE, DAMPING, ESTIMATE = 10, 11, 12, 13
"""Status that ended the integration (0: none); 1 while Newton's method goes on; its damping; largest error estimate."""
CODE, TRACE, INVERSE_TRACE, POWER = 14, 15, 16, 17
"""Status of the state that the law was asked at; T (Pa), 1/T, P."""
F_S, F_D, A = 18, 19, 20
"""Stiffness factor (Pa), density factor, critical stress function."""
LOG_F_S_BY_TRACE, LOG_F_S_BY_E, F_D_BY_TRACE, F_D_BY_E = 21, 22, 23, 24
"""Derivatives with respect to T (1/Pa) and to e."""
DEVIATOR, GRADIENT = 25, 31
"""Six each: argument of the critical stress function and its derivative, order 11, 22, 33, 12, 13, 23."""
ALONG = 37
"""A sum on its way."""

# One number for each force component of each point.
D, WEIGHTED_D = _SCALARS, _SCALARS + _MOST
"""Scaled strain and curvature increment, zero where the kinematics allows none; the same times its multiplicity."""
Y, BASE, STAGE, CANDIDATE = (_SCALARS + k * _MOST for k in range(2, 6))
"""Scaled states of a substep: at its start, known part of a stage, the stage, its next iterate (Pa)."""
RATE, MATERIAL_RATE, Z, FLOW, ALPHA, A_BY_Y = (_SCALARS + k * _MOST for k in range(6, 12))
"""The law's rate with the objective terms and without (Pa), y/T, 2 z - delta/3, a or a_c, da/dy (1/Pa)."""
BY_A, BY_POWER, BY_TRACE, DIAGONAL = (_SCALARS + k * _MOST for k in range(12, 16))
"""Factors of the Jacobian's outer products and its diagonal."""
EXPLICIT, CORRECTION = (_SCALARS + k * _MOST for k in range(16, 18))
"""What an explicit step would add to the state; correction of Newton's method, and the error estimate."""
SPIN = _SCALARS + 18 * _MOST
"""Spin increment, three components."""
MATRIX = SPIN + 3
"""Of a stage, (n, n) row by row."""
SENSITIVITY = MATRIX + _MOST * _MOST
"""Derivatives of y, (n, inputs) row by row."""
STAGE_SENSITIVITY = SENSITIVITY + _MOST * (_MOST + 3)
"""Derivatives of the stage."""
NUMBER = STAGE_SENSITIVITY + _MOST * (_MOST + 3)
"""Of rows altogether."""
