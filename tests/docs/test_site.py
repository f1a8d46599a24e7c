"""The site is made of the documents without a warning; a link that leads nowhere has one."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.docs.commands import DOCUMENTS
from tests.wheel import ROOT

pytest.importorskip("myst_parser", reason="needs the extra docs")


def build(tree: Path, out: Path) -> subprocess.CompletedProcess[str]:
    """As `make docs` does."""
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


@pytest.mark.parametrize(
    ("page", "complaint"),
    [
        ("[there](other.md)", None),
        ("[there](other.md#a-part)", None),
        ("[nowhere](none.md)", "none.md"),
        ("[nowhere](other.md#no-part)", "no-part"),
        ("[nowhere](#no-part)", "no-part"),
        ("![nothing](none.png)", "none.png"),
        ("[nowhere](../none.py)", "none.py"),
    ],
)
def test_a_link_that_leads_nowhere_is_told(page: str, complaint: str | None, tmp_path: Path):
    docs = tmp_path / "docs"
    shutil.copytree(ROOT / "docs" / "site", docs / "site")
    shutil.copy(ROOT / "docs" / "conf.py", docs)
    (docs / "index.md").write_text("# Start\n\n## Use\n\n- [One](one.md)\n- [Other](other.md)\n")
    (docs / "one.md").write_text(f"# One\n\n{page}\n")
    (docs / "other.md").write_text("# Other\n\n## A part\n\nText.\n")
    built = build(tmp_path, tmp_path / "build")
    assert (built.returncode == 0) == (complaint is None), built.stderr
    assert complaint is None or complaint in built.stderr


def test_a_page_that_the_landing_page_does_not_list_is_told(tmp_path: Path):
    docs = tmp_path / "docs"
    shutil.copytree(ROOT / "docs" / "site", docs / "site")
    shutil.copy(ROOT / "docs" / "conf.py", docs)
    (docs / "index.md").write_text("# Start\n")
    (docs / "one.md").write_text("# One\n")
    assert "one.md" in build(tmp_path, tmp_path / "build").stderr
