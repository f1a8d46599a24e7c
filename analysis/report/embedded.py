"""Render figures to bytes for a self-contained page, and to files for a paper."""

from __future__ import annotations

import base64
import io
from pathlib import Path
from typing import Literal

from matplotlib.figure import Figure

from analysis.report.style import Drawing, styled

Kind = Literal["png", "pdf"]

_PAGE_DPI = 200  # of pictures in a page: sharp on a phone's screen
_PAPER_DPI = 300  # of a PNG, and of what is no line in a PDF
_QUALITY = 82  # of a JPEG, 0 to 100


class DataUri(str):
    """Data URI of an image: our own text, of any length."""

    __slots__ = ()


@styled
def embedded(drawing: Drawing) -> DataUri:
    """Render a figure for a page: lines as SVG, images as JPEG."""
    file = io.BytesIO()
    if drawing.is_photo:
        drawing.figure.savefig(
            file, format="jpg", dpi=_PAGE_DPI, pil_kwargs={"quality": _QUALITY, "optimize": True}
        )
        kind = "jpeg"
    else:
        drawing.figure.savefig(file, format="svg", metadata={"Date": None, "Creator": None})
        kind = "svg+xml"
    text = base64.b64encode(file.getvalue()).decode("ascii")
    return DataUri(f"data:image/{kind};base64,{text}")


@styled
def write_figure(figure: Figure, path: Path, kind: Kind, made: str) -> None:
    """Write a figure for a paper, with the mark `made` by which it is known as ours.

    Raises:
        OSError: It cannot be written.
    """
    metadata = {"Software": made} if kind == "png" else {"Creator": made}
    if kind == "pdf":
        metadata["CreationDate"] = None  # pyright: ignore[reportArgumentType] (leaves it out)
    figure.savefig(path, format=kind, dpi=_PAPER_DPI, metadata=metadata)
