"""What pages show beside commands: checks, examples, Python that runs, links that lead on."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from docs import make_api
from tests.docs.commands import DOCUMENTS, other_fences
from tests.docs.parsing import run_in_process
from tests.docs.stand_ins import SAMPLES, make
from tests.wheel import ROOT
from tunenet_logs.analysis.api import tune

OF_A_TARE = re.compile(r"^tare( \d+)?: ")


def sections() -> dict[str, set[str]]:
    """The names of the checks that each section of the glossary lists."""
    parts = make_api.CHECKS.read_text("utf-8").split("\n## ")[1:]
    found = {
        one.partition("\n")[0]: set(re.findall(r"^- \*\*(.+?)\*\*", one, re.M)) for one in parts
    }
    return {title: names for title, names in found.items() if names}


def test_the_glossary_is_made_of_the_tables_of_checks():
    text = make_api.CHECKS.read_text("utf-8")
    assert make_api.checks_page(text) == text, "run: python docs/make_api.py"
    assert {title: set(specs) for title, specs in make_api.SECTIONS.items()} == sections()


def test_every_check_says_what_to_do():
    for spec in (one for table in make_api.SECTIONS.values() for one in table.values()):
        assert spec.measures, spec
        assert spec.advice, spec
        assert not spec.advice.endswith("."), spec


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


EXAMPLES = ROOT / "docs" / "examples"


def run(name: str, *arguments: object, cwd: Path) -> str:
    words = [sys.executable, str(EXAMPLES / name), *map(str, arguments)]
    done = subprocess.run(words, cwd=cwd, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_examples_say_what_is_true_of_their_logs(tmp_path: Path):
    said = run("drop.py", cwd=tmp_path)
    assert said.startswith("ok")
    speed, bounce = map(float, re.findall(r"^([\d.]+) m/s: ([\d.]+)$", said, re.MULTILINE)[0])
    assert speed == pytest.approx((2 * 9.80665 * 1.2) ** 0.5, rel=0.01)
    assert bounce == pytest.approx(0.75, abs=0.001)
    assert "failed" not in said
    said = run("folder.py", SAMPLES / "campaign", "table.csv", cwd=tmp_path)
    table = pd.read_csv(tmp_path / "table.csv")
    values = dict(zip((Path(log).stem for log in table["log"]), table["restitution"], strict=True))
    assert values["drop_2"] == pytest.approx(0.741, abs=0.001)
    assert values["drop_5"] == pytest.approx(0.786, abs=0.001)
    assert len(re.findall(r"drop_(?:3a|6)\.mcap  rejected  ", said)) == 2
    assert len(table) == 7
    said = run("own_engine.py", SAMPLES / "bouncy.mcap", cwd=tmp_path)
    tuned, stepped = (float(one) for one in re.findall(r"(?:tuned|stepped) ([\d.]+)", said))
    assert tuned == pytest.approx(0.85, abs=0.001)
    assert stepped == pytest.approx(0.85, abs=0.003)


def test_each_is_short_and_in_the_documents():
    text = (ROOT / "docs" / "examples.md").read_text()
    for path in EXAMPLES.glob("*.py"):
        assert f"examples/{path.name})" in text
        assert len(path.read_text().splitlines()) < 40


BLOCKS = [
    (f"{document.stem}-{number}", text)
    for document in DOCUMENTS
    for number, (language, text) in enumerate(other_fences(document))
    if language == "python"
]


@pytest.mark.parametrize(
    "text", [pytest.param(text, id=name) for name, text in BLOCKS if text.startswith("import ")]
)
def test_the_python_of_a_page_runs(text: str, tmp_path: Path):
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


def build(tree: Path, out: Path) -> subprocess.CompletedProcess[str]:
    """As `make docs` does."""
    pytest.importorskip("myst_parser", reason="needs the extra docs")
    words = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-c", str(tree / "docs")]
    words += ["-d", str(out / "doctrees"), str(tree), str(out / "site")]
    return subprocess.run(words, capture_output=True, text=True, timeout=300)


def test_the_site_is_built_without_a_warning(tmp_path: Path):
    built = build(ROOT, tmp_path)
    assert built.returncode == 0, built.stderr
    for document in DOCUMENTS:
        page = document.relative_to(ROOT).with_suffix(".html")
        assert (tmp_path / "site" / page).is_file(), page
    assert "docs/index.html" in (tmp_path / "site" / "index.html").read_text()
    landing = (tmp_path / "site" / "docs" / "index.html").read_text()
    assert all(f'<span class="caption-text">{name}</span>' in landing for name in ("Start", "Tune"))


LINKS = {  # by the page that has one: the link, and what is told of it
    "a": ("[there](other.md)", None),
    "b": ("[there](other.md#a-part)", None),
    "c": ("[nowhere](none.md)", "none.md"),
    "d": ("[nowhere](other.md#no-part)", "no-part"),
    "e": ("[nowhere](#no-part)", "no-part"),
    "f": ("![nothing](none.png)", "none.png"),
    "g": ("[nowhere](../none.py)", "none.py"),
}


def test_a_link_that_leads_nowhere_and_a_page_that_is_not_listed_are_told(tmp_path: Path):
    docs = tmp_path / "docs"
    shutil.copytree(ROOT / "docs" / "site", docs / "site")
    shutil.copy(ROOT / "docs" / "conf.py", docs)
    listed = "".join(f"- [{name}]({name}.md)\n" for name in (*LINKS, "other"))
    (docs / "index.md").write_text(f"# Start\n\n## Use\n\n{listed}")
    (docs / "other.md").write_text("# Other\n\n## A part\n\nText.\n")
    (docs / "unlisted.md").write_text("# Unlisted\n")
    for name, (link, _) in LINKS.items():
        (docs / f"{name}.md").write_text(f"# Page {name}\n\n{link}\n")
    built = build(tmp_path, tmp_path / "build")
    assert built.returncode != 0
    told = built.stderr.splitlines()
    for name, (link, complaint) in LINKS.items():
        lines = [line for line in told if f"/{name}.md" in line.split(": ")[0]]
        assert bool(lines) == (complaint is not None), (link, lines)
        assert complaint is None or complaint in lines[0]
    assert any("unlisted.md" in line for line in told)
