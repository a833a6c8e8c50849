"""What the machine has: the memory that this process and all others on its node may take."""

from __future__ import annotations

import os
import resource
from pathlib import Path

_CGROUPS = Path("/sys/fs/cgroup")


def memory_of_node(cgroups: Path = _CGROUPS, membership: Path = Path("/proc/self/cgroup")) -> float:
    """Physical memory, or less where a control group (of a container, say) has a lower limit (bytes).

    Args:
        cgroups: where control groups are mounted, of version 2 or, by controller, of version 1.
        membership: lines "number:controllers:group" that tell which groups this process is in.
    """
    limits = [float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))]
    for line in _read(membership).splitlines():
        _, controllers, group = line.split(":", 2)
        if controllers not in ("", "memory"):
            continue
        top, name = (cgroups / "memory", "memory.limit_in_bytes") if controllers else (cgroups, "memory.max")
        path = top / group.lstrip("/")
        # A container often sees its own group at the top of what is mounted, whatever the group is called outside.
        told = [_read(folder / name).strip() for folder in (path, *path.parents) if folder.is_relative_to(top)]
        limits += [float(limit) for limit in told if limit.isdecimal()]
    return min(limits)


def limit_of_process() -> float:
    """Memory that this process may still take under a limit on its address space; infinite without one (bytes)."""
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    return float("inf") if limit == resource.RLIM_INFINITY else max(0.0, float(limit - address_space()))


def address_space() -> int:
    """Address space that this process takes (bytes)."""
    return int(_read(Path("/proc/self/statm")).split()[0]) * os.sysconf("SC_PAGE_SIZE")


def _read(file: Path) -> str:
    """A text, empty where there is none."""
    try:
        return file.read_text()
    except OSError:
        return ""
