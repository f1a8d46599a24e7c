"""Read TrackMate's tracks: its XML exports, and whole sessions."""

from __future__ import annotations

from pathlib import Path

from tunenet_logs.episode import UNSTATED, Episode
from tunenet_logs.errors import LogError
from tunenet_logs.formats.exports.build import export_episode
from tunenet_logs.formats.exports.trackers.bounded_xml import read_elements
from tunenet_logs.formats.exports.trackers.spot_rows import MAX_TRACKS, Tracks, TrackUnits
from tunenet_logs.formats.read_options import ReadOptions
from tunenet_logs.formats.tables.meaning import LENGTHS, POWERS

_MAX_COUNT = 1_000_000  # of spots and of links between them, which come after all spots
_NO_RATE_S = 1.0  # between frames: what ImageJ says where nobody told it
Spot = tuple[float, float, float, float]  # a frame, and x, y, z there


def is_trackmate_xml(data: bytes) -> bool:
    """Return whether a file's first bytes are TrackMate XML of either kind."""
    start = data[:4096]
    return b"<Tracks " in start or b"<TrackMate" in start


def read_trackmate_xml(path: Path, options: ReadOptions) -> Episode:
    """Read each track as a signal.

    Raises:
        LogError: it is no such XML, or holds no track.
        OSError: it cannot be read.
    """
    reading = _XmlReading()
    read_elements(path, "tracks of TrackMate", reading.begin)
    tracks, unused = reading.tracks(path)
    if not len(tracks):
        raise LogError(f"{path}: tracks of TrackMate: it holds none; track first, then export")
    units, doubts = reading.units()
    signals, more, notes = tracks.signals(units, options)
    warnings = [*doubts, *notes]
    return export_episode(
        path, "TrackMate tracks", signals, unused={**unused, **more}, warnings=warnings
    )


class _XmlReading:
    """Collector of spots, tracks and links, element by element."""

    def __init__(self) -> None:
        self._said: dict[str, str] = {}
        self._places: dict[str, list[Spot]] = {}
        self._spots: dict[str, Spot] = {}
        self._links: dict[str, dict[str, None]] = {}
        self._track = ""
        self._kept: set[str] = set()
        self._count = 0

    def begin(self, name: str, attributes: dict[str, str]) -> None:
        """Collect one element; raise ValueError if it is invalid or one too many."""
        if name in ("Tracks", "Model", "ImageData"):
            self._said.update((key.lower(), text.strip()) for key, text in attributes.items())
        elif name == "particle":
            self._track = f"track{len(self._places) + 1}"
            self._places[self._track] = []
        elif name == "Track":
            self._track = f"track{attributes.get('TRACK_ID', str(len(self._links)))[:40]}"
            self._links[self._track] = {}
        elif name == "detection":
            self._places.setdefault(self._track or "track1", []).append(_spot(attributes))
            self._counted()
        elif name == "Spot" and "ID" in attributes:
            small = {key.removeprefix("POSITION_"): text for key, text in attributes.items()}
            self._spots[attributes["ID"]] = _spot({**small, "T": attributes.get("FRAME", "")})
            self._counted()
        elif name == "Edge" and self._track in self._links:
            for key in ("SPOT_SOURCE_ID", "SPOT_TARGET_ID"):
                self._links[self._track][attributes.get(key, "")] = None
            self._counted()
        elif name == "TrackID":
            self._kept.add(f"track{attributes.get('TRACK_ID', '')[:40]}")

    def _counted(self) -> None:
        self._count += 1
        if self._count > _MAX_COUNT:
            raise ValueError(f"it holds over {_MAX_COUNT} spots and links; filter them first")

    def tracks(self, path: Path) -> tuple[Tracks, dict[str, str]]:
        """Return the tracks, and why others are not used."""
        unused: dict[str, str] = {}
        places = dict(self._places)
        for name, links in self._links.items():
            spots = [self._spots[one] for one in links if one in self._spots]
            if self._kept and name not in self._kept:
                unused[name] = "it was filtered out in TrackMate"
            elif len({spot[0] for spot in spots}) < len(spots):
                unused[name] = "it splits or merges: several things are in one frame"
            else:
                places[name] = sorted(spots)
        if rest := len(self._spots) - len({one for of in self._links.values() for one in of}):
            unused["places of no track"] = f"{rest} places were not linked"
        tracks = Tracks(path)
        for name, spots in places.items():
            for frame, x, y, z in spots:
                tracks.add(name, frame, (x, y, z))
        return tracks, dict(list(unused.items())[-MAX_TRACKS:])

    def units(self) -> tuple[TrackUnits, list[str]]:
        """Return the units that the file states, and doubts about them."""
        length = self._first("spaceunits", "spatialunits", "spaceunit").lower()
        length = length.replace("µ", "u").replace("μ", "u").replace("micron", "um")
        length = "px" if length.startswith(("pixel", "px")) else length
        length = length if length in LENGTHS or length == "px" else UNSTATED
        try:
            power = POWERS[self._first("timeunits", "timeunit").lower()]
            interval_s = float(self._first("frameinterval", "timeinterval")) * 10.0**power
        except (KeyError, ValueError):
            interval_s = 0.0
        is_told = 0 < interval_s < float("inf") and interval_s != _NO_RATE_S
        doubts = ["it says a frame a second, as ImageJ does where nobody told it; not used"]
        return (
            TrackUnits(length, None, 1 / interval_s if is_told else None),
            doubts if interval_s == _NO_RATE_S else [],
        )

    def _first(self, *keys: str) -> str:
        return next((self._said[key] for key in keys if key in self._said), "")


def _spot(attributes: dict[str, str]) -> Spot:
    """Parse a spot; raise ValueError where a number is missing."""
    small = {key.lower(): text for key, text in attributes.items()}
    try:
        return (
            float(small["t"]),
            float(small["x"]),
            float(small["y"]),
            float(small.get("z", "0")),
        )
    except (KeyError, ValueError):
        raise ValueError("a place has no t, x or y that is a number") from None
