"""How the tests start several ranks."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

TIMEOUT = 240  # s; ranks that wait for each other would wait for ever

# Small problems want no threads, and more ranks than cores have to give way to each other, which MPICH does on request.
ENVIRONMENT = os.environ | {
    "OMP_NUM_THREADS": "1",
    "MPIR_CVAR_ENABLE_HEAVY_YIELD": "1",
    "MPIR_CVAR_POLLS_BEFORE_YIELD": "1",
}


def mpiexec() -> str:
    """The launcher of the MPI that mpi4py is linked with: beside the interpreter or, of the system's, on the path."""
    beside = Path(sys.executable).with_name("mpiexec")
    found = str(beside) if beside.exists() else shutil.which("mpiexec")
    assert found is not None
    return found


def on_ranks(ranks: int, program: str, *arguments: object) -> str:
    """Runs a program with arguments (sys.argv[1:]) on so many ranks, and gives back what it printed."""
    command = [mpiexec(), "-n", str(ranks), sys.executable, "-c", program, *map(str, arguments)]
    done = subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, timeout=TIMEOUT)
    assert done.returncode == 0, done.stderr
    return done.stdout
