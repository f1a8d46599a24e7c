"""The notebook of the documents, run from its first cell to its last."""

from __future__ import annotations

import nbformat
from nbclient import NotebookClient

from tests.conftest import ROOT

NOTEBOOK = ROOT / "docs" / "notebook.ipynb"

_OF_ONE_CELL_S = 300  # a bound, not an expectation


def _said(notebook: nbformat.NotebookNode) -> list[str]:
    """What is printed and shown, a text a cell."""
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    return [
        "".join(
            output.get("text", "") or output.get("data", {}).get("text/plain", "")
            for output in cell.outputs
        )
        for cell in cells
    ]


def test_it_runs_and_shows_what_it_was_stored_with():
    stored = nbformat.read(NOTEBOOK, as_version=4)
    fresh = nbformat.read(NOTEBOOK, as_version=4)
    client = NotebookClient(
        fresh,
        timeout=_OF_ONE_CELL_S,
        kernel_name="python3",
        resources={"metadata": {"path": str(NOTEBOOK.parent)}},
    )
    client.execute()  # raises at the first error of a cell
    for cell in fresh.cells:
        for output in cell.get("outputs", []):
            assert output.get("name") != "stderr", output.text
    assert [text[:40] for text in _said(fresh)] == [text[:40] for text in _said(stored)]
    shown = _said(fresh)
    assert shown[0].startswith("ok")
    assert "restitution" in shown[0]
    pictures = [
        output
        for cell in fresh.cells
        for output in cell.get("outputs", [])
        if "image/png" in output.get("data", {})
    ]
    assert pictures
