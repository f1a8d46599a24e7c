"""The pins are lines that pip takes, one for each package, and none of ours is without."""

from __future__ import annotations

import tomllib
from itertools import chain

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.wheel import ROOT

LINES = (ROOT / "constraints.txt").read_text().splitlines()


def test_each_line_pins_one_package():
    pins = [Requirement(line) for line in LINES]
    names = [canonicalize_name(pin.name) for pin in pins]
    assert names == sorted(set(names))
    assert all(str(pin.specifier).startswith("==") for pin in pins)


def test_all_that_we_ask_for_is_pinned():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    asked = [*project["dependencies"], *chain(*project["optional-dependencies"].values())]
    pins = {canonicalize_name(pin.name): pin for pin in map(Requirement, LINES)}
    for one in map(Requirement, asked):
        name = canonicalize_name(one.name)
        if name != "tunenet-logs":
            (pin,) = pins[name].specifier
            assert one.specifier.contains(pin.version), one
