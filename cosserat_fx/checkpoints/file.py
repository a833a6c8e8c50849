"""A checkpoint's file: a header in JSON and a record per cell, written and read by all ranks at once.

    magic (16 bytes) | length of the header, its CRC-32 (8 bytes each) | header (JSON) | records

Integers and numbers are little-endian. The records follow the order of the mesh's source, so that the file does not
depend on the number of ranks, none of which ever holds all of it. Their checksum is a sum over words that are mixed
with their place, which the ranks work out side by side and whichever way the cells are dealt out.
"""

from __future__ import annotations

import json
import os
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from cosserat_fx._compat import MPI
from cosserat_fx.checkpoints.snapshot import Records
from cosserat_fx.output.tables import OutputError, discard
from cosserat_fx.parallel import on_first_rank

FORMAT = 2
"""Version of the layout."""

_MAGIC = b"cosserat-fx ckpt"
_LENGTHS = struct.Struct("<QQ")
_HINTS = {"romio_ds_write": "disable", "romio_cb_write": "enable"}
"""Records of several ranks alternate in the file: they are put together before they are written, without locks."""


class CheckpointError(OutputError):
    """A checkpoint cannot be used; the message names the file and the reason."""


def write(
    file: Path, header: dict[str, Any], records: Records, numbers: npt.NDArray[np.int64], comm: MPI.Intracomm
) -> None:
    """Write a checkpoint and make sure that it is on the disk. Collective.

    Args:
        file: replaced if it exists, removed if it cannot be written whole.
        header: what JSON can hold; that of rank 0 counts.
        records: this rank's own.
        numbers: their positions, ascending.
        comm: the ranks.

    Raises:
        OutputError: it cannot be written.
    """
    count = comm.allreduce(len(records))
    sum_of_records = checksum(records, numbers, comm)

    def begin() -> int:
        layout = {"format": FORMAT, "records": count, "record_bytes": records.itemsize, "checksum": sum_of_records}
        text = json.dumps(header | layout, allow_nan=False).encode()
        head = _MAGIC + _LENGTHS.pack(len(text), zlib.crc32(text)) + text
        try:
            file.write_bytes(head)
            with file.open("rb+") as stream:  # what MPI says of a full disk is not for everybody
                os.posix_fallocate(stream.fileno(), 0, len(head) + count * records.itemsize)
            return len(head)
        except OSError as error:
            raise OutputError(f"{file}: cannot be written: {error.strerror or error}") from error

    try:
        place = on_first_rank(comm, begin)
        _transfer(file, MPI.MODE_WRONLY, place, records, numbers, comm)
        on_first_rank(comm, lambda: _check_size(file, place + count * records.itemsize))
    except OutputError:
        on_first_rank(comm, lambda: discard(file))
        raise


def read_header(file: Path) -> tuple[dict[str, Any], int]:
    """Read and check all but the records; on one rank.

    Returns:
        The header and the place in the file where the records begin (bytes).

    Raises:
        CheckpointError: it is no checkpoint, one of another format, damaged, or incomplete.
    """
    start = len(_MAGIC) + _LENGTHS.size
    try:
        with file.open("rb") as stream:
            head = stream.read(start)
            if head[: len(_MAGIC)] != _MAGIC:
                raise CheckpointError(f"{file}: not a checkpoint")
            length, sum_of_header = _LENGTHS.unpack(head[len(_MAGIC) :].ljust(_LENGTHS.size, b"\0"))
            size = os.fstat(stream.fileno()).st_size
            if start + length > size:
                raise CheckpointError(f"{file}: incomplete: it ends within its header")
            text = stream.read(length)
    except OSError as error:
        raise CheckpointError(f"{file}: cannot be read: {error.strerror or error}") from error
    if zlib.crc32(text) != sum_of_header:
        raise CheckpointError(f"{file}: damaged: the checksum of its header is wrong")
    header: dict[str, Any] = json.loads(text)
    if header["format"] != FORMAT:
        raise CheckpointError(f"{file}: of format {header['format']}, this version reads format {FORMAT}")
    expected = start + length + header["records"] * header["record_bytes"]
    if size != expected:
        raise CheckpointError(f"{file}: incomplete: it has {size} bytes of {expected}")
    return header, start + length


def read_records(
    file: Path, begin: int, record: np.dtype[np.void], numbers: npt.NDArray[np.int64], comm: MPI.Intracomm
) -> Records:
    """Read some records. Collective.

    Args:
        file: with a header that was found good.
        begin: place of the first record (bytes).
        record: what a record holds.
        numbers: positions of those asked for, ascending.
        comm: the ranks.

    Raises:
        CheckpointError: it cannot be read.
    """
    records = np.zeros(len(numbers), record)
    try:
        _transfer(file, MPI.MODE_RDONLY, begin, records, numbers, comm)
    except OutputError as error:
        raise CheckpointError(str(error)) from error
    return records


def checksum(records: Records, numbers: npt.NDArray[np.int64], comm: MPI.Intracomm) -> str:
    """Sum of all ranks' words, each mixed with its place by the finaliser of SplitMix64 (Steele, Lea and Flood 2014).

    Args:
        records: this rank's own.
        numbers: their positions.
        comm: the ranks.
    """
    length = records.itemsize // 8
    words = np.ascontiguousarray(records).view(np.uint64).reshape(len(records), length)
    places = (numbers[:, None] * length + np.arange(length)).astype(np.uint64)
    total = int(_mixed(words ^ _mixed(places + np.uint64(1))).sum(dtype=np.uint64))
    return f"{comm.allreduce(total) % 2**64:016x}"


def _mixed(words: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
    """A bijection of words in which every bit of the one depends on every bit of the other."""
    words = (words ^ (words >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    words = (words ^ (words >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return words ^ (words >> np.uint64(31))


def _transfer(
    file: Path, mode: int, begin: int, records: Records, numbers: npt.NDArray[np.int64], comm: MPI.Intracomm
) -> None:
    """Write or read this rank's records at their places, all ranks at once; fails on all ranks or on none."""
    if mode == MPI.MODE_RDONLY and not comm.allreduce(len(records)):
        return
    record = MPI.BYTE.Create_contiguous(records.itemsize).Commit()
    places = record.Create_indexed_block(1, numbers.astype(np.int32)).Commit()
    failure = ""
    try:
        stream = MPI.File.Open(comm, str(file), mode, MPI.Info.Create(_HINTS))
    except MPI.Exception as error:  # opening fails on all ranks alike
        failure = _words(error)
    else:
        failure = _told(lambda: stream.Set_view(begin, record, places))
        buffer = [records.view(np.uint8), len(records), record]
        if mode == MPI.MODE_RDONLY:
            failure = failure or _told(lambda: stream.Read_all(buffer))
        else:
            failure = failure or _told(lambda: stream.Write_all(buffer)) or _told(stream.Sync)
        failure = _told(stream.Close) or failure
    places.Free()
    record.Free()
    failures = [it for it in comm.allgather(failure) if it]
    if failures:
        verb = "read" if mode == MPI.MODE_RDONLY else "written"
        raise OutputError(f"{file}: cannot be {verb}: {failures[0]}")


def _told(work: Callable[[], object]) -> str:
    """What MPI says against some work, or nothing."""
    try:
        work()
    except MPI.Exception as error:
        return _words(error)
    return ""


def _words(error: MPI.Exception) -> str:
    """The system's word on an error, without the stack of calls that some libraries put before it."""
    return str(error.error_string).strip().rpartition("\n")[2].rpartition(": ")[2]


def _check_size(file: Path, expected: int) -> None:
    size = file.stat().st_size
    if size != expected:
        raise OutputError(f"{file}: cannot be written: it has {size} bytes of {expected}")
