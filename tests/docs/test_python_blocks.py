"""The Python that a document shows runs as it stands there, on files of the names that it uses."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.docs.commands import DOCUMENTS, other_fences
from tests.docs.parsing import run_in_process
from tests.docs.stand_ins import make

BLOCKS = [
    (f"{document.stem}-{number}", text)
    for document in DOCUMENTS
    for number, (language, text) in enumerate(other_fences(document))
    if language == "python"
]


@pytest.mark.parametrize(
    "text", [pytest.param(text, id=name) for name, text in BLOCKS if text.startswith("import ")]
)
def test_it_runs(text: str, tmp_path: Path):
    if "results/ledger.parquet" in text:
        make(tmp_path / "runs")
        words = ("tunenet-tune", "runs", "-o", "results", "--no-review", "--jobs", "1")
        assert run_in_process(words, tmp_path).returncode == 0
    for name in re.findall(r'"([\w/.]+\.(?:mcap|mp4))"', text):
        make(tmp_path / name)
    words = [sys.executable, "-c", text]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert done.stdout


def test_a_piece_of_a_program_is_python():
    pieces = {name: text for name, text in BLOCKS if not text.startswith("import ")}
    for name, text in pieces.items():
        if not name.startswith("api-"):  # signatures, which are made of the source
            compile(text, name, "exec")
