"""Write docs/api.md from the docstrings of `tunenet_logs`: `python docs/make_api.py`."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import griffe

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "api.md"

_PARSING = {"returns_multiple_items": False, "returns_named_value": False}

_LISTS = {"parameters": "Arguments", "raises": "Raises"}
"""Sections of a docstring that list things, and what the page calls them."""

_GROUPS = ("What one calls", "What comes out", "What goes in", "Errors")
_IN = ("Ball", "BALLS", "Reviewed")

_HEAD = """\
# Python

<!-- made by `python docs/make_api.py` from the docstrings; change those -->
"""


def page() -> str:
    """The text of the page."""
    package = griffe.load(
        "tunenet_logs.analysis.api",
        search_paths=[ROOT],
        docstring_parser="google",
        resolve_aliases=True,
        resolve_external=True,
    )
    parts = [_HEAD, _text(package.docstring)]
    groups: dict[str, list[str]] = {title: [] for title in _GROUPS}
    for name in sorted(_public(package), key=str.lower):
        groups[_group(name, package[name])] += _entry(name, package[name])
    for title, entries in groups.items():
        parts += [f"## {title}", *entries]
    return "\n\n".join(part.strip("\n") for part in parts if part) + "\n"


def _public(package: Any) -> list[str]:
    return [str(name).strip("'\"") for name in package.exports]


def _group(name: str, entry: Any) -> str:
    """Under which heading a name stands."""
    if entry.is_function:
        return "What one calls"
    if name.endswith("Error"):
        return "Errors"
    is_given = name.endswith(("Order", "Options")) or name in _IN
    return "What goes in" if is_given else "What comes out"


def _entry(name: str, entry: Any) -> Iterator[str]:
    """One public name: heading, signature, docstring, and a class's own methods."""
    yield f"### {name}"
    if entry.is_function:
        yield f"```python\n{_signature(name, entry)}\n```"
    yield from _sections(entry)
    if not entry.is_class:
        return
    rows: list[str] = []
    for own_name, member in entry.members.items():
        is_called = member.is_function or "property" in member.labels
        if is_called and not own_name.startswith("_") and member.docstring is not None:
            whole = f"{name}.{own_name}"
            title = _signature(whole, member) if member.is_function else whole
            text = _one_line(member.docstring.parse("google", **_PARSING)[0].value)
            rows.append(f"- `{title}`: {text}")
    yield "\n".join(rows)


def _signature(name: str, function: Any) -> str:
    """As one would write it, an argument a line where it is long."""
    shown: list[str] = []
    star = False
    for one in function.parameters:
        if one.name == "self":
            continue
        kind = one.kind.value if one.kind else ""
        if kind == "keyword-only" and not star:
            shown.append("*")
            star = True
        mark = {"variadic keyword": "**", "variadic positional": "*"}.get(kind, "")
        text = f"{mark}{one.name}: {one.annotation}" if one.annotation else mark + one.name
        has_default = one.default is not None and not mark
        shown.append(f"{text} = {one.default}" if has_default else text)
    ending = f" -> {function.returns}" if function.returns else ""
    line = f"{name}({', '.join(shown)}){ending}"
    if len(line) <= 88:
        return line
    return f"{name}(\n" + "".join(f"    {one},\n" for one in shown) + f"){ending}"


def _sections(entry: Any) -> Iterator[str]:
    """The docstring, a part at a time."""
    parsed = [] if entry.docstring is None else entry.docstring.parse("google", **_PARSING)
    known: dict[str, str] = {}
    for section in parsed:
        kind = section.kind.value
        if kind == "text":
            yield section.value
        elif kind == "attributes":
            known = {one.name: _one_line(one.description) for one in section.value}
        elif kind in _LISTS:
            rows = [
                f"- `{getattr(one, 'name', None) or one.annotation}`: {_one_line(one.description)}"
                for one in section.value
            ]
            yield f"{_LISTS[kind]}:\n\n" + "\n".join(rows)
        elif kind == "returns":
            yield "Returns: " + " ".join(_one_line(one.description) for one in section.value)
    if entry.is_class:
        known = _inherited(entry) | known
        rows = [_field(name, str(kind), known.get(name, "")) for name, kind in _fields(entry)]
        yield "\n".join(rows)


def _inherited(entry: Any) -> dict[str, str]:
    """What the docstrings of a class's bases say of its fields."""
    docstrings = [base.docstring for base in entry.resolved_bases if base.docstring is not None]
    return {
        one.name: _one_line(one.description)
        for docstring in docstrings
        for section in docstring.parse("google", **_PARSING)
        if section.kind.value == "attributes"
        for one in section.value
    }


def _fields(entry: Any) -> Iterator[tuple[str, Any]]:
    """Fields of a dataclass or keys of a TypedDict, with those that it inherits."""
    for name, member in {**entry.inherited_members, **entry.members}.items():
        is_method = member.is_function or "property" in member.labels
        if member.is_attribute and not is_method and not name.startswith("_"):
            yield name, member.annotation


def _field(name: str, annotation: str, text: str) -> str:
    return f"- `{name}` (`{annotation}`)" + (f": {text}" if text else "")


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _text(docstring: Any) -> str:
    return "" if docstring is None else str(docstring.value)


if __name__ == "__main__":
    if "--check" in sys.argv:
        sys.exit(PAGE.read_text("utf-8") != page() and "docs/api.md is old: run this without it")
    PAGE.write_text(page(), "utf-8")
