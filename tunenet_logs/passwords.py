"""Read passwords from files and netrc: arguments are public, every user's `ps` shows them."""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.files import read_small_file

# What a netrc file holds beside its words: macros, up to an empty line, and comments.
_MACRO = re.compile(r"^[ \t]*macdef\b.*?(?:^[ \t]*\r?$|\Z)|^[ \t]*#.*?$", re.DOTALL | re.MULTILINE)
_NETRC_WORD = re.compile(r'"((?:[^"\\]|\\.)*)"(?=\s|$)|\S+')


@dataclass(frozen=True)
class KnownLogin:
    """Login for a host."""

    user: str = ""  # "" for none
    password: str = field(default="", repr=False)
    trouble: str = ""  # why what may be written down could not be used; "" where nothing is


def read_password(file: Path, option: str) -> tuple[str, bool]:
    """Read the one line of a password's file; also return whether others may read that file."""
    try:
        data = read_small_file(file, 4096)
        text = data.decode("utf-8-sig").removesuffix("\n").removesuffix("\r")
        is_shown = bool(file.stat().st_mode & (stat.S_IRGRP | stat.S_IROTH))
    except LogError as error:
        raise UsageError(f"{option} {error}") from error
    except OSError as error:
        raise UsageError(f"{option} {file}: cannot be read ({error.strerror})") from error
    except UnicodeError as error:
        why = f"{option} {file}: is no UTF-8 text; write the password alone into it"
        raise UsageError(why) from error
    except ValueError as error:
        raise UsageError(f"{option} {file}: {error}; write the password alone into it") from error
    if "\n" in text or "\r" in text:
        raise UsageError(f"{option} {file}: has several lines; write the password alone into it")
    if not text or not text.isprintable():
        what = "has characters that nobody can type" if text else "is empty"
        raise UsageError(f"{option} {file}: {what}; write the password into it, as one line")
    return text, is_shown


def netrc_login(host: str, user: str = "") -> KnownLogin:
    """Look a host up in `~/.netrc` (or the file that `NETRC` names)."""
    # Its `default`, which is for any host, is not taken.
    file = Path(os.environ.get("NETRC") or Path.home() / ".netrc")
    try:
        state = file.stat()
        text = read_small_file(file, 1_000_000).decode("utf-8-sig", errors="replace")
    except FileNotFoundError:
        return KnownLogin(user)
    except (LogError, OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        return KnownLogin(user, trouble=f"{file} is not used ({why})")
    known = [entry for entry in _netrc_entries(text) if entry["machine"].lower() == host.lower()]
    if not known:
        return KnownLogin(user)
    if state.st_mode & (stat.S_IRWXG | stat.S_IRWXO) or state.st_uid not in (os.geteuid(), 0):
        return KnownLogin(user, trouble=f"{file} is not used, others can read it: chmod 600 {file}")
    for entry in known:
        if "password" in entry and user in ("", entry.get("login", user)):
            return KnownLogin(user or entry.get("login", ""), entry["password"])
    return KnownLogin(user, trouble=f"{file} has no password of this user there")


def _netrc_entries(text: str) -> Iterator[dict[str, str]]:
    """Yield the entries of a netrc file, each with its `machine`; unknown words are skipped."""
    # Python's own reader gives up the whole file for one such word, and keeps one user of a host.
    entry: dict[str, str] = {}
    words = _NETRC_WORD.finditer(_MACRO.sub("", text))
    for word in words:
        name = word[0]
        if name in ("machine", "default"):
            if "machine" in entry:
                yield entry
            value = next(words, None) if name == "machine" else None
            entry = {} if value is None else {"machine": _unquoted(value)}
        elif name in ("login", "password", "account") and (value := next(words, None)):
            entry[name] = _unquoted(value)
    if "machine" in entry:
        yield entry


def _unquoted(word: re.Match[str]) -> str:
    text = word[0]
    return re.sub(r"\\(.)", r"\1", text[1:-1]) if word[1] is not None else text
