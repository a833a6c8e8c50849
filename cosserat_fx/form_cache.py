"""The cache of compiled forms on disk: neither a busy machine nor what a killed process left there stops a run.

FFCx marks a form that is being compiled by a file, which other processes wait for to be finished. A process that is
killed meanwhile leaves the mark for ever.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from time import time

from cosserat_fx._compat import MPI, dolfinx
from cosserat_fx.parallel import on_first_rank

PATIENCE = 120
"""How long to wait for another process to compile a form, and how old the mark of one is that has been killed (s)."""


def with_forms[Result](comm: MPI.Intracomm, work: Callable[[], Result]) -> Result:
    """Do something that compiles forms, once more where it has waited in vain for another process. Collective.

    Args:
        comm: the ranks.
        work: what to do.
    """
    dolfinx.jit.DOLFINX_DEFAULT_JIT_OPTIONS["timeout"] = (PATIENCE, "Seconds to wait for another process")
    folder = Path(dolfinx.jit.get_options()["cache_dir"])
    on_first_rank(comm, lambda: remove_abandoned(folder))
    try:
        return work()
    except (TimeoutError, RuntimeError) as error:  # the latter where there are several ranks
        if "JIT compilation" not in str(error):
            raise
        on_first_rank(comm, lambda: remove_abandoned(folder))
        return work()


def remove_abandoned(folder: Path) -> None:
    """Remove the marks of forms that nobody compiles any more.

    Args:
        folder: the cache; it need not exist.
    """
    for mark in folder.glob("libffcx_*.c"):
        try:
            if not mark.with_suffix(".c.cached").exists() and time() - mark.stat().st_mtime > PATIENCE:
                mark.unlink()
        except OSError:  # another process was quicker, or it is not ours
            continue
