"""No room, and no permission: what is on the disk stays whole, and the run goes on when there is room again."""

import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import pytest
from faults import SMALL, assert_nothing_lost, launch, rows

from cosserat_fx.results import read_run

ROOMS = (4096, 4 * 4096, 5 * 4096, 6 * 4096, 7 * 4096, 15 * 4096)
"""Free bytes of a small disk, one try after the other."""
LARGEST_FILES = (100, 1000, 5000, 30000)
"""Bytes of the largest file allowed, where there is no small disk."""
MESSAGE = r"(stopped early|cosserat-fx): (\S+/run/\S+): (cannot be written|figures cannot be written): .*"
NO_CHECKPOINT = r"warning: no checkpoint could be written: (\S+): cannot be written: .*"


class Disk(NamedTuple):
    """A place for a run, whose room can be bounded.

    Attributes:
        place: its path.
        seen_from_here: the same, as this process sees it.
        within: a command that runs another one, its arguments, in the namespace that has the disk.
    """

    place: Path
    seen_from_here: Path
    within: tuple[str, ...]

    def leave(self, free: int) -> str:
        """Fill it up to so many bytes, or see to it that no file grows larger; what a run is to do before it begins."""
        if not self.within:
            return f"import cosserat_fx.run, resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({free}, {free}))"
        filler = self.place / "filler"
        subprocess.run([*self.within, "rm", "-f", str(filler)], check=True)
        room = os.statvfs(self.seen_from_here)
        size = room.f_bavail * room.f_frsize - free
        subprocess.run([*self.within, "fallocate", f"--length={size}", str(filler)], check=True)
        return ""

    def copy(self, to: Path) -> Path:
        """The run, where it can be read without ado."""
        shutil.rmtree(to, ignore_errors=True)
        return Path(shutil.copytree(self.seen_from_here / "run", to))


@contextmanager
def small_disk(place: Path) -> Iterator[Disk]:
    """A disk of 2 MiB in a namespace of its own; where the system lets nobody make one, a folder and bounded files."""
    place.mkdir()
    mount = f"mount -t tmpfs -o size=2m tmpfs {place} && echo mounted && cat"
    new = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c", mount]
    with subprocess.Popen(new, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as holder:
        assert holder.stdout is not None
        if holder.stdout.readline():
            join = ("nsenter", f"--target={holder.pid}", "--user", "--mount", "--preserve-credentials")
            yield Disk(place, Path(f"/proc/{holder.pid}/root{place}"), join)
        else:
            yield Disk(place, place, ())
        holder.communicate()


def complaints(process: subprocess.CompletedProcess[str]) -> set[str]:
    """Names of the files that could not be written; there is one message beside warnings of checkpoints."""
    warnings = re.findall(f"^{NO_CHECKPOINT}$", process.stderr, re.MULTILINE)
    messages = re.findall(f"^{MESSAGE}$", process.stderr, re.MULTILINE)
    assert len(messages) == 1, process.stderr
    assert len(process.stderr.splitlines()) == len(warnings) + 1, process.stderr
    return {Path(name).name for name in (*warnings, messages[0][1])}


def assert_whole(folder: Path, undisturbed: Path) -> None:
    """The tables hold whole lines of what the undisturbed run has, and the summary can be read."""
    for table in ("history.csv", "profiles.csv"):
        if (folder / table).exists():
            there = (folder / table).read_bytes()
            assert (undisturbed / table).read_bytes().startswith(there)
            assert there == b"" or there.endswith(b"\n")
    if (folder / "run.json").exists():
        assert read_run(folder).summary["status"] in ("running", "stopped")


def test_a_full_disk(tmp_path: Path, undisturbed: Path) -> None:
    """The room grows from try to try, so that the run gets stuck at ever later files; at last there is enough."""
    refused = set()
    with small_disk(tmp_path / "disk") as disk:
        for room in ROOMS if disk.within else LARGEST_FILES:
            process = launch(disk.place / "run", *SMALL, before=disk.leave(room), within=disk.within)
            assert process.returncode in (2, 3), process.stderr
            refused |= complaints(process)
            assert_whole(disk.copy(tmp_path / "run"), undisturbed)
        process = launch(disk.place / "run", *SMALL, before=disk.leave(2**20), within=disk.within)
        assert process.returncode == 0, process.stderr
        assert_nothing_lost(disk.copy(tmp_path / "run"), undisturbed, figures=True)
    assert refused >= {"history.csv", "checkpoint.part", "figures"}


@pytest.fixture
def bound_by_permissions() -> list[str]:
    """A command that runs another one, its arguments, whose process may not write where permissions forbid it."""
    return ["setpriv", "--bounding-set=-dac_override", "--inh-caps=-dac_override"] if os.geteuid() == 0 else []


def test_a_folder_that_is_read_only(tmp_path: Path, bound_by_permissions: list[str], undisturbed: Path) -> None:
    """Before the run it is refused; during it the run ends when it cannot write any more, and goes on later."""
    above = tmp_path / "above"
    above.mkdir(mode=0o555)
    process = launch(above / "run", within=bound_by_permissions)
    assert process.returncode == 2
    assert process.stderr == f"cosserat-fx: output folder {above / 'run'}: no permission to write in {above}\n"

    above.chmod(0o755)
    folder = above / "run"
    shut = f"on_call('cosserat_fx.recorder:Recorder.record', 6, lambda: os.chmod('{folder}', 0o555))"
    process = launch(folder, before=shut, within=bound_by_permissions)
    assert process.returncode == 3
    assert complaints(process) == {"checkpoint.part", "run.json"}
    assert rows(folder) == rows(undisturbed)

    folder.chmod(0o755)
    process = launch(folder, within=bound_by_permissions)
    assert process.returncode == 0, process.stderr
    assert_nothing_lost(folder, undisturbed)
