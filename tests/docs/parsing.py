"""A command's words, given to the parser that the command itself uses; nothing is run."""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import io
import sys
import tomllib
from collections.abc import Callable, Iterator, Sequence
from contextlib import chdir, contextmanager, redirect_stderr, redirect_stdout
from functools import cache
from pathlib import Path
from subprocess import CompletedProcess

from tests.wheel import ROOT
from tunenet_logs.commands import VERBS


class ParsedError(BaseException):
    """Ends a command when its parser has taken the words; it holds the parser."""

    def __init__(self, parser: argparse.ArgumentParser) -> None:
        super().__init__()
        self.parser = parser


@cache
def scripts() -> dict[str, str]:
    """Our commands, each with where it begins, as `pyproject.toml` has them."""
    return tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]


@cache
def extras() -> set[str]:
    """The names of the extras that can be installed."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    return set(project["optional-dependencies"])


def script_of(word: str) -> str | None:
    """The name of our command that a first word calls, also as a path."""
    name = Path(word).name
    return name if name in scripts() else None


def beginning(words: Sequence[str]) -> tuple[Callable[[], object], tuple[str, ...]] | None:
    """What a command of ours calls, and its arguments; None for another program's.

    Raises:
        AssertionError: a module that is not there.
    """
    if (name := script_of(words[0])) is not None:
        return _main(name), tuple(words[1:])
    if words[0].startswith("python") and list(words[1:2]) == ["-m"] and _is_ours(words[2]):
        module = importlib.import_module(_runnable(words[2]))
        if "ArgumentParser" not in Path(str(module.__file__)).read_text():
            return _nothing, tuple(words[3:])
        return module.main, tuple(words[3:])
    return None


def refusal(words: Sequence[str]) -> str | None:
    """Why the parser does not take a command of ours; None where it does."""
    begun = beginning(words)
    assert begun is not None, f"no command of ours: {words}"
    entry, arguments = begun
    if entry is _nothing:
        return f"{words[2]} takes no arguments" if arguments else None
    out, errors = io.StringIO(), io.StringIO()
    try:
        with (
            _stopping_after_parsing(),
            _arguments(words[0], arguments),
            redirect_stdout(out),
            redirect_stderr(errors),
        ):
            code = entry()
    except ParsedError:
        return None
    except SystemExit as stop:
        code = stop.code
    if code == 0:  # done with printing something, such as a completion
        return None
    return errors.getvalue().strip() or f"ended with {code}"


def run_in_process(words: Sequence[str], folder: Path) -> CompletedProcess[str]:
    """Run a command of ours as its console script does, in this process and in a folder."""
    begun = beginning(words)
    assert begun is not None, f"no command of ours: {words}"
    out, err = io.StringIO(), io.StringIO()
    with chdir(folder), _arguments(words[0], begun[1]), redirect_stdout(out), redirect_stderr(err):
        try:
            code = begun[0]()
        except SystemExit as stop:
            code = stop.code
    return CompletedProcess(list(words), int(code or 0), out.getvalue(), err.getvalue())  # type: ignore[call-overload]


@cache
def all_options() -> frozenset[str]:
    """Every option of every command of ours."""
    found: set[str] = set()
    for name in scripts().keys() - {"tunenet"}:
        found |= _options(_main(name), name)
    return frozenset(found)


def module_options(module: str) -> set[str]:
    """Every option of a module that is run with `python -m`."""
    begun = beginning(("python", "-m", module))
    assert begun is not None
    return set() if begun[0] is _nothing else _options(begun[0], module)


def _main(script: str) -> Callable[[], object]:
    """What a script calls when its process is set up, which would change this one's signals."""
    return importlib.import_module(VERBS[script.removeprefix("tunenet-")][0]).main


def _options(entry: Callable[[], object], name: str) -> set[str]:
    """Those of a command; what is required of its arguments is not asked for."""
    try:
        with _stopping_after_parsing(early=True), _arguments(name, ()):
            entry()
    except ParsedError as parsed:
        return set(_walk(parsed.parser))
    raise AssertionError(f"{name} has no parser")


def _walk(parser: argparse.ArgumentParser) -> Iterator[str]:
    for action in parser._actions:
        yield from action.option_strings
        if isinstance(action, argparse._SubParsersAction):
            for one in action.choices.values():
                yield from _walk(one)


def _nothing() -> None:
    """In place of the `main` of a module that takes no arguments."""


def _is_ours(module: str) -> bool:
    return module.partition(".")[0] in {"tests", "tunenet_logs"}


def _runnable(module: str) -> str:
    """The module that `python -m` runs under a name."""
    try:
        spec = importlib.util.find_spec(module)
    except ModuleNotFoundError:
        spec = None
    assert spec is not None, f"there is no module {module}"
    return f"{module}.__main__" if spec.submodule_search_locations else module


@contextmanager
def _arguments(program: str, arguments: Sequence[str]) -> Iterator[None]:
    before = sys.argv
    sys.argv = [program, *arguments]
    try:
        yield
    finally:
        sys.argv = before


@contextmanager
def _stopping_after_parsing(*, early: bool = False) -> Iterator[None]:
    """Have every parser end the command when it has parsed; `early`: before it does."""
    original = argparse.ArgumentParser.parse_args

    def parse_args(self: argparse.ArgumentParser, *arguments: object, **more: object) -> None:
        if not early:
            original(self, *arguments, **more)  # type: ignore[arg-type]
        raise ParsedError(self)

    argparse.ArgumentParser.parse_args = parse_args  # type: ignore[method-assign, assignment]
    try:
        yield
    finally:
        argparse.ArgumentParser.parse_args = original  # type: ignore[method-assign]
