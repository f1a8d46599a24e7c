"""Images of the drop under the cursor; a blank one for an attempt without."""

from __future__ import annotations

from collections.abc import Sequence

import rerun as rr
import rerun.blueprint as rrb

from analysis.review.campaign.times import ATTEMPT, WALL, Begun, Slot, beginnings, moments
from analysis.review.drawing import GROUND
from analysis.review.pictures import blank_picture

_ENTITY = "film/picture"


def film_view() -> rrb.View:
    """Return the view of the drop's images."""
    title = "its video (timeline film_s plays it)"
    return rrb.Spatial2DView(origin="/film", name=title, background=GROUND)


def log_films(stream: rr.RecordingStream, slots: Sequence[Slot]) -> None:
    """Log the entities of `film_view`.

    An attempt without images has a blank one: after an empty row, as after a `Clear`, Rerun 0.41
    goes on showing the last image wherever its chunk has more timelines than the row.
    """
    films = [shown.drop.film for slot in slots for shown in slot.drops if shown.drop.film]
    if not films:
        return
    blank = blank_picture(films[0].size_px, "no video")
    stream.log(_ENTITY, rr.EncodedImage.from_fields(media_type="image/jpeg"), static=True)
    for name, index, begun in beginnings(slots):
        columns = rr.EncodedImage.columns(blob=[_first(name, one, blank) for one in begun])
        stream.send_columns(_ENTITY, indexes=[index], columns=columns)
    for slot in slots:
        for shown in slot.drops:
            film = shown.drop.film
            if film is not None:
                indexes = moments(slot, shown, film.seconds)
                columns = rr.EncodedImage.columns(blob=list(film.pictures))
                stream.send_columns(_ENTITY, indexes=indexes, columns=columns)


def _first(timeline: str, begun: Begun, blank: bytes) -> bytes:
    """Return a drop's first image on timelines that play it, else its strobe image."""
    slot, shown = begun
    if shown is None or shown.drop.film is None:
        return blank
    does_play = timeline != ATTEMPT and (timeline != WALL or slot.is_on_wall(shown))
    return shown.drop.film.pictures[0] if does_play else shown.drop.film.strobe
