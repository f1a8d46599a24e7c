"""Film with gaps: each contiguous segment is searched alone."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from analysis.drop.checks import MIN_SEEN
from analysis.drop.detection import FilmDetection
from analysis.drop.film_search import MIN_SAMPLES
from analysis.drop.free_fall import Drop
from analysis.tracking.pictures import readable_frames
from tunenet_logs.episode import Episode
from tunenet_logs.errors import NotFoundError, UsageError
from tunenet_logs.gaps import Gap, gaps_in_words, noted_gaps, parts_between

_MAX_PARTS = 20  # of a film that are looked at: a camera that goes so often shows no drop whole
# Fall times before its release, and pictures in them, in which somebody still holds a ball, where
# one that has bounced before is on its way up.
_HELD_FALLS, _MIN_HELD = 0.8, 3


class FilmPart(NamedTuple):
    """Contiguous segment of pictures between two gaps.

    Attributes:
        first_ns: stamp of the first.
        last_ns: stamp of the last.
        begins_in_gap: whether a gap is before it, not the recording's beginning.
        ends_in_gap: the same of its end.
    """

    first_ns: int
    last_ns: int
    begins_in_gap: bool
    ends_in_gap: bool

    def shows_whole(self, drop: Drop) -> bool:
        """Return whether a drop is seen from its release to the top of the first flight.

        A fall whose beginning is in a gap may be that of a later bounce.
        """
        after = (drop.seconds[-1] - drop.impact_s) / drop.fall_time_s
        before = (drop.release_s - drop.seconds) / drop.fall_time_s
        chosen = (before > 0) & (before < _HELD_FALLS)
        below = 1 - drop.heights_m[chosen] / drop.drop_height_m
        rising = before[chosen] ** 2
        is_held = len(rising) >= _MIN_HELD and bool(np.median(below) < np.median(rising) / 2)
        return (is_held or not self.begins_in_gap) and (after > MIN_SEEN or not self.ends_in_gap)


class PartedFilm(NamedTuple):
    """Contiguous segments of a film, and its gaps.

    Attributes:
        start_ns: stamp of the first picture.
        parts: in order, those of enough pictures for a drop.
        gaps: between them.
    """

    start_ns: int
    parts: tuple[FilmPart, ...]
    gaps: tuple[Gap, ...]

    def first_whole_drop(self, detect: Callable[[FilmPart], FilmDetection]) -> FilmDetection:
        """Detect the drop in the first segment that shows a whole one.

        Raises:
            NotFoundError: none does.
            UsageError: a hint that fits no part.
        """
        reasons: list[NotFoundError | UsageError] = []
        cut: list[FilmPart] = []
        for part in self.parts[:_MAX_PARTS]:
            try:
                found = detect(part)
                is_whole = part.shows_whole(found.drop)
            except (NotFoundError, UsageError) as reason:  # a hint may be for another part
                reasons.append(reason)
                continue
            if is_whole:
                return found
            cut.append(part)
        away = f"the camera was away for {gaps_in_words(self.gaps, self.start_ns)}"
        remedy = "drop it again while the camera's connection holds"
        if cut:
            raise NotFoundError(f"{away}, in the middle of a drop", remedy)
        if reasons and all(isinstance(reason, UsageError) for reason in reasons):
            raise reasons[0]
        why = f" (of the first: {reasons[0]})" if reasons else ""
        raise NotFoundError(f"{away}, and no part between shows a whole drop{why}", remedy)

    def warning(self, part: FilmPart) -> str:
        """Return the warning that only this segment is used."""
        first_s, last_s = ((end - self.start_ns) * 1e-9 for end in part[:2])
        return (
            f"the camera was away for {gaps_in_words(self.gaps, self.start_ns)}: the pictures from "
            f"{first_s:.2f} to {last_s:.2f} s are used (others by --start, --end)"
        )


def parted_film(episode: Episode, topic: str) -> PartedFilm | None:
    """Split a topic's film at the gaps that its recorder noted; None where it has none."""
    gaps = noted_gaps(episode.info.notes)
    if not gaps:
        return None
    stamps_ns = np.array([frame.stamp_ns for frame in readable_frames(episode, topic)], np.int64)
    numbers = parts_between(stamps_ns, gaps)
    last = int(numbers.max(initial=0))
    if not last:
        return None
    inside = (stamps_ns[numbers == number] for number in range(last + 1))
    parts = tuple(
        FilmPart(int(part_ns.min()), int(part_ns.max()), number > 0, number < last)
        for number, part_ns in enumerate(inside)
        if len(part_ns) >= MIN_SAMPLES
    )
    return PartedFilm(int(stamps_ns[0]), parts, gaps)
