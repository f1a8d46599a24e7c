"""Command line that all commands share: options, help in topics, one-line errors, exit codes.

An option is declared once, as a field of a dataclass (`option`): its argument of a command, its
check in Python and all that is said of it follow. `Parser` refuses what is wrong in one line; `run`
turns known errors and signals into exit codes; `number` and those after it are argparse types.
Help starts at once: nothing heavy is imported.
"""

from __future__ import annotations

import argparse
import errno
import io
import os
import re
import signal
import sys
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import MISSING, field, fields
from functools import cache
from importlib import import_module
from pathlib import Path
from textwrap import fill
from types import FunctionType
from typing import Any, NamedTuple, NoReturn, TypeVar

from tunenet_logs import __version__
from tunenet_logs.addresses import scheme_of, without_secrets
from tunenet_logs.errors import CHECK_DISK, LogError, TuneNetError, UsageError
from tunenet_logs.process import WORDS, stoppable
from tunenet_logs.terminal import one_line, short_name

Kind = TypeVar("Kind")
_UNIT = re.compile("_(m|s|kg|ms|hz|k|nm|deg|1_m|1_s)$")  # at the end of a field's name

# ---- Options, each declared once, as a field of a dataclass: `start_s: float | None = option(...)`


class Option:
    """An option: of a command, and of Python by the name of its field."""

    # No dataclass: making one costs each start of a command a millisecond.
    help: str  # what it does, for `--help` and docs/options.md; "{choices}" in it lists these
    flag: str = ""  # as the command spells it; "" for the field's name with dashes, less its unit
    # The topic of the help in which it stands, with "TOPIC:TITLE" under a title of its own; "" for
    # those that everybody needs
    group: str = ""
    subject: str = ""  # what it is about; who has no use for that says that it is not used
    metavar: str | None = None  # its value in the help; None for its unit
    # Least and greatest number, and their unit on the command line, "" for none
    limits: tuple[float, float, str] | None = None
    factor: float = 1.0  # from the command's unit to the field's
    is_whole: bool = False  # whether the number is whole
    is_many: bool = False  # whether it may be given several times
    choices: Sequence[str] | str = ()  # its values, or where they are to be found, "module:name"
    offered: Iterable[str] = ()  # values that a shell completes; others are valid, too
    alone: Any = None  # its value when it is given without one; None if it needs one
    parse: Callable[[str], Any] | None = None  # reads its value from a text

    def __init__(self, help: str, **more: Any) -> None:  # noqa: A002 (as argparse has it)
        assert more.keys() <= Option.__annotations__.keys(), more
        vars(self).update(more, help=help)

    @property
    def values(self) -> tuple[str, ...]:
        """Its choices."""
        choices = self.choices
        if not isinstance(choices, str):
            return tuple(choices)
        module, _, name = choices.partition(":")
        found: Any = getattr(import_module(module), name)
        return tuple(found()) if isinstance(found, FunctionType) else tuple(found)

    @property
    def words(self) -> str:
        """What it does, with its choices."""
        return self.help.replace("{choices}", ", ".join(self.values))

    def checked(self, name: str, value: Any) -> Any:
        """Return a value that Python gave, as the field has it; else UsageError."""
        if self.is_many and not isinstance(value, Mapping):
            values = (value,) if isinstance(value, str | os.PathLike) else value
            return tuple(self._one(name, one) for one in values)
        return self._one(name, value)

    def _one(self, name: str, value: Any) -> Any:
        if self.limits is not None:
            low, high = (self.factor * limit for limit in self.limits[:2])
            kind = int if self.is_whole else int | float
            if isinstance(value, bool) or not isinstance(value, kind) or not low <= value <= high:
                what = "a whole number" if self.is_whole else "a number"
                unit = f" {self.limits[2]}" if self.limits[2] and self.factor == 1 else ""
                raise UsageError(f"{name} {value!r} is not {what} {_range(low, high)}{unit}")
            return value if self.is_whole else float(value)
        if self.choices and value not in self.values:
            known = ", ".join(self.values)
            raise UsageError(f"{name} {short_name(value)!r} is not known; choose one of: {known}")
        if self.parse is Path:
            return Path(value) if isinstance(value, str | os.PathLike) else value
        if self.parse is not None and isinstance(value, str):
            try:
                return self.parse(value)
            except argparse.ArgumentTypeError as error:
                raise UsageError(str(error)) from error
        return value

    def flag_of(self, name: str) -> str:
        """Return how a command spells the option that Python calls `name`."""
        plain = _UNIT.sub("", name) if self.limits else name.removeprefix("is_")
        return self.flag or f"--{plain.replace('_', '-')}"


def option(help: str, default: Any = None, **more: Any) -> Any:  # noqa: A002 (as argparse has it)
    """Declare a field of a dataclass that is an option; see `Option`."""
    about = {"option": Option(help=help, **more)}
    if isinstance(default, type):
        return field(default_factory=default, metadata=about)
    return field(default=default, metadata=about)


@cache
def options_in(kind: type) -> Mapping[str, Option]:
    """Return the options of a dataclass by its fields, with those inherited or declared again."""
    found: dict[str, Option] = {}
    for one in fields(kind):
        for base in kind.__mro__:
            known = getattr(base, "__dataclass_fields__", {}).get(one.name)
            if known is not None and "option" in known.metadata:
                found[one.name] = known.metadata["option"]
                break
    return found


def add_options(
    kind: type, group: Callable[[str], argparse._ActionsContainer], names: Iterable[str] = ()
) -> None:
    """Add the options of a dataclass, all or `names`, to a parser, but those that it has already.

    `group` returns the place of those with this `Option.group`. What is not given is None.
    """
    usual = {one.name: one.default for one in fields(kind)}
    for name, known in options_in(kind).items():
        place = group(known.group)
        if any(action.dest == name for action in place._actions) or (names and name not in names):
            continue
        more: dict[str, Any] = {"help": known.words.replace("%", "%%"), "dest": name}
        if usual[name] is False:  # a switch
            more |= {"action": "store_const", "const": True}
        else:
            more |= {"type": known.parse, "metavar": known.metavar}
        if known.limits is not None:
            low, high, unit = known.limits
            more["type"] = number(low, high, unit, known.factor)
            if known.is_whole:
                more["type"] = whole(int(low), int(high))
            more["metavar"] = known.metavar or unit.replace("·", "").upper() or None
        if known.is_many:
            more["action"] = "append"
        if known.choices:
            more["choices"] = known.values
        if known.alone is not None:
            more |= {"nargs": "?", "const": known.alone}
        action = place.add_argument(known.flag_of(name), **more)
        if known.offered:
            vars(action)[_OFFERED] = tuple(known.offered)


def given(arguments: argparse.Namespace, kind: type) -> dict[str, Any]:
    """Return the options of a dataclass that a command was given, by their names in Python."""
    values = {name: getattr(arguments, name, None) for name in options_in(kind)}
    return {name: value for name, value in values.items() if value is not None}


def made_of(kind: type[Kind], given: Mapping[str, Any]) -> Kind:
    """Make a dataclass of named options; None counts as not given. UsageError for unknown ones."""
    known = options_in(kind)
    if unknown := [name for name in given if name not in known]:
        raise UsageError(f"there is no option {unknown[0]!r}; there is: {', '.join(known)}")
    return kind(**{name: value for name, value in given.items() if value is not None})


class CheckedOptions:
    """Base of a dataclass whose options are checked when it is made, for Python and commands."""

    def __post_init__(self) -> None:
        for name, known in options_in(type(self)).items():
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, known.checked(name, value))

    def given(self, subject: str | None = None) -> dict[str, str]:
        """Return the options, all or of a `subject`, with another value than usual, by flag."""
        usual = {
            one.name: one.default if one.default_factory is MISSING else one.default_factory()
            for one in fields(self)  # pyright: ignore[reportArgumentType] (it is a dataclass)
        }
        return {
            known.flag_of(name): name
            for name, known in options_in(type(self)).items()
            if subject in (None, known.subject) and getattr(self, name) not in (usual[name], None)
        }


# ---- Shell completion: `--print-completion bash`, of every command

SHELLS = ("bash", "zsh", "tcsh")
_OFFERED = "offered"  # words for a shell to complete, where `choices` would refuse all others


def _completion(parser: argparse.ArgumentParser, shell: Any) -> str:
    """Return a shell's completion script."""
    import shtab  # only here: nothing else needs it

    _annotate(parser, shtab.FILE, shtab.DIRECTORY)
    return shtab.complete(parser, str(shell)) + "\n"


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
        elif action.type is Path or action.metavar in ("LOG", "SOURCE"):  # files, or addresses
            vars(action)["complete"] = folder if action.metavar == "DIR" else file


# ---- Parser and runner

_ALL = "all"


class Topic(NamedTuple):
    """Part of a command's options that not everybody needs."""

    title: str  # what they are for, in a few words
    examples: str = ""  # of them


class _Print(argparse.Action):
    """Print the text of the parser and the option's value, and exit."""

    def __init__(self, *names: Any, text_of: Callable[[Any, Any], str], **more: Any) -> None:
        super().__init__(*names, **more)
        self._text_of = text_of

    def __call__(
        self, parser: argparse.ArgumentParser, _namespace: object, values: Any, _option: object = ""
    ) -> None:
        print(self._text_of(parser, values), end="", flush=True)
        sys.exit(0)


class Parser(argparse.ArgumentParser):
    """Argument parser whose errors are one line, with exit code 2.

    `--help` tells what everybody needs, and names the topics; `--help TOPIC` tells the rest.
    """

    def __init__(
        self,
        prog: str,  # the command, with its verb where it has some
        description: str,
        examples: str,
        *,
        failed: str = "a log failed or was rejected",  # what exit code 1 means
        ended: str = "done",  # what exit code 0 means
        called: str = "",  # how it is called, in short
        topics: Mapping[str, Topic] | None = None,  # none for a command that tells all at once
    ) -> None:
        codes = f"exit codes: 0~{ended}, 1~{failed}, 2~wrong usage, 130~Ctrl-C"
        self._codes = fill(codes, 80, subsequent_indent="  ").replace("~", " ")
        self._topics, self._called, self._examples = topics or {}, called, examples
        self._about = description
        self._groups_of: dict[str, dict[str, argparse._ArgumentGroup]] = {}
        super().__init__(
            prog=prog,
            description=f"{description}\n\nexamples:\n{examples}",
            epilog=self._codes,
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
            add_help=not self._topics,
        )
        if self._topics:
            about = self.add_argument(
                "-h",
                "--help",
                nargs="?",
                action=_Print,
                text_of=lambda parser, topic: parser.help_on(topic),
                metavar="TOPIC",
                help="show this, or the options of a topic below",
            )
            vars(about)[_OFFERED] = (*self._topics, _ALL)
        place = self if not self._topics else self.topic("", "of every command")
        place.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
        place.add_argument("--debug", action="store_true", help="show the traceback of an error")
        if " " not in prog:  # one script completes a command with its verbs
            place.add_argument(
                "--print-completion",
                action=_Print,
                text_of=_completion,
                choices=SHELLS,
                help="print a script by which a shell completes it (tunenet docs commands)",
            )

    def topic(self, name: str, title: str = "") -> argparse._ArgumentGroup:
        """Return the group of this title of a topic, made when it is first asked for."""
        title = title or self._topics[name].title
        groups = self._groups_of.setdefault(name, {})
        if title not in groups:
            groups[title] = self.add_argument_group(title)
        return groups[title]

    def place(self, group: str) -> argparse._ActionsContainer:
        """Return where options of an `Option.group` go."""
        name, _, title = group.partition(":")
        return self.topic(name, title) if name else self

    def help_on(self, name: str | None) -> str:
        """Format the help: what everybody needs (None), a topic, or all; else UsageError."""
        if name == _ALL or not self._topics:
            every = [self._examples, *(one.examples for one in self._topics.values())]
            lines = "\n".join(dict.fromkeys("\n".join(every).splitlines()))
            self.description = f"{self._about}\n\nexamples:\n{lines}"
            return super().format_help()
        if name is not None and name not in self._topics:
            known = ", ".join((*self._topics, _ALL))
            raise UsageError(f"--help {short_name(name)}: is no topic; choose one of: {known}")
        formatter = self._get_formatter()
        if name is None:
            formatter.add_usage(f"%(prog)s {self._called}", self._actions, [])
            formatter.add_text(self.description)
            hidden = [group for groups in self._groups_of.values() for group in groups.values()]
            own = [self._positionals, self._optionals]
            groups = [one for one in self._action_groups if one not in (*hidden, *own)]
            shown = [(one.title, one._group_actions) for one in groups]
            shown.append(("options", [action for one in own for action in one._group_actions]))
        else:
            if examples := self._topics[name].examples:
                formatter.add_text(f"examples:\n{examples}")
            groups = self._groups_of.get(name, {})
            shown = [(title, one._group_actions) for title, one in groups.items()]
        for title, actions in shown:
            formatter.start_section(title)
            formatter.add_arguments(actions)
            formatter.end_section()
        if name is None:
            rows = "\n".join(f"  {one:12}{topic.title}" for one, topic in self._topics.items())
            formatter.add_text(f"topics, for --help TOPIC (or {_ALL}):\n{rows}")
            formatter.add_text(self._codes)
        return formatter.format_help()

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

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: Any = None
    ) -> tuple[Any, list[str]]:
        """Parse all; a word too many is told with the option before it, which takes only one."""
        words = list(sys.argv[1:] if args is None else args)
        found, extra = super().parse_known_args(words, namespace)
        # One that may be missing is missing to argparse where options stand before it.
        late = [one for one in self._get_positional_actions() if one.nargs == "?"]
        is_one = len(extra) == 1 and not extra[0].startswith("-")
        if is_one and late and getattr(found, late[-1].dest) is None:
            setattr(found, late[-1].dest, self._get_value(late[-1], extra.pop()))
        if extra:
            at = words.index(extra[0]) if extra[0] in words else 0
            before = words[at - 2] if at > 1 else ""
            action = self._option_string_actions.get(before)
            if action is None or action.nargs is not None or extra[0].startswith("-"):
                from difflib import get_close_matches

                word = extra[0].partition("=")[0]
                known = get_close_matches(word, self._option_string_actions, 1, 0.75)
                meant = f"; did you mean {known[0]}?" if known else ""
                self.error(f"unrecognized arguments: {' '.join(extra)}{meant}")
            is_many, what = isinstance(action, argparse._AppendAction), action.metavar or "value"
            again = f"; write {before} before each" if is_many else ""
            self.error(f"{before} takes one {what}, and {extra[0]} was not expected{again}")
        return found, extra

    def error(self, message: str) -> NoReturn:
        """Raise UsageError with one line."""
        raise UsageError(f"{message} (see {self.prog} --help)")


# Where NumPy looks, when it is loaded, for how many threads to use. Our matrices are small: a
# second thread mostly waits for the first, and on a busy machine both wait.
BLAS_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def run(
    parser: Parser, body: Callable[[argparse.Namespace], int], argv: Sequence[str] | None
) -> int:
    """Parse the arguments and run `body`, reporting a known error as one line on stderr.

    Returns the exit code: that of `body`, 1 or 2 for a known error, 128 and its number for a signal
    (130 for Ctrl-C).
    """
    words = list(sys.argv[1:] if argv is None else argv)
    for name in BLAS_THREADS:
        os.environ.setdefault(name, "1")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a name that the terminal cannot show
            stream.reconfigure(errors="backslashreplace")
    try:
        exits: SystemExit | None = None
        code = 0
        try:
            with stoppable():
                code = body(parser.parse_args(words))
        except SystemExit as error:  # --help, --version
            exits = error
        # What was said may not have reached standard output.
        sys.stdout.flush()
        raw = getattr(getattr(sys.stdout, "buffer", None), "raw", None)
        if failure := getattr(raw, "failure", None):  # a reader that left is none
            why = failure.strerror or failure
            raise LogError(f"standard output: {why}", "give it a place that takes it")
        if exits is not None:
            raise exits
        return code
    except (TuneNetError, OSError) as error:
        if "--debug" in words:
            print_traceback()
        what = str(error)
        if isinstance(error, OSError):  # a path that no file system takes, a full disk
            place = f"{error.filename}: " if error.filename else ""
            is_full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
            remedy = "free some space, or write to another disk" if is_full else CHECK_DISK
            what = f"{place}{error.strerror or error}; {remedy}"
        print(one_line(f"{parser.prog}: {what}"), file=sys.stderr)
        return error.exit_code if isinstance(error, TuneNetError) else 1
    except KeyboardInterrupt as stop:
        number = getattr(stop, "number", signal.SIGINT)  # none where closing a page raised it
        print(f"{parser.prog}: {WORDS[number]}", file=sys.stderr)
        return 128 + number


def print_traceback() -> None:
    """Print the traceback of the error being handled on stderr."""
    for part in traceback.format_exception(sys.exc_info()[1]):
        # A place in our code has lines of its own; what an error says may be anybody's words.
        is_place = part.startswith("  File ")
        print(part.rstrip() if is_place else one_line(part.strip()), file=sys.stderr)


def number(low: float, high: float, unit: str = "", factor: float = 1.0) -> Callable[[str], float]:
    """Return an argparse type: a finite number within [low, high], times `factor`."""
    what = f"a number {_range(low, high)}{' ' + unit if unit else ''}"
    parse = _within(float, low, high, what)
    return parse if factor == 1 else lambda text: factor * parse(text)


def whole(low: int, high: int) -> Callable[[str], int]:
    """Return an argparse type: an integer within [low, high]."""
    return _within(int, low, high, f"a whole number from {low} to {high}")


def _within(kind: Callable[[str], Any], low: float, high: float, what: str) -> Callable[[str], Any]:
    def parse(text: str) -> Any:
        value = None
        with suppress(ValueError):
            value = kind(text)
        if value is None or not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text!r} is not {what}")
        return value

    return parse


def numbers(count: int, low: float, high: float, what: str) -> Callable[[str], tuple[float, ...]]:
    """Return an argparse type: `count` numbers within [low, high], with commas; any number if 0."""

    def parse(text: str) -> tuple[float, ...]:
        try:
            values = tuple(float(part) for part in text.split(","))
        except ValueError:
            values = ()
        is_right = len(values) == (count or max(len(values), 1))
        if not is_right or not all(low <= value <= high for value in values):
            raise argparse.ArgumentTypeError(f"{text!r} is not {what}")
        return values

    return parse


def printable(most: int, what: str) -> Callable[[str], str]:
    """Return an argparse type: a line of 1 to `most` printable characters."""

    def parse(text: str) -> str:
        if not text.strip() or not text.isprintable() or len(text) > most:
            said = f"{short_name(text)!r} is not {what} of 1 to {most} printable characters"
            raise argparse.ArgumentTypeError(said)
        return text

    return parse


def _range(low: float, high: float) -> str:
    return f"from {low:.15g} to {high:.15g}"


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
