"""docs/api.md is made of the docstrings, and these say all that there is to say."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
from types import FunctionType

import pytest

import tunenet_logs as tn
from tests.conftest import ROOT
from tunenet_logs.console import options_in


def test_the_page_is_made_of_the_docstrings_as_they_are():
    words = [sys.executable, "docs/make_api.py", "--check"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", tn.__all__)
def test_every_public_name_is_documented(name: str):
    heading, text = (ROOT / "docs" / "api.md").read_text().split(f"\n### {name}\n", 1)
    assert heading
    text = text.partition("\n### ")[0].partition("\n## ")[0]
    assert len(text.split()) > 3
    known = getattr(tn, name)
    if not isinstance(known, FunctionType):
        return
    documented = set(re.findall(r"^- `\**(\w+)`: \S", text, re.MULTILINE))
    given = set(inspect.signature(known).parameters) - set(options_in(tn.TuneOptions))
    if len(given) > 2:
        assert given <= documented
