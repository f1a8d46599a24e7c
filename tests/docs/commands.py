"""Every command that a document shows: in its ```sh blocks, and inline between backticks."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.wheel import ROOT

DOCUMENTS = (
    ROOT / "README.md",
    ROOT / "ARCHITECTURE.md",
    ROOT / "sample_logs" / "README.md",
    *sorted((ROOT / "docs").glob("*.md")),
)
_FENCE = re.compile(r"^( *)```(\w*)[^\n]*\n(.*?)^\1```$", re.MULTILINE | re.DOTALL)
_INLINE = re.compile(r"(?<!`)`([^`]+)`(?!`)")
# How a command begins; between backticks it is one only where it does.
_PROGRAM = re.compile(
    r"(\.venv/bin/)?(tunenet-\w+|rerun|sphinx-build)\b|"
    r"(python[\d.]*|pip|uv|make|docker|ray|ffmpeg|gst-launch-1\.0|rosbag|ros2|mkdir|git) |"
    r"\w*env/bin/(pip|python)\b"
)
_OPTION = re.compile(r"(?:^|(?<=[ \[(|]))--?[a-zA-Z][\w-]*")
# What stands for something else: three dots, or a word in capitals.
_PLACEHOLDERS = re.compile(r"\.\.\.|(?:^|[ /:=])[A-Z][A-Z_]+(?:\.\w+)?(?= |,|:|/|$)")


@dataclass(frozen=True)
class Shown:
    """One command as a document shows it.

    Attributes:
        line: of the document, from 1.
        words: as a shell would split them, the comment aside.
        text: the same in one line, without the comment.
        inline: whether it stands between words, not in a block.
        exit_code: with which it ends, as its comment says it: `# exits with 1`.
    """

    document: Path
    line: int
    words: tuple[str, ...]
    text: str
    inline: bool
    exit_code: int = 0

    @property
    def place(self) -> str:
        """Where it stands, as an editor opens it."""
        return f"{self.document.relative_to(ROOT)}:{self.line}"

    @property
    def is_a_pattern(self) -> bool:
        """Whether parts of it stand for something else, so that it cannot be run as it is."""
        return bool(_PLACEHOLDERS.search(self.text))


@dataclass(frozen=True)
class Block:
    """The commands of one ```sh block, or of one place between backticks, in their order."""

    commands: tuple[Shown, ...]

    @property
    def place(self) -> str:
        """Where its first command stands."""
        return self.commands[0].place


def blocks(document: Path) -> list[Block]:
    """All ```sh blocks and inline commands of a document, in their order."""
    text = document.read_text()
    found = [
        (match.start(), _block(document, text, match.start(3), match.group(3), inline=False))
        for match in _FENCE.finditer(text)
        if match.group(2) == "sh"
    ]
    prose = _FENCE.sub(lambda match: re.sub(r"[^\n]", " ", match.group()), text)
    for match in _INLINE.finditer(prose):
        if _PROGRAM.match(match[1]):
            words = " ".join(match[1].split())
            found.append(
                (match.start(), _block(document, text, match.start(1), words, inline=True))
            )
    return [block for _, block in sorted(found, key=lambda pair: pair[0]) if block.commands]


def other_fences(document: Path) -> Iterator[tuple[str, str]]:
    """The language and the text of each block that is no shell's."""
    for match in _FENCE.finditer(document.read_text()):
        if match.group(2) != "sh":
            yield match.group(2), match.group(3)


def begins_a_command(line: str) -> bool:
    """Whether a line looks like a command of a shell."""
    return bool(_PROGRAM.match(line.strip()))


def options(text: str) -> set[str]:
    """Every option that is named in a document, in commands, comments and between backticks."""
    code = [match.group(3) for match in _FENCE.finditer(text) if match.group(2) in {"", "sh"}]
    prose = _FENCE.sub("", text)
    code += [match[1] for match in _INLINE.finditer(prose)]
    return {match.group() for piece in code for match in _OPTION.finditer(piece)}


def _block(document: Path, text: str, start: int, script: str, *, inline: bool) -> Block:
    first = text.count("\n", 0, start) + 1
    commands = [
        Shown(document, first + at, words, part, inline, _exit_code(line))
        for at, line in _logical_lines(script)
        for words, part in _commands(line)
    ]
    return Block(tuple(commands))


def _exit_code(line: str) -> int:
    said = re.search(r"# exits with (\d+)", line)
    return int(said[1]) if said else 0


def _logical_lines(script: str) -> Iterator[tuple[int, str]]:
    """Lines with what continues them, after a backslash or inside of quotes."""
    pending, began = "", 0
    for at, line in enumerate(script.splitlines()):
        began = began if pending else at
        pending += line.strip() if not pending else line
        if pending.endswith("\\"):
            pending = pending[:-1] + " "
            continue
        try:
            shlex.split(pending, comments=True)
        except ValueError:  # a quotation goes on
            pending += "\n"
            continue
        yield began, pending
        pending = ""
    assert not pending, f"a quotation never ends: {pending}"


def _commands(line: str) -> Iterator[tuple[tuple[str, ...], str]]:
    """The commands of a line, which `|`, `&&` and `;` separate."""
    lexer = shlex.shlex(line, posix=True, punctuation_chars="|&;")
    lexer.whitespace_split = True
    words: list[str] = []
    for word in [*lexer, ";"]:
        if not word.strip("|&;"):
            if words:
                yield tuple(words), shlex.join(words)
            words = []
        else:
            words.append(word)
