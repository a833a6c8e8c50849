"""A run's folder: written row by row while the simulation goes on, read back afterwards.

``history.csv`` has one row per accepted step under the columns of its header, ``profiles.csv`` (of a layer) one block
of rows per requested displacement and ``run.json`` the summary. Whole lines are appended and the summary is replaced in
one move, so that a kill at any moment leaves a folder that :func:`read_run` reads. All numbers are in SI units, tension
positive. Under MPI only rank 0 calls this module, with data already gathered.
"""

from cosserat_fx.output.folder import FORMAT, RunFolder
from cosserat_fx.output.reading import Run, read_run
from cosserat_fx.output.tables import (
    BOUNDARY_COLUMNS,
    HISTORY_COLUMNS,
    PLANE_COLUMNS,
    PROFILE_COLUMNS,
    OutputError,
    Table,
)

__all__ = [
    "BOUNDARY_COLUMNS",
    "FORMAT",
    "HISTORY_COLUMNS",
    "PLANE_COLUMNS",
    "PROFILE_COLUMNS",
    "OutputError",
    "Run",
    "RunFolder",
    "Table",
    "read_run",
]
