"""The glossary has every check that a tuning can have, and none that there is not."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from tests.docs.stand_ins import SAMPLES, make
from tests.wheel import ROOT
from tunenet_logs.analysis.api import tune
from tunenet_logs.analysis.options import TuneOptions

GLOSSARY = ROOT / "docs" / "checks.md"
OF_A_TARE = re.compile(r"^tare( \d+)?: ")


@cache
def glossary() -> dict[str, set[str]]:
    """The names that each section lists."""
    found: dict[str, set[str]] = {}
    for section in GLOSSARY.read_text().split("\n## ")[1:]:
        title, _, text = section.partition("\n")
        if "\n| check | " in text:
            rows = text.partition("| --- |")[2].splitlines()[1:]
            found[title] = {row.split(" | ")[0].strip("| ") for row in rows if row.startswith("|")}
    return found


def written(tree: ast.Module) -> Iterator[tuple[str, str]]:
    """What each `Check` of a module is called, and its advice where that stands there as one text.

    Of one that is made in a function which is given the name: what the function's callers give.
    """
    for function in [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]:
        given = [argument.arg for argument in function.args.args]
        for call in _calls(function, "Check"):
            name = call.args[0]
            advice = [word.value for word in call.keywords if word.arg == "advice"]
            is_text = bool(advice) and isinstance(advice[0], ast.Constant)
            if isinstance(name, ast.Name) and name.id in given:
                at = given.index(name.id)
                yield from ((_text(one.args[at]), "") for one in _calls(tree, function.name))
            else:
                yield _text(name), _text(advice[0]) if is_text else ""


def _calls(tree: ast.AST, name: str) -> Iterator[ast.Call]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and getattr(node.func, "id", None) == name:
            yield node


def _text(node: ast.expr) -> str:
    """A text in the source; of one that is made up, without what varies before `: `."""
    if isinstance(node, ast.JoinedStr):
        node = node.values[-1]
        assert isinstance(node, ast.Constant)
        return str(node.value).removeprefix(": ")
    assert isinstance(node, ast.Constant), ast.unparse(node)
    return str(node.value)


@cache
def all_written() -> frozenset[tuple[str, str]]:
    reads = ROOT / "analysis" / "record.py"  # it makes checks of what a JSON has
    files = [path for path in sorted((ROOT / "analysis").rglob("*.py")) if path != reads]
    return frozenset(pair for path in files for pair in written(ast.parse(path.read_text())))


def test_the_glossary_has_the_checks_of_the_source_and_no_other():
    named = {name for name, _ in all_written()}
    listed = set().union(*glossary().values())
    assert sorted(named - listed) == [], "not in docs/checks.md"
    assert sorted(listed - named) == [], "in docs/checks.md alone"


def test_the_glossary_advises_as_the_check_itself():
    rows = [row.replace("`", "") for row in GLOSSARY.read_text().splitlines() if row[:2] == "| "]
    wrong = [
        f"{name}: {advice}"
        for name, advice in sorted(all_written())
        if not any(row.startswith(f"| {name} |") and advice in row for row in rows)
    ]
    assert not wrong, "\n".join(wrong)


DROP = "A drop from positions or a film"


@pytest.mark.parametrize(
    ("name", "sections", "options"),
    [
        ("light.mcap", (DROP, "A drop from positions"), {}),
        ("filmed.mcap", (DROP, "A film"), {}),
        ("claps.xlsx", (DROP, "Impact times"), {"height_m": 0.5}),
        ("payload.mcap", ("A payload",), {"tares": [SAMPLES / "payload_empty.mcap"]}),
    ],
)
def test_what_a_tuning_checks_stands_in_its_section(
    name: str, sections: tuple[str, ...], options: TuneOptions, tmp_path: Path
):
    make(tmp_path / name)
    tuning = tune(tmp_path / name, **options)
    names = {OF_A_TARE.sub("", check.name) for check in tuning.checks}
    wanted = set().union(*(glossary()[section] for section in ("Any log", *sections)))
    assert len(names) > 6
    assert names <= wanted
