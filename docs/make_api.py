"""Write docs/api.md, docs/options.md and the lists of docs/checks.md: `python docs/make_api.py`.

The first is made of the docstrings of `tunenet_logs`, the second of the options that it declares,
the last of its tables of checks.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import griffe

from tunenet_logs.analysis.checks import LOG, CheckSpec
from tunenet_logs.analysis.drop.checks import DROP, FILM, PAPER, POSITIONS, TIMES
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.payload.checks import PAYLOAD
from tunenet_logs.analysis.sysid.checks import SYSID
from tunenet_logs.console import Parser, options_in
from tunenet_logs.recorders.orders import DropOrder, FilmOrder, PayloadOrder, ShotOrder

ROOT = Path(__file__).resolve().parents[1]
PAGE, OPTIONS, CHECKS = (ROOT / "docs" / f"{name}.md" for name in ("api", "options", "checks"))

# Tables of checks, by the section of docs/checks.md.
SECTIONS = {
    "Any log": LOG,
    "A drop from positions or a film": DROP,
    "A drop from positions": POSITIONS,
    "A film": FILM,
    "Under the preset `paper`": PAPER,
    "Impact times": TIMES,
    "A simulator of your own": SYSID,
    "A payload": PAYLOAD,
}

_GROUPS = ("What one calls", "What comes out", "What goes in", "Errors")

_HEAD = """\
# Python

<!-- made by `python docs/make_api.py` from the docstrings; change those -->
"""
_IN_HELP = "Arguments, units and what a call raises are in `help(tn.tune)`, `help(tn.Record)`, ..."


def page() -> str:
    """The text of the page."""
    package = griffe.load(
        "tunenet_logs.analysis.api",
        search_paths=[ROOT],
        docstring_parser="google",
        resolve_aliases=True,
        resolve_external=True,
    )
    assert package.docstring is not None
    assert package.exports is not None
    parts = [_HEAD, package.docstring.value, _IN_HELP]
    groups: dict[str, list[str]] = {title: [] for title in _GROUPS}
    names = (str(name).strip("'\"") for name in package.exports)
    for name in sorted(names, key=str.lower):
        groups[_group(name, package[name])] += _entry(name, package[name])
    for title, entries in groups.items():
        parts += [f"## {title}", *entries]
    return "\n\n".join(part.strip("\n") for part in parts if part) + "\n"


def _group(name: str, entry: Any) -> str:
    """Under which heading a name stands."""
    if entry.is_function:
        return "What one calls"
    if name.endswith("Error"):
        return "Errors"
    is_given = name.endswith(("Order", "Options")) or name in ("Ball", "BALLS", "Reviewed")
    return "What goes in" if is_given else "What comes out"


def _entry(name: str, entry: Any) -> Iterator[str]:
    """One public name: heading, signature, what it is, and the fields and methods of a class."""
    yield f"### {name}"
    if entry.is_function:
        yield f"```python\n{_signature(name, entry)}\n```"
    if entry.docstring is not None:
        yield _summary(entry)
    if not entry.is_class or name.endswith("Error"):
        return
    yield from _fields(entry)
    rows: list[str] = []
    for own_name, member in entry.members.items():
        is_called = member.is_function or "property" in member.labels
        if is_called and not own_name.startswith("_") and member.docstring is not None:
            title = _signature(own_name, member) if member.is_function else own_name
            text = _one_line(member.docstring.parse("google")[0].value)
            if "olumns" not in text:  # of a table, which columns it has
                text = f"{text.removesuffix('.').split('. ')[0]}."
            rows.append(f"- `{title}`: {text}")
    yield "\n".join(rows)


def _signature(name: str, function: Any) -> str:
    """As one would write it, an argument a line where it is long."""
    shown: list[str] = []
    for one in function.parameters:
        if one.name in ("self", "cls"):
            continue
        kind = one.kind.value if one.kind else ""
        if kind == "keyword-only" and "*" not in shown:
            shown.append("*")
        mark = {"variadic keyword": "**", "variadic positional": "*"}.get(kind, "")
        text = f"{mark}{one.name}: {one.annotation}" if one.annotation else mark + one.name
        has_default = one.default is not None and not mark
        shown.append(f"{text} = {one.default}" if has_default else text)
    ending = f" -> {function.returns}" if function.returns else ""
    line = f"{name}({', '.join(shown)}){ending}"
    if len(line) <= 88 or function.parent.is_class:
        return line
    return f"{name}(\n" + "".join(f"    {one},\n" for one in shown) + f"){ending}"


def _summary(entry: Any) -> str:
    """The first paragraph of its docstring."""
    return _one_line(entry.docstring.value.split("\n\n")[0])


def _fields(entry: Any) -> Iterator[str]:
    """The fields of a dataclass, inherited ones too; those that are options are a link."""
    kind = getattr(import_module("tunenet_logs"), entry.name, None)
    options = options_in(kind) if isinstance(kind, type) and is_dataclass(kind) else {}
    own = [
        name
        for name, member in {**entry.inherited_members, **entry.members}.items()
        if member.is_attribute and "property" not in member.labels and not name.startswith("_")
    ]
    for title, names in (
        ("Fields", [name for name in own if name not in options]),
        ("Fields that are [options](options.md)", options),
    ):
        if names:
            yield f"{title}: " + ", ".join(f"`{name}`" for name in names)


def _one_line(text: str) -> str:
    return " ".join(text.split())


# ---- The options of the commands that have many, by the topics of their help

_KINDS = (TuneOptions, DropOrder, FilmOrder, PayloadOrder, ShotOrder)
_COMMANDS = ("tunenet_logs.analysis.cli.tune", "tunenet_logs.recorders.cli")
_OPTIONS_HEAD = """\
# Options

<!-- made by `python docs/make_api.py` from the options as they are declared; change those -->

By the topics of `--help TOPIC`; what both commands have stands first. In [Python](api.md) an option
of `tunenet-tune` is an argument of `tunenet_logs.tune`, one of a simulation a field of an order, by
the same name (`--arm-card`: `arm_card`), or the one in brackets. All other commands have few: see
their `--help`.
"""


def options_page() -> str:
    """The text of the page of options."""
    parsers: list[Parser] = [import_module(name).build_parser() for name in _COMMANDS]
    rows = {
        (parser.prog, str(group.title).replace("options", "what everybody needs")): [
            _row(action) for action in group._group_actions if action.option_strings
        ]
        for parser in parsers
        for group in parser._action_groups
        if group.title != "of every command"
    }
    times = Counter(row for own in rows.values() for row in own)
    parts = [_OPTIONS_HEAD, "## Both", "\n".join(row for row, n in times.items() if n > 1)]
    for (command, title), own in rows.items():
        if alone := [row for row in own if times[row] == 1]:
            parts += [f"## {command}: {title}", "\n".join(alone)]
    return "\n\n".join(part.strip("\n") for part in parts) + "\n"


def _row(action: argparse.Action) -> str:
    """An option, its name in Python where that differs, and what it does."""
    choices = ",".join(map(str, action.choices or ()))
    value = action.metavar or (choices and f"{{{choices}}}")
    shown = " ".join(filter(None, (", ".join(action.option_strings), str(value))))
    text = _one_line(str(action.help)).replace("%(prog)s", "the program").replace("%%", "%")
    is_known = any(action.dest in options_in(kind) for kind in _KINDS)
    is_renamed = is_known and f"--{action.dest.replace('_', '-')}" not in action.option_strings
    return f"- `{shown}`{f' (`{action.dest}`)' if is_renamed else ''}: {text}"


# ---- The lists of checks

_CHECK_LINES = re.compile(r"(?:^- \*\*.*\n)+", re.MULTILINE)


def checks_page(text: str) -> str:
    """The text of docs/checks.md, with its lists as the tables of checks are."""
    parts = re.split(r"(?m)^## (.*)$", text)
    told: dict[str, str] = {}  # advice, and the check that it stands with
    for at in range(1, len(parts), 2):
        if specs := SECTIONS.get(parts[at]):
            lines = "".join(_check_line(spec, told) + "\n" for spec in specs.values())
            parts[at + 1] = _CHECK_LINES.sub(lines.replace("\\", r"\\"), parts[at + 1])
        parts[at] = f"## {parts[at]}"
    return "".join(parts)


def _check_line(spec: CheckSpec, told: dict[str, str]) -> str:
    """Format a check: name, verdict if not, what it measures, what passes, what to do.

    Advice that stands above is not repeated.
    """
    sense, value, unit, _, worst = spec.limit
    limit = f"{value:g} {unit}".rstrip()
    usual = {"at least": "{} or more", "within": "at most {} either way"}.get(sense, "at most {}")
    passes = spec.passes.format(limit=f"{value:g}") or usual.format(limit)
    doubts = [] if spec.invalidates_interval else ["i"]
    beyond = "under" if sense == "at least" else "over"
    if worst is not None:
        doubts = ["r"] if worst == value else [*doubts, f"r {beyond} {worst:g}"]
    if_not = spec.if_not or "; ".join(doubts)
    advice = re.sub(r"<[^>]+>|--[a-z-]+", lambda option: f"`{option[0]}`", spec.advice)
    advice = re.sub(r"tunenet-\w+ .*", lambda command: f"`{command[0].replace('`', '')}`", advice)
    what = f"**{spec.name}** ({if_not})" if if_not else f"**{spec.name}**"
    advice = f"{advice[0].upper()}{advice[1:]}."
    if (first := told.setdefault(advice, spec.name)) != spec.name:
        advice = f"As *{first}*."
    return f"- {what}: {spec.measures}, **{passes}**. {advice}"


if __name__ == "__main__":
    pages = {
        PAGE: page(),
        OPTIONS: options_page(),
        CHECKS: checks_page(CHECKS.read_text("utf-8")),
    }
    for path, text in pages.items():
        if "--check" not in sys.argv:
            path.write_text(text, "utf-8")
        elif path.read_text("utf-8") != text:
            sys.exit(f"{path.relative_to(ROOT)} is old: run this without --check")
