"""Every command that a document shows, and those that are not run, each with the reason.

A new one needs nothing where its files have stand-ins (`stand_ins.py`), else a line here.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator, Mapping
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
    r"(\.venv/bin/)?(tunenet-[a-z]+|rerun(?!-)|sphinx-build)\b|"
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


# By what the whole command looks like.
NOT_RUN: Mapping[str, str] = {
    r"python -m (tests\.bench|tunenet_logs\.analysis).*": "takes long; its arguments are parsed",
    r"tunenet-record .*--preview.*": "waits for a person at a page",
    r"tunenet-tune .*--preview.*": "waits for a person at a page",
    r"tunenet-record --camera( 0)?( --ball .*)?( -o \S+)?$": "needs a camera",
    r"tunenet-record --camera 0 --size .*": "needs a camera",
    r"tunenet-record --camera 0 --microphone.*": "needs a camera and a microphone",
    r"tunenet-record --camera rtsps?://.*": "needs a network camera",
    r"tunenet-record --camera -( -o \S+)?$": "reads what another program sends",
    r"tunenet-record .*--joint-states .*": "needs a ROS 2 network",
    r"tunenet-eval .*": "takes minutes to hours; its own tests run its parts",
    r"tunenet-train .*": "takes minutes to hours; its own tests train small networks",
    r"tunenet-tune s3://.*": "needs a store on a network",
    r"tunenet-tune a\.mcap b\.mcap --model robot\.xml .*": "needs logs of a robot",
    r"tunenet-tune my_dataset/ --model so101\.xml .*": "needs a data set of a robot",
    r"tunenet-tune .*--ray HEAD:\d+.*": "needs a cluster",
    r"make (demo|test|test-all|smoke|bench)( .*)?": "takes minutes; its target is there",
    r"\.venv/bin/pytest .*": "a part of this suite",
    r"make (samples|pictures|docs|docs-check)": "changes the tree; its target is there",
    r"make \.venv/\w+": "installs 2 GB; its target is there",
    r"(\S*/)?(pip|python[\d.]* -m pip) .*": "needs a network; pip's own parser takes it",
    r"uv .*": "another program, on a network",
    r"python docs/examples/\w+\.py.*": "test_examples.py runs it",
    r"python docs/make_\w+\.py.*": "changes the documents",
    r"python3 -m venv \w+": "Python's own",
    r"\. \S+/activate": "the shell's own",
    r"(ray|rosbag|ros2|ffmpeg|gst-launch-1\.0|jq) .*": "other programs",
    r"du -sm .*|printf .*|mkdir \w+|(\.venv/bin/)?python -c .*": "the system's own",
}


# Likewise, of those that only `make docs-check` runs.
SLOW: Mapping[str, str] = {
    r"tunenet-tune .*(\.mp4|filmed|sample_logs/\*).*": "tunes a film",
    r"tunenet-tune .*--ray .*": "starts Ray",
    r"tunenet-tune runs/ .*": "starts processes",
    r"tunenet-record .*--render.*": "draws a film",
    r"tunenet-review .*campaign.*": "reviews a film",
}

VIEWER: Mapping[str, str] = {r"(\S*/)?rerun( .*)?": "opens a viewer: its file has to be there"}


# Options in the documents that are none of ours, and whose they are.
OTHER_OPTIONS: Mapping[str, str] = {
    **dict.fromkeys(
        ("--codec", "--host", "--inline", "--libav-format", "--listen", "--port", "--sout"),
        "programs that send pictures",
    ),
    **dict.fromkeys(
        ("--ignore-installed", "--no-binary", "--no-deps", "--only-binary",
         "--platform", "--python-version", "--target"),
        "pip",
    ),
    **dict.fromkeys(("--address", "--head"), "Ray"),
    "--python": "uv",
    "--screenshot-to": "Rerun",
    "-k": "pytest",
}  # fmt: skip


def reason(table: Mapping[str, str], text: str) -> str | None:
    """Why a command stands in a table; None where it does not."""
    for pattern, why in table.items():
        if re.fullmatch(pattern, text, re.DOTALL):
            return why
    return None
