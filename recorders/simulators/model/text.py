"""Text of a user's model, with the places of its elements, to be edited byte by byte.

Comments, order and formatting stay. Numbers that are the same keep their words; what an element
does not have yet is added to it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from xml.parsers import expat
from xml.sax.saxutils import escape

from tunenet_logs.recorders.simulators.model.reading import ModelFiles
from tunenet_logs.terminal import one_line

_TAG = re.compile(rb"<[^\s/>]+((?:\s+[^\s=]+\s*=\s*(?:\"[^\"]*\"|'[^']*'))*)\s*(/?)>")
_ATTRIBUTE = re.compile(rb"([^\s=]+)\s*=\s*(\"[^\"]*\"|'[^']*')")
_REMARK = re.compile(rb"<!-- tunenet-export: (.*?) = (?:(?!-->).)*?-->\s*\Z", re.DOTALL)
_WORD = re.compile(r"\S+")
_COPIES = ("replicate", "attach", "composite", "flexcomp")  # of whose content MuJoCo makes several


@dataclass(eq=False)
class Element:
    """An element, and what is to change in its text."""

    tag: str
    values: dict[str, str]  # its attributes, as they are to be
    file: Path  # in which it stands
    spans: dict[str, tuple[int, int]]  # of each value in that file's bytes, without its quotes
    start: int  # of its start tag
    room: int  # where an attribute may be added
    inside: int  # after its start tag
    is_empty: bool  # whether it has no end tag
    end: int = 0  # of its end tag, or after its only one
    children: list[Element] = field(default_factory=list["Element"])
    changed: set[str] = field(default_factory=set[str])  # names of attributes
    # Attributes of children that it gets, by their tags.
    added: dict[str, dict[str, str]] = field(default_factory=dict[str, dict[str, str]])
    remarks: dict[str, str] = field(default_factory=dict[str, str])  # by their addresses

    def __post_init__(self) -> None:
        self.given = dict(self.values)  # as the file has them

    def set(self, name: str, value: str | None) -> None:
        """Give an attribute another value; None takes it away."""
        if value is None:
            if self.values.pop(name, None) is None:
                return
        else:
            self.values[name] = value
        self.changed.add(name)

    def put(self, name: str, numbers: Sequence[float], least: int = 1) -> None:
        """Set those of an attribute's numbers that differ; all that it has, or `least`."""
        words = list(_WORD.finditer(self.values.get(name, "")))
        count, had = min(max(least, len(words)), len(numbers)), len(words)
        text = self.values.get(name, "")
        for place in reversed(range(min(count, had))):
            value = float(numbers[place])
            if value_of(words[place].group()) != value:
                text = (
                    text[: words[place].start()] + number_text(value) + text[words[place].end() :]
                )
        if had < count:
            more = " ".join(number_text(float(one)) for one in numbers[had:count])
            text = f"{text.rstrip()} {more}" if had else more
        if text != self.values.get(name):
            self.set(name, text)

    def child(self, *tags: str) -> Element | None:
        """Return its first child with one of these tags."""
        return next((one for one in self.children if one.tag in tags), None)

    def walk(self, *without: str) -> Iterator[Element]:
        """Yield it and all that is in it, but not in elements with these tags."""
        stack = [self]
        while stack:
            element = stack.pop()
            yield element
            stack += [one for one in reversed(element.children) if one.tag not in without]


def value_of(text: str) -> float:
    """Return the number that a word is; NaN of another word."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def number_text(value: float) -> str:
    """Format a number with all its digits."""
    return repr(float(value)).removesuffix(".0")


def parsed(data: bytes, file: Path) -> Element:
    """Parse XML that `ModelFiles` accepted into elements with their places."""
    begin = len(data) - len(data.removeprefix(b"\xef\xbb\xbf").lstrip())
    parser = expat.ParserCreate("utf-8")
    stack: list[Element] = []
    roots: list[Element] = []

    def opened(tag: str, attributes: dict[str, str]) -> None:
        start = begin + parser.CurrentByteIndex
        found = _TAG.match(data, start)
        assert found is not None, "well-formed XML"
        spans = {
            one[1].decode(): (one.start(2) + 1, one.end(2) - 1)
            for one in _ATTRIBUTE.finditer(data, *found.span(1))
        }
        element = Element(
            tag.rpartition(":")[2],
            attributes,
            file,
            spans,
            start,
            found.end(1),
            found.end(),
            bool(found[2]),
            found.end(),
        )
        (stack[-1].children if stack else roots).append(element)
        stack.append(element)

    def closed(_: str) -> None:
        element = stack.pop()
        if not element.is_empty:
            element.end = begin + parser.CurrentByteIndex

    parser.StartElementHandler, parser.EndElementHandler = opened, closed
    parser.Parse(data[begin:], True)
    return roots[0]


class ModelXml:
    """The elements of a model and of what it includes, to be edited."""

    def __init__(self, files: ModelFiles) -> None:
        self._files = files
        self._roots = dict[Path, Element]()
        self._includes = list[tuple[Element, Path]]()  # each element, and its file
        self.root = self._read(files.path)
        self.is_urdf = self.root.tag == "robot"

    def _read(self, path: Path) -> Element:
        root = self._roots[path] = parsed(self._files.texts[path], path)
        for element in list(root.walk()):
            children: list[Element] = []
            for one in element.children:
                target = self._files.includes.get((path, one.values.get("file", "")))
                if one.tag.lower() == "include" and target is not None:
                    self._includes.append((one, target))
                    children += self._read(target).children
                else:
                    children.append(one)
            element.children = children
        return root

    @cached_property
    def names_files(self) -> bool:
        """Whether it names other files, which are found from where it lies."""
        every = (one for root in self._roots.values() for one in root.walk())
        named = (name.lower() for one in every for name in one.values)
        return bool(self._includes) or any(name.startswith("file") for name in named)

    def elements(self, kind: str) -> list[Element]:
        """List elements of a kind in the order of the compiled model, without what is copied."""
        if self.is_urdf:
            tag = {"body": "link"}.get(kind, kind)
            return [one for one in self.root.children if one.tag == tag]
        if kind in ("actuator", "tendon", "option"):
            sections = [one for one in self.root.children if one.tag == kind]
            return sections if kind == "option" else [one for x in sections for one in x.children]
        worlds = [one for one in self.root.children if one.tag == "worldbody"]
        bodies = [one for world in worlds for one in world.walk(*_COPIES) if one.tag == "body"]
        if kind == "body":
            return bodies
        tags = ("joint", "freejoint") if kind == "joint" else (kind,)
        owners = [*worlds, *bodies]
        return [one for owner in owners for one in own_elements(owner) if one.tag in tags]

    def find(self, kind: str, name: str, number: int, count: int) -> Element | None:
        """Find an element by its name; by its number where it has none and none is copied."""
        every = self.elements(kind)
        if name:
            return next((one for one in every if one.values.get("name") == name), None)
        first = int(kind == "body")  # the world, which is no element
        is_whole = len(every) + first == count and not every[number - first].values.get("name")
        return every[number - first] if is_whole else None

    def texts(self, names: Mapping[Path, str] | None = None, head: str = "") -> dict[Path, bytes]:
        """Return the texts of files that change; included ones are renamed where `names` says."""
        renamed = names or {}
        for element, target in self._includes:
            if target in renamed:
                folder = re.match(r"(?:.*[/\\])?", element.values["file"], re.DOTALL)
                element.set("file", (folder[0] if folder else "") + renamed[target])
        found: dict[Path, bytes] = {}
        including = [element for element, _ in self._includes]
        for path, root in self._roots.items():
            own = [*root.walk(), *including]
            changed = [
                one for one in own if one.file == path and (one.changed or one.added or one.remarks)
            ]
            if changed:
                found[path] = _edited(self._files.texts[path], changed, head)
        return found

    def renames(self, output: Path) -> dict[Path, Path]:
        """Return where each changed file is to be written, if the model itself is at `output`."""
        changed = set(self.texts())
        while more := {one.file for one, target in self._includes if target in changed} - changed:
            changed |= more
        own = self._files.path
        stem, _, _ = own.name.partition(".")
        mark = output.stem.removeprefix(f"{own.stem}.").removeprefix(f"{stem}.")
        found = {
            path: path.with_name(f"{path.stem}.{mark}{path.suffix}") for path in changed - {own}
        }
        return {own: output, **found}


def own_elements(owner: Element) -> Iterator[Element]:
    """Yield what belongs to a body itself, in its frames too."""
    for one in owner.children:
        if one.tag == "frame":
            yield from own_elements(one)
        elif one.tag not in ("body", *_COPIES):
            yield one


def remark_text(words: str) -> str:
    """Return words that no comment of XML ends at, and no reader of it refuses."""
    return re.sub("-(?=-|$)|<(?=!)", r"\g<0> ", one_line(words))


def _edited(data: bytes, changed: Sequence[Element], head: str) -> bytes:
    """Return a text with the changes of its elements."""
    edits: list[tuple[int, int, str]] = []
    newline = "\r\n" if b"\r\n" in data else "\n"
    if head:
        begin = len(data) - len(data.removeprefix(b"\xef\xbb\xbf").lstrip())
        declared = re.compile(rb"<\?xml.*?\?>\s*", re.DOTALL).match(data, begin)
        begin = declared.end() if declared else begin
        edits.append((begin, begin, head.replace("\n", newline) + newline))
    for element in changed:
        start = element.start
        line = data[data.rfind(b"\n", 0, start) + 1 : start]
        indent = line.decode() if not line.strip() else ""
        space = newline + indent if not line.strip() else " "
        # Remarks of an earlier export on the same values go.
        first = start
        while found := _REMARK.search(data, max(0, first - 2000), first):
            if remark_text(found[1].decode(errors="replace")) not in {
                remark_text(one) for one in element.remarks
            }:
                break
            first = found.start()
        remarks = [
            f"<!-- tunenet-export: {remark_text(address)} = {remark_text(words)} -->{space}"
            for address, words in element.remarks.items()
        ]
        if element.added:  # they are about what is added
            edits.append((first, start, ""))
        else:
            edits.append((first, start, "".join(remarks)))
        for name in element.changed:
            value = element.values.get(name)
            written = None if value is None else escape(value, {'"': "&quot;", "'": "&apos;"})
            if name not in element.spans:
                if written is not None:
                    edits.append((element.room, element.room, f' {name}="{written}"'))
                continue
            low, high = element.spans[name]
            if written is not None:
                edits.append((low, high, written))
            else:  # with its name, and the space before it
                begin = re.compile(rb"\s+[^\s=]+\s*=\s*[\"']\Z").search(data, element.start, low)
                assert begin is not None
                edits.append((begin.start(), high + 1, ""))
        if element.added:
            deeper = space + ("  " if newline in space else "")
            told = [one.removesuffix(space) for one in remarks]
            children: list[str] = []
            for tag, each in element.added.items():
                words = (f' {name}="{value}"' for name, value in each.items())
                children.append(f"<{tag}{''.join(words)}/>")
            text = "".join(deeper + one for one in (*told, *children))
            if element.is_empty:
                close = data.rfind(b"/", element.start, element.inside)
                tag = element_name(data, element)
                edits.append((close, element.inside, f">{text}{space}</{tag}>"))
            else:
                edits.append((element.inside, element.inside, text))
    pieces: list[bytes] = []
    done = 0
    for low, high, text in sorted(edits, key=lambda one: one[:2]):
        pieces += [data[done:low], text.encode()]
        done = high
    return b"".join([*pieces, data[done:]])


def element_name(data: bytes, element: Element) -> str:
    """Return an element's name as its text has it, with a prefix."""
    found = re.compile(rb"<([^\s/>]+)").match(data, element.start)
    assert found is not None
    return found[1].decode()
