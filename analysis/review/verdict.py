"""Verdict banner over a review: one coloured strip with large words."""

from __future__ import annotations

import os
from datetime import UTC, datetime

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from analysis.checks import Verdict
from analysis.record import Record, Tuning
from analysis.review.drawing import FAILURE, SUCCESS, Color
from analysis.review.said_names import said_names
from tunenet_logs.terminal import short_name

# Green, amber, red.
VERDICT_COLORS: dict[Verdict, Color] = {
    "ok": SUCCESS,
    "suspect": (245, 185, 60),
    "rejected": FAILURE,
}

VERDICT_SHARE = 0.075  # of a review's height
_INK: Color = (16, 18, 24)

_SIZE_PX = (3600, 90)  # width and height of the strip's picture
_FONT = 2  # OpenCV's number of a plain sans serif with two strokes
_MAX_LETTERS = 90  # what there is room for
_MAX_OF_A_NAME = 60

_FIRST_WALL_NS = 10**17  # stamps from 1973 on are a wall clock's; smaller ones count from a start


def log_verdict(stream: rr.RecordingStream, tuning: Tuning, record: Record) -> rrb.View:
    """Log the strip as static, so that it stays on any timeline, and return its view."""
    import cv2

    color = VERDICT_COLORS[record.verdict]
    width, height = _SIZE_PX
    strip = np.full((height, width, 3), color, np.uint8)
    left = height // 3
    base = round(0.76 * height)
    word = record.verdict.upper()
    cv2.putText(strip, word, (left, base), _FONT, 2.6, _INK, 5, cv2.LINE_AA)
    (wide, _), _ = cv2.getTextSize(word, _FONT, 2.6, 5)
    place = (left + wide + height // 2, base)
    cv2.putText(strip, _beside(record), place, _FONT, 1.8, _INK, 3, cv2.LINE_AA)
    image = rr.Image(strip).compress(jpeg_quality=95)
    stream.log("verdict", image, static=True)
    return rrb.Spatial2DView(
        origin="/verdict",
        name=_title(tuning, record),
        background=color,
        visual_bounds=rrb.VisualBounds2D(x_range=(0, width), y_range=(0, height)),
    )


def _title(tuning: Tuning, record: Record) -> str:
    """Format the log's name, its ball, and when it was recorded."""
    name = short_name(os.fsencode(tuning.log.name).decode(errors="replace"), _MAX_OF_A_NAME)
    parts = [name or "log"]
    if record.ball:
        parts.append(short_name(record.ball, _MAX_OF_A_NAME))
    signals = tuning.episode.signals.values() if tuning.episode else ()
    starts_ns = [int(one.stamps_ns[0]) for one in signals if len(one.stamps_ns)]
    found = tuning.detection or tuning.refused
    film_ns = getattr(found, "start_ns", None)  # of what was filmed alone
    starts_ns += [] if film_ns is None else [film_ns]
    if starts_ns and min(starts_ns) > _FIRST_WALL_NS:
        began = datetime.fromtimestamp(min(starts_ns) // 10**9, UTC)
        parts.append(f"recorded {began:%Y-%m-%d %H:%M} UTC")
    return f"{', '.join(parts)}: {record.verdict}"


def _beside(record: Record) -> str:
    """List estimates and failed checks, as many as fit, in letters that OpenCV draws."""
    failed = [check for check in record.checks if not check.passed]
    failed.sort(key=lambda check: not check.fatal)
    said = said_names(known.name for known in record.estimates)
    parts = [
        ", ".join(
            f"{said[known.name]} {round(known.value, 3) + 0.0:.3f}"
            + ("" if known.unit == "1" else f" {known.unit}")
            for known in record.estimates
            if not isinstance(known.value, tuple)
        )
    ]
    if failed:
        parts.append("failed: " + ", ".join(check.name for check in failed))
    elif record.reason:
        parts.append(record.reason.partition("; at the next")[0])
    words = "   ".join(filter(None, parts)).replace("·", " ").replace("²", "2")
    plain = words.encode("ascii", "replace").decode()
    return plain if len(plain) <= _MAX_LETTERS else plain[: _MAX_LETTERS - 3] + "..."
