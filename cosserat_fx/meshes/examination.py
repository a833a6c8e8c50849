"""Mesh files are looked at before they are read: XML that unfolds, and data in other files."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree
from xml.parsers import expat

from cosserat_fx.meshes.checks import MeshError

_XML = (".vtu", ".xdmf", ".xmf", ".xml")
_BLOCK = 4096


def examine(file: Path) -> int:
    """Look at a mesh file before it is read.

    Returns:
        Its size and that of the files that it names (bytes).

    Raises:
        MeshError: it is XML with a document type, by which a few lines can stand for gigabytes or other files; or it
            names something that is no file.
    """
    if file.suffix.lower() in _XML:
        _refuse_document_type(file)
    names = _named_files(file) if file.suffix.lower() in (".xdmf", ".xmf") else []
    for name in names:
        if not name.is_file():
            raise MeshError(f"{file}: must have its data in files that exist, but there is none at {name}")
    return sum(name.stat().st_size for name in {file, *names})


def _refuse_document_type(file: Path) -> None:
    """Read XML up to its first element, before which a document type would stand."""
    reached: list[str] = []

    def refuse(*declared: object) -> None:
        raise MeshError(f"{file}: must be XML without a document type (<!DOCTYPE ...>), which no mesh needs")

    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = refuse
    parser.StartElementHandler = lambda name, attributes: reached.append(name)
    try:
        with file.open("rb") as stream:
            while not reached and (block := stream.read(_BLOCK)):
                parser.Parse(block)
    except expat.ExpatError as error:
        if not reached:
            raise MeshError(f"{file}: cannot be read as a mesh file: {error}") from None


def _named_files(file: Path) -> list[Path]:
    """Files in which an XDMF file says that it has its data; none where it is no XML."""
    try:
        items = list(ElementTree.parse(file).iter("DataItem"))
    except ElementTree.ParseError:
        return []
    folders = {"HDF": file.resolve().parent, "Binary": Path()}  # where meshio looks for them
    formats = [(item.get("Format", ""), (item.text or "").strip()) for item in items]
    return [folders[kind] / text.partition(":")[0] for kind, text in formats if kind in folders]
