"""The glossary has every check that a tuning can have, and none that there is not."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from docs import make_api
from tests.docs.stand_ins import SAMPLES, make
from tunenet_logs.analysis.api import tune
from tunenet_logs.analysis.checks import CheckSpec

OF_A_TARE = re.compile(r"^tare( \d+)?: ")


def sections() -> dict[str, set[str]]:
    """The names of the checks that each section of the glossary lists."""
    found: dict[str, set[str]] = {}
    for section in make_api.CHECKS.read_text("utf-8").split("\n## ")[1:]:
        title, _, text = section.partition("\n")
        rows = text.partition("| --- |")[2].splitlines()[1:]
        if "\n| check | " in text:
            found[title] = {row.split(" | ")[0].strip("| ") for row in rows if row.startswith("|")}
    return found


def test_the_glossary_is_made_of_the_tables_of_checks():
    text = make_api.CHECKS.read_text("utf-8")
    assert make_api.checks_page(text) == text, "run: python docs/make_api.py"
    assert {title: set(specs) for title, specs in make_api.SECTIONS.items()} == sections()


@pytest.mark.parametrize(
    "spec", [one for table in make_api.SECTIONS.values() for one in table.values()]
)
def test_every_check_says_what_to_do(spec: CheckSpec):
    assert spec.measures
    assert spec.cause
    assert spec.advice
    assert not spec.advice.endswith(".")


DROP = "A drop from positions or a film"


@pytest.mark.parametrize(
    ("name", "titles", "options"),
    [
        ("light.mcap", (DROP, "A drop from positions"), {}),
        ("filmed.mcap", (DROP, "A film"), {}),
        ("claps.xlsx", (DROP, "Impact times"), {"height_m": 0.5}),
        ("payload.mcap", ("A payload",), {"tares": [SAMPLES / "payload_empty.mcap"]}),
    ],
)
def test_what_a_tuning_checks_stands_in_its_section(
    name: str, titles: tuple[str, ...], options: dict[str, Any], tmp_path: Path
):
    make(tmp_path / name)
    tuning = tune(tmp_path / name, **options)
    names = {OF_A_TARE.sub("", check.name) for check in tuning.checks}
    wanted = set().union(*(make_api.SECTIONS[one] for one in ("Any log", *titles)))
    assert len(names) > 6
    assert names <= wanted
