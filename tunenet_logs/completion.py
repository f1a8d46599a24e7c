"""Complete commands in a shell: `--print-completion bash`, of every command."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

SHELLS = ("bash", "zsh", "tcsh")

# Metavars of what may be a file and need not: an address, a camera's number.
_PATHS = ("LOG", "SOURCE")

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
