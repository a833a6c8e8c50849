"""Mesh files and tables of void ratios that nobody should give: they are valid or refused with one clear message.

Cases are the same on every machine; benchmarks/fuzz.py tries thousands of others.
"""

import base64
import re
import struct
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest
from fuzz_bases import FIELD, PLANE, Case, document, field_cases, mesh_cases
from fuzz_mutations import file_cases
from fuzzing import assert_same_on_command_line, refusal
from hypothesis import HealthCheck, given, settings

from cosserat_fx._compat import MPI
from cosserat_fx.bodies import build
from cosserat_fx.scene import SceneError, load_scene

NO_EXCUSES = [HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.filter_too_much]
MESHES, FIELDS = mesh_cases(), field_cases()
MANY = b"1000000000000"


@pytest.mark.parametrize("case", [*MESHES.values(), *FIELDS.values()], ids=[*MESHES, *FIELDS])
def test_what_is_broken_here_is_whole_to_begin_with(case: Case) -> None:
    assert refusal(case) is None


@settings(max_examples=200, deadline=None, derandomize=True, suppress_health_check=NO_EXCUSES)
@given(case=file_cases(MESHES))
def test_whatever_a_mesh_file_holds_it_is_valid_or_refused_clearly(case: Case) -> None:
    refusal(case)


@settings(max_examples=60, deadline=None, derandomize=True, suppress_health_check=NO_EXCUSES)
@given(case=file_cases(FIELDS))
def test_whatever_a_table_of_void_ratios_holds_it_is_valid_or_refused_clearly(case: Case) -> None:
    refusal(case)


@settings(max_examples=20, deadline=None, derandomize=True, suppress_health_check=NO_EXCUSES)
@given(case=file_cases(MESHES | FIELDS))
def test_the_command_line_says_the_same(case: Case) -> None:
    assert_same_on_command_line(case, refusal(case))


# -- files made to do harm ---------------------------------------------------------------------------------------------


def broken(case: Case, break_: Callable[[bytes], bytes]) -> str:
    """What a scene is refused with whose file was changed."""
    files = {name: it if name == "scene.toml" else break_(it) for name, it in case.files.items()}
    assert files != case.files
    message = refusal(Case(files))
    assert message is not None
    return message


LAUGHS = (
    b'<!DOCTYPE laughs [<!ENTITY a0 "ha">'
    + b"".join(b'<!ENTITY a%d "%b">' % (level, b"&a%d;" % (level - 1) * 10) for level in range(1, 12))
    + b"]>"
)
BOMB = zlib.compress(b"\0" * 1_000_000_000, 9)


def bomb(content: bytes) -> bytes:
    """One block of a gigabyte of zeros in a megabyte."""
    block = base64.b64encode(struct.pack("<4I", 1, 2**31, 0, len(BOMB))) + base64.b64encode(BOMB)
    return re.sub(rb'(Name="connectivity"[^>]*>\n)[^<]*', lambda found: found[1] + block + b"\n", content)


def swap(old: bytes, new: bytes) -> Callable[[bytes], bytes]:
    return lambda content: content.replace(old, new, 1)


MEMORY = "reading it would take more memory than a file of its size should or this machine has"
NO_TYPE = "must be XML without a document type (<!DOCTYPE ...>), which no mesh needs"
POINTS = b'Dimensions="16 3" Format="XML" Precision="8">'
HOSTILE: dict[str, tuple[str, Callable[[bytes], bytes], str]] = {
    "a node of a large number": ("2.2", swap(b"\n16 ", b"\n2147483647 "), MEMORY),
    "many nodes, Gmsh 2.2": ("2.2", swap(b"$Nodes\n16", b"$Nodes\n" + MANY), MEMORY),
    "many nodes, Gmsh 4.1": ("4.1", swap(b"$Nodes\n1 16", b"$Nodes\n1 " + MANY), MEMORY),
    "many nodes of a block": ("4.1", swap(b"\n2 6 0 16\n", b"\n2 6 0 " + MANY + b"\n"), MEMORY),
    "many blocks": ("4.1", swap(b"$Elements\n6", b"$Elements\n" + MANY), MEMORY),
    "many lines": ("4.1", swap(b"\n1 1 1 3\n", b"\n1 1 1 " + MANY + b"\n"), MEMORY),
    "many values": ("2.2", lambda c: c + b'$NodeData\n1\n"a"\n0\n3\n0\n1\n' + MANY + b"\n", MEMORY),
    "compressed zeros": ("compressed .vtu", bomb, MEMORY),
    "many points": ("ascii .vtu", swap(b'NumberOfPoints="16"', b'NumberOfPoints="%b"' % MANY), "cannot reshape array"),
    "laughs in VTU": ("ascii .vtu", swap(b"<VTKFile", LAUGHS + b"<VTKFile"), NO_TYPE),
    "laughs in XDMF": ("text .xdmf", swap(b"<Xdmf", LAUGHS + b"<Xdmf"), NO_TYPE),
    "laughs within": (
        "text .xdmf",
        swap(b"<Geometry ", b"<Information><![CDATA[" + LAUGHS + b"<a>&a11;</a>]]></Information><Geometry "),
        "its content is malformed",
    ),
    "a file outside": (
        "ascii .vtu",
        swap(b"<VTKFile", b'<!DOCTYPE a [<!ENTITY b SYSTEM "file:///etc/passwd">]><VTKFile'),
        NO_TYPE,
    ),
    "no end of zeros": (
        "text .xdmf",
        lambda c: re.sub(re.escape(POINTS) + rb"[^<]*", POINTS.replace(b"XML", b"Binary") + b"/dev/zero", c),
        "must have its data in files that exist, but there is none at /dev/zero",
    ),
    "data in no file": (
        "text .xdmf",
        lambda c: re.sub(re.escape(POINTS) + rb"[^<]*", POINTS.replace(b"XML", b"HDF") + b"nowhere.h5:/points", c),
        "nowhere.h5",
    ),
    "data that refer to themselves": (
        "text .xdmf",
        lambda c: re.sub(
            b"<DataItem [^>]*" + re.escape(POINTS) + rb"[^<]*",
            b'<DataItem Reference="XML">/Xdmf/Domain/Grid/Geometry/DataItem',
            c,
        ),
        "its content is malformed",
    ),
    "many elements within each other": (
        "ascii .vtu",
        lambda c: b"<VTKFile>" + b"<a>" * 100_000,
        "its content is malformed",
    ),
    "coordinates that overflow": (
        "ascii .vtu",
        swap(b'NumberOfComponents="3" format="ascii">\n', b'NumberOfComponents="3" format="ascii">\n1e308 -1e308 0\n'),
        "cannot be read as a mesh file",
    ),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_hostile_mesh_files_are_refused(case: str) -> None:
    kind, break_, message = HOSTILE[case]
    refused = broken(MESHES[kind], break_)
    assert refused.startswith("geometry.file: ")
    assert message in refused


@pytest.mark.parametrize("kind", ["2.2", "4.1"])
@pytest.mark.parametrize("data", [b'1\n"a"\n' + MANY + b"\n0.0\n", MANY + b"\n"])
def test_a_mesh_file_that_takes_too_long_to_read_is_refused(
    kind: str, data: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """meshio would read the end of the file a million million times."""
    monkeypatch.setattr("cosserat_fx.guard.SECONDS", 0.2)
    refused = broken(MESHES[kind], lambda content: content + b"$NodeData\n" + data)
    assert "reading it takes far longer than a file of its size should" in refused


HOSTILE_TABLES = {
    "no finite extent": ("1e308,0,0.6\n-1e308,0,0.6\n", "coordinates must be smaller, as they have no finite extent"),
    "no finite number": ("1e400,0,0.6\n", "coordinates must be finite numbers"),
    "no number": ("__import__('os').system('touch executed'),0,0.6\n", "line 2 must hold a number in each column"),
}


@pytest.mark.parametrize("case", HOSTILE_TABLES)
def test_hostile_tables_are_refused(case: str) -> None:
    rows, message = HOSTILE_TABLES[case]
    refused = broken(
        Case({"scene.toml": document(PLANE), "field.csv": FIELD}), lambda c: b"x_m,y_m,void_ratio\n" + rows.encode()
    )
    assert refused.startswith("initial.field.file: field.csv: ")
    assert message in refused


@pytest.mark.parametrize("size", [1e-300, 1e-12, 1e12, 1e150, 1e300])
def test_tables_of_any_size_are_interpolated(size: float) -> None:
    rows = "".join(f"{x * size!r},{y * size!r},0.6\n" for x, y in ((0, 0), (1, 0), (0, 1), (1, 1), (0.3, 0.4)))
    table = f"x_m,y_m,void_ratio\n{rows}".encode()
    assert refusal(Case({"scene.toml": document(PLANE), "field.csv": table})) is None


def test_a_format_that_needs_another_package_says_so(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "h5py", None)
    for name, content in MESHES["text .xdmf"].files.items():
        (tmp_path / name).write_bytes(content)
    scene = load_scene(tmp_path / "scene.toml")
    with pytest.raises(
        SceneError, match=r"text\.xdmf: .*: its format needs the Python package h5py, which is not inst"
    ):
        build(scene, MPI.COMM_SELF)
