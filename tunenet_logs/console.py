"""Command line that all commands share: one-line errors, exit codes, shell completion.

`Parser` refuses what is wrong in one line; `run` turns known errors and signals into exit codes;
`number` and those after it are argparse types. Help starts at once: nothing heavy is imported.
"""

from __future__ import annotations

import argparse
import errno
import io
import os
import signal
import sys
import traceback
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from textwrap import fill
from typing import Any, NoReturn

from tunenet_logs import __version__
from tunenet_logs.addresses import scheme_of, without_secrets
from tunenet_logs.errors import CHECK_DISK, LogError, TuneNetError, UsageError
from tunenet_logs.process import WORDS, lost_output, stoppable
from tunenet_logs.terminal import one_line

# ---- Shell completion: `--print-completion bash`, of every command

SHELLS = ("bash", "zsh", "tcsh")
_PATHS = ("LOG", "SOURCE")  # metavars of what may be a file, or an address, a camera's number
_OFFERED = "offered"


def offering(action: argparse.Action, words: Iterable[str]) -> None:
    """Let a shell complete `words` for an option without restricting its values to them.

    `choices` would refuse all others in argparse's words.
    """
    vars(action)[_OFFERED] = tuple(words)


class PrintCompletion(argparse.Action):
    """Action that prints a shell's completion script and exits, as `--version` does."""

    def __call__(
        self, parser: argparse.ArgumentParser, _namespace: object, values: Any, _option: object = ""
    ) -> None:
        """Print the script and exit."""
        print(_script(parser, str(values)), flush=True)
        sys.exit(0)


def _script(parser: argparse.ArgumentParser, shell: str) -> str:
    import shtab  # only here: nothing else needs it

    _annotate(parser, shtab.FILE, shtab.DIRECTORY)
    return shtab.complete(parser, shell)


def _annotate(parser: argparse.ArgumentParser, file: Any, folder: Any) -> None:
    """Attach to each argument what completes it; the parser parses nothing any more."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for verb in action.choices.values():
                _annotate(verb, file, folder)
        elif action.choices is not None:
            action.choices = list(action.choices)
        elif _OFFERED in vars(action):
            action.choices = vars(action)[_OFFERED]
        elif action.type is Path or action.metavar in _PATHS:
            vars(action)["complete"] = folder if action.metavar == "DIR" else file


# ---- Parser and runner

_HELP_COLUMNS = 80


class Parser(argparse.ArgumentParser):
    """Argument parser whose errors are one line, with exit code 2.

    Args:
        prog: the command, with its verb where it has some.
        description: what it does.
        examples: of how it is called.
        failed: what exit code 1 means.
        ended: what exit code 0 means.
    """

    def __init__(
        self,
        prog: str,
        description: str,
        examples: str,
        *,
        failed: str = "a log failed or was rejected",
        ended: str = "done",
    ) -> None:
        codes = f"exit codes: 0~{ended}, 1~{failed}, 2~wrong usage, 130~Ctrl-C"
        lines = fill(codes, _HELP_COLUMNS, subsequent_indent="  ").replace("~", " ")
        super().__init__(
            prog=prog,
            description=description,
            epilog=f"examples:\n{examples}\n\n{lines}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
        )
        self.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
        self.add_argument("--debug", action="store_true", help="show the traceback of an error")
        if " " not in prog:  # one script completes a command with its verbs
            self.add_argument(
                "--print-completion",
                action=PrintCompletion,
                choices=SHELLS,
                help="print a script that has a shell complete this command (docs/commands.md)",
            )

    def _get_value(self, action: argparse.Action, arg_string: str) -> Any:
        """Refuse an address where a file is meant: a folder would be called like all of it."""
        has_secrets = without_secrets(arg_string) != arg_string and not os.path.lexists(arg_string)
        if action.type is Path and (scheme_of(arg_string) or has_secrets):
            raise argparse.ArgumentError(
                action,
                f"{arg_string!r} is an address; name a file or folder of this machine (addresses "
                "of logs are read by tunenet-tune)",
            )
        return super()._get_value(action, arg_string)

    def error(self, message: str) -> NoReturn:
        """Raise UsageError with one line."""
        raise UsageError(f"{message} (see {self.prog} --help)")


# Where NumPy looks, when it is loaded, for how many threads to use. Our matrices are small: a
# second thread mostly waits for the first, and on a busy machine both wait.
BLAS_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


# What a disk says that takes no more, and the remedy.
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_MORE_SPACE = "free some space, or write to another disk"


def run(
    parser: Parser, body: Callable[[argparse.Namespace], int], argv: Sequence[str] | None
) -> int:
    """Parse the arguments and run `body`, reporting a known error as one line on stderr.

    Returns:
        The exit code: that of `body`, 1 or 2 for a known error, 128 and its number for a
        signal (130 for Ctrl-C).
    """
    words = list(sys.argv[1:] if argv is None else argv)
    for name in BLAS_THREADS:
        os.environ.setdefault(name, "1")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a name that the terminal cannot show
            stream.reconfigure(errors="backslashreplace")
    try:
        try:
            with stoppable():
                code = body(parser.parse_args(words))
        except SystemExit:  # --help, --version
            _check_output()
            raise
        _check_output()
        return code
    except TuneNetError as error:
        if "--debug" in words:
            print_traceback()
        print(one_line(f"{parser.prog}: {error}"), file=sys.stderr)
        return error.exit_code
    except OSError as error:  # a path that no file system takes, a full disk
        if "--debug" in words:
            print_traceback()
        place = f"{error.filename}: " if error.filename else ""
        remedy = _MORE_SPACE if error.errno in _FULL else CHECK_DISK
        what = f"{place}{error.strerror or error}; {remedy}"
        print(one_line(f"{parser.prog}: {what}"), file=sys.stderr)
        return 1
    except KeyboardInterrupt as stop:
        number = getattr(stop, "number", signal.SIGINT)  # none where closing a page raised it
        print(f"{parser.prog}: {WORDS[number]}", file=sys.stderr)
        return 128 + number


def _check_output() -> None:
    """Raise LogError where what was said did not reach standard output."""
    sys.stdout.flush()
    if why := lost_output():
        raise LogError(f"standard output: {why}", "give it a place that takes it")


def print_traceback() -> None:
    """Print the traceback of the error being handled on stderr."""
    for part in traceback.format_exception(sys.exc_info()[1]):
        # A place in our code has lines of its own; what an error says may be anybody's words.
        is_place = part.startswith("  File ")
        print(part.rstrip() if is_place else one_line(part.strip()), file=sys.stderr)


def number(low: float, high: float, unit: str = "") -> Callable[[str], float]:
    """Return an argparse type: a finite number within [low, high]."""

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not low <= value <= high:
            between = f"a number from {low:.15g} to {high:.15g}{' ' + unit if unit else ''}"
            raise argparse.ArgumentTypeError(f"{text!r} is not {between}")
        return value

    return parse


def whole(low: int, high: int) -> Callable[[str], int]:
    """Return an argparse type: an integer within [low, high]."""

    def parse(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = low - 1
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from {low} to {high}")
        return value

    return parse


def is_stdout(path: Path) -> bool:
    """Check whether a path option stands for standard output: `-`."""
    return str(path) == "-"


def size_px(text: str) -> tuple[int, int]:
    """Parse a picture size WxH [px], as an argparse type."""
    width, _, height = text.lower().partition("x")
    parts = [int(part) if part.isascii() and part.isdecimal() else 0 for part in (width, height)]
    if not all(0 < part < 100_000 for part in parts):
        raise argparse.ArgumentTypeError(f"{text!r} is not a size in pixels, such as 1280x720")
    return parts[0], parts[1]
