"""The site: `make docs` builds every Markdown file of the tree's documents to build/docs.

The root of the tree is Sphinx's source folder, so links between README, ARCHITECTURE and docs/ are
checked like any other. The files have no directive of Sphinx in them: the contents come from the
lists of docs/index.md.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sphinx.application import Sphinx

project = "tunenet-logs"
extensions = ["myst_parser"]
root_doc = "docs/index"
include_patterns = ["*.md", "docs/*.md", "sample_logs/README.md"]
include_patterns += ["recorders/simulators/arm/known/*.md"]
# Folders that are not even looked into.
exclude_patterns = [".*", "**/__pycache__", "build", "dist", "demo", "env", "*.egg-info"]

html_theme = "furo"
html_title = "tunenet-logs"
html_extra_path = ["site"]
html_show_copyright = False
html_copy_source = False

myst_heading_anchors = 4
smartquotes = False
nitpicky = True
# JSON in the documents leaves out what repeats, with three dots: no lexer takes that.
suppress_warnings = ["misc.highlighting_failure"]

_SECTION = re.compile(r"^## (.+)\n((?:.*\n)+?)(?=^## |\Z)", re.MULTILINE)
_PAGE = re.compile(r"^- \[[^]]+\]\(([^)#]+)\.md\)", re.MULTILINE)


def contents(text: str) -> str:
    """One hidden table of contents for each section of the landing page, of the pages it lists."""
    return "".join(
        f"\n```{{toctree}}\n:hidden:\n:caption: {name}\n\n" + "\n".join(pages) + "\n```\n"
        for name, body in _SECTION.findall(text)
        if (pages := _PAGE.findall(body))
    )


def setup(app: Sphinx) -> None:
    """Have the landing page's lists be the site's contents."""

    def add_contents(_: Sphinx, page: str, source: list[str]) -> None:
        if page == root_doc:
            source[0] += contents(source[0] + "\n")

    app.connect("source-read", add_contents)
