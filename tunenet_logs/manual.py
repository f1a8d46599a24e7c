"""Show the documents in the terminal: `tunenet docs`, a page of them, or a search."""

from __future__ import annotations

import argparse
import math
import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from textwrap import shorten
from typing import NamedTuple

from tunenet_logs.console import Parser, run
from tunenet_logs.errors import UsageError

_DESCRIPTION = """\
Show the documents of this version: the list of pages, one of them, or the sections that say most
about some words."""
_EXAMPLES = """\
  tunenet docs                              (the list)
  tunenet docs camera
  tunenet docs rtsp camera loses packets"""
_FOLDER = Path(__file__).with_name("docs")
_MAX_FOUND = 6
_IN_HEADING, _IN_TITLE = 6, 3  # how much more a word says there
# Pages to look things up in: others explain what these only name.
_LISTS = {"accuracy", "api", "cheat-sheet", "checks", "experiments", "options"}
_LIST_WEIGHT = 0.75


class Section(NamedTuple):
    """Part of a page below one heading."""

    page: str
    title: str  # of the page
    heading: str
    text: str


def build_parser() -> Parser:
    """Build the argument parser."""
    parser = Parser("tunenet docs", _DESCRIPTION, _EXAMPLES, failed="nothing is said of the words")
    parser.add_argument("words", nargs="*", metavar="PAGE_OR_WORDS", help="default: the list")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run `tunenet docs`."""
    return run(build_parser(), _show, argv)


def _show(arguments: argparse.Namespace) -> int:
    words: list[str] = arguments.words
    sections = list(_sections())
    if not sections:
        raise UsageError(f"{_FOLDER} holds no documents; install the package again")
    titles = {one.page: one.title for one in sections}
    name = Path(words[0]).stem.lower() if len(words) == 1 else ""
    if not words:
        print("\n".join(f"{page:16}{title}" for page, title in titles.items()))
    elif name in titles:
        print((_FOLDER / f"{name}.md").read_text(encoding="utf-8"), end="")
    else:
        found = searched(sections, words)
        for one in found:
            first = next((line for line in one.text.splitlines() if line[:1].isalnum()), "")
            print(f"{one.page}: {one.heading}" + f"\n    {shorten(first, 100)}" * bool(first))
        if not found:
            print(f"nothing is said of {' '.join(words)}; see `tunenet docs`", file=sys.stderr)
        return 0 if found else 1
    return 0


def _sections() -> Iterator[Section]:
    """Yield the sections of all pages, page by page."""
    for path in sorted(_FOLDER.glob("*.md")):
        title, heading, lines = path.stem, "", []
        is_code = False
        for line in path.read_text(encoding="utf-8").splitlines():
            is_code ^= line.startswith("```")
            if not is_code and (found := re.match(r"(#+) (.*)", line)):
                if lines:
                    yield Section(path.stem, title, heading or title, "\n".join(lines))
                title = found[2] if found[1] == "#" else title
                heading, lines = found[2], []
            lines.append(line)
        if lines:
            yield Section(path.stem, title, heading or title, "\n".join(lines))


def searched(sections: Sequence[Section], words: Sequence[str]) -> list[Section]:
    """Return the sections that say most about the words, rare words counting more."""
    wanted = {_stem(word) for text in words for word in re.findall(r"\w+", text.lower())}
    counts = [
        {
            word: min(_count(word, one.text), 5)
            + _IN_HEADING * bool(_count(word, one.heading))
            + _IN_TITLE * bool(_count(word, one.title))
            for word in wanted
        }
        for one in sections
    ]
    seen = {word: sum(bool(one[word]) for one in counts) for word in wanted}
    rarity = {word: math.log(1 + len(sections) / seen[word]) for word in wanted if seen[word]}
    scores = [
        sum(math.sqrt(count[word]) * rarity[word] for word in rarity)
        * (_LIST_WEIGHT if one.page in _LISTS else 1.0)
        for one, count in zip(sections, counts, strict=True)
    ]
    order = sorted(range(len(sections)), key=lambda at: -scores[at])
    return [sections[at] for at in order[:_MAX_FOUND] if scores[at] > 0]


def _stem(word: str) -> str:
    """Cut the end of a word, so that "dropped" and "drops" find "drop"."""
    return re.sub(r"(?<=\w{3})(ies|ing|ed|es|s)$", "", word)


def _count(stem: str, text: str) -> int:
    return len(re.findall(rf"\b{re.escape(stem)}", text.lower()))


if __name__ == "__main__":
    sys.exit(main())
