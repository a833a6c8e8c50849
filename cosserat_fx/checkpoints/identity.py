"""Which scene a checkpoint belongs to: all of it that decides what the fields and states in the file mean."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from cosserat_fx.scene import Scene

_FREE = {"title", "stepping", "output"}
"""What may be changed between the two halves of a run."""
_FREE_IN_SOLVER = {"newton_tolerance", "max_iterations", "local_tolerance", "linear", "petsc"}


def identity(scene: Scene) -> dict[str, Any]:
    """What of a scene has to stay when a run of it goes on, by dotted key.

    Files are known by what they hold, not by where they are.

    Args:
        scene: the scene.

    Raises:
        OSError: a file that the scene names has gone.
    """
    tables = {name: value for name, value in scene.as_dict().items() if name not in _FREE}
    tables["solver"] = {name: value for name, value in tables["solver"].items() if name not in _FREE_IN_SOLVER}
    return {key: _digest(value) if key.endswith(".file") else value for key, value in _flat(tables)}


def digest(identity: Mapping[str, Any]) -> str:
    """A hash of :func:`identity` (SHA-256)."""
    return hashlib.sha256(repr(sorted(identity.items())).encode()).hexdigest()


def difference(kept: Mapping[str, Any], given: Mapping[str, Any]) -> str | None:
    """The first key in which a scene differs from that of a checkpoint, in words; None where they agree.

    Args:
        kept: identity of the scene in the checkpoint.
        given: that of the scene at hand.
    """
    for key in sorted({*kept, *given}):
        if kept.get(key) != given.get(key):
            return f"{key} was {kept.get(key, 'not given')} and is {given.get(key, 'not given')}"
    return None


def _flat(tables: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in tables.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{above}{name}.")
        else:
            yield f"{above}{name}", value


def _digest(file: str) -> str:
    return "a file with the SHA-256 " + hashlib.sha256(Path(file).read_bytes()).hexdigest()
