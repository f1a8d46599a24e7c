"""Export the results of `tunenet-eval video`: one record a line of its tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, fields
from typing import Any

from analysis.evaluation.clips.run import ClipResult, TransformedClip
from analysis.evaluation.export import csv_text, json_text
from analysis.evaluation.video.run import VideoFigures, VideoOrder, VideoRow

COLUMNS = ("section", "tracks", *(field.name for field in fields(VideoFigures)))  # of the CSV


def video_records(rows: Sequence[VideoRow]) -> list[dict[str, Any]]:
    """Return one record for each line; see `COLUMNS`."""
    return [{"section": row.section, "tracks": row.label, **asdict(row.figures)} for row in rows]


def video_json(
    rows: Sequence[VideoRow],
    order: VideoOrder,
    clips: Sequence[ClipResult] = (),
    transformed: Sequence[TransformedClip] = (),
) -> str:
    """Serialise every figure, and the result of each clip; null where there is none."""
    head = {"experiment": "video", "seeds": list(order.seeds), "targets": order.targets}
    tables = {
        "rows": video_records(rows),
        "clips": [asdict(clip) for clip in clips],
        "transformed": [{**asdict(clip), "spread": clip.spread} for clip in transformed],
    }
    return json_text({**head, **tables})


def video_csv(rows: Sequence[VideoRow]) -> str:
    """Format `video_records` as a table; an empty field where there is no figure."""
    return csv_text(COLUMNS, video_records(rows))
