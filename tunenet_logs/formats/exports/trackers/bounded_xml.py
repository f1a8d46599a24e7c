"""Parse XML element by element: without entities, without a tree, and not too deep."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from xml.parsers import expat

from tunenet_logs.errors import LogError
from tunenet_logs.regular_file import open_regular

_CHUNK_BYTES = 1024**2
_MAX_DEPTH = 50

# Takes the name and the attributes of an element that begins; a ValueError refuses it.
Begin = Callable[[str, dict[str, str]], None]


def read_elements(path: Path, what: str, begin: Begin) -> None:
    """Call `begin` with each element of a file as it begins.

    Args:
        path: of the file.
        what: it is, for messages.
        begin: takes them.

    Raises:
        LogError: it is no XML, declares entities, is nested too deep, or `begin` refuses it.
        OSError: it cannot be read.
    """
    parser = expat.ParserCreate()
    depth = 0

    def enter(name: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > _MAX_DEPTH:
            raise ValueError(f"its elements are nested over {_MAX_DEPTH} deep")
        begin(name, attributes)

    def leave(_: str) -> None:
        nonlocal depth
        depth -= 1

    def refuse(*_: object) -> None:
        raise ValueError("it declares types or entities, which no export does")

    parser.StartElementHandler = enter
    parser.EndElementHandler = leave
    parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    try:
        with open_regular(path) as file:
            while data := file.read(_CHUNK_BYTES):
                parser.Parse(data, False)
        parser.Parse(b"", True)
    except (expat.ExpatError, ValueError, LookupError) as error:  # an encoding that is none
        where = f"line {parser.CurrentLineNumber}: "
        text = str(error) if isinstance(error, expat.ExpatError) else f"{where}{error}"
        raise LogError(f"{path}: {what}: {text}; export it again") from error
