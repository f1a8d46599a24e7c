"""A review as it is stored: the views of its blueprint, and what each shows at a time.

What is asked of a recording is Rerun's latest-at query: of each component the last row up to the
time, a static one before all others; a row may hold nothing, which clears what was before.
"""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rerun.chunk import RrdReader

from tests.conftest import BIN
from tunenet_logs.analysis.experiment import Tuning, record_of
from tunenet_logs.analysis.review.tuning import write_review

# Of one component: Arrow's list of instances for each row, null where the row does not touch it;
# read only where it is asked for, as pictures are large.
Cells = list[Any]

# Components by which each class of views draws something; of a table any will do.
_DRAWN = {
    "2D": ("blob", "buffer", "positions", "strips", "half_sizes", "vectors"),
    "3D": ("positions", "strips", "vertex_positions", "centers", "half_sizes", "vectors"),
    "TextDocument": ("text",),
    "TextLog": ("text",),
    "BarChart": ("values",),
    "StateTimeline": ("state",),
    "TimeSeries": ("scalars",),
    "Dataframe": (),
}

# The last parts of entities that hold a chart's axes: without anything else it is empty.
_FRAME = ("grid", "labels")
_TIMELINE = re.compile(r"\(timeline (\w+)")  # in the name of a tab: what it is for


@dataclass
class Component:
    """One component of one entity."""

    static: Cells = field(default_factory=list)  # its rows without a time
    # (times, rows) on each timeline, by its name; times rise
    timed: dict[str, tuple[NDArray[np.int64], Cells]] = field(default_factory=dict)

    def at(self, timeline: str, time: int) -> list[Any]:
        """Its instances then; none where it was never set, or cleared."""
        told = [cell for cell in self.static if cell.is_valid]
        if told:
            return told[-1].as_py()
        times, cells = self.timed.get(timeline, (np.zeros(0, np.int64), []))
        for index in range(int(np.searchsorted(times, time, side="right")) - 1, -1, -1):
            if cells[index].is_valid:
                return cells[index].as_py()
        return []


@dataclass(frozen=True)
class View:
    """One view of a blueprint."""

    kind: str  # its class, "2D", "TimeSeries", ...
    name: str  # its title
    tabs: tuple[str, ...]  # names of the containers that it is in, outermost first
    entities: tuple[str, ...]  # whose data it shows
    shown: tuple[int, int] | None = None  # first and last time that a plot shows; None for all
    span: tuple[float, float] | None = None  # low and high that a plot shows; None for all


class Stored:
    """A review's data and views."""

    def __init__(self, path: Path) -> None:
        reader = RrdReader(path)
        self.entities: dict[str, dict[str, Component]] = {}
        for chunk in reader.stream():
            self._add(chunk)
        (blueprint,) = reader.blueprints()
        self._settings: dict[str, dict[str, Any]] = {}
        for chunk in reader.stream(store=blueprint):
            columns = chunk.to_record_batch().to_pydict()
            own = self._settings.setdefault(str(chunk.entity_path), {})
            own |= {name.split(":")[-1]: cells[-1] for name, cells in columns.items()}
        self._places: list[str] = []  # of views, as often as a container has them
        self.views = tuple(self._views())
        # Those of several containers: Rerun fills them in one alone.
        self.shown_twice = [one for one in self._places if self._places.count(one) > 1]

    def _add(self, chunk: Any) -> None:
        batch = chunk.to_record_batch()
        entity = self.entities.setdefault(str(chunk.entity_path), {})
        columns = dict(zip(batch.schema.names, batch.columns, strict=True))
        assert len(columns) == len(batch.schema.names)  # a query by name would be ambiguous
        timelines = {name: np.asarray(columns[name].cast("int64")) for name in chunk.timeline_names}
        for name, column in columns.items():
            if name in timelines or name.startswith("rerun.controls"):
                continue
            component = entity.setdefault(name, Component())
            cells = list(column)
            if chunk.is_static:
                component.static += cells
            for timeline, times in timelines.items():
                before, had = component.timed.get(timeline, (np.zeros(0, np.int64), []))
                every, both = np.append(before, times), [*had, *cells]
                order = np.argsort(every, kind="stable")
                component.timed[timeline] = every[order], [both[index] for index in order]

    @property
    def timelines(self) -> dict[str, NDArray[np.int64]]:
        """The times of each timeline at which anything is new."""
        found: dict[str, list[NDArray[np.int64]]] = {}
        for entity in self.entities.values():
            for component in entity.values():
                for timeline, (times, _) in component.timed.items():
                    found.setdefault(timeline, []).append(times)
        return {name: np.unique(np.concatenate(times)) for name, times in found.items()}

    def series(
        self, entity: str, component: str = "Scalars:scalars"
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Times [s] of an entity on the log's time, and the values of one component."""
        times_ns, cells = self.entities[entity][component].timed["log_time_s"]
        return times_ns.astype(np.float64) * 1e-9, np.array([cell.as_py() for cell in cells], float)

    def stops(self, view: View) -> Iterator[tuple[str, int]]:
        """First, middle and last time of each timeline that a view's tab is for."""
        named = {name for tab in view.tabs for name in _TIMELINE.findall(tab)}
        for timeline, times in self.timelines.items():
            if not named or timeline in named:
                for time in sorted({int(times[at]) for at in (0, len(times) // 2, -1)}):
                    yield timeline, time

    def has_data(self, view: View, timeline: str, time: int) -> bool:
        """Whether a view shows anything but a frame then; a picture, if it ever shows one."""
        drawn = [
            (name.split(":")[-1], component)
            for entity in view.entities
            if entity.split("/")[-1] not in _FRAME or view.kind == "3D"
            for name, component in self.entities[entity].items()
            if not _DRAWN[view.kind] or name.split(":")[-1] in _DRAWN[view.kind]
        ]
        pictures = [one for one in drawn if one[0] == "blob"]
        return any(
            self._draws(view, component, timeline, time) for _, component in pictures or drawn
        )

    def _draws(self, view: View, component: Component, timeline: str, time: int) -> bool:
        if view.kind not in ("TimeSeries", "StateTimeline", "Dataframe"):
            return bool(component.at(timeline, time))
        times, cells = component.timed.get(timeline, (np.zeros(0, np.int64), []))
        first, last = view.shown or (times.min(initial=0), times.max(initial=0))
        low, high = view.span or (-np.inf, np.inf)
        for at, cell in zip(times.tolist(), cells, strict=True):
            if first <= at <= last and cell.is_valid and len(cell):
                if view.kind != "TimeSeries":
                    return True
                if any(np.isfinite(value) and low <= value <= high for value in cell.as_py()):
                    return True
        return False

    def _views(self) -> Iterator[View]:
        (root,) = self._settings["/viewport"]["root_container"]
        yield from self._inside(f"container/{_uuid(root)}", ())

    def _inside(self, place: str, tabs: tuple[str, ...]) -> Iterator[View]:
        own = self._settings[f"/{place}"]
        name = (own.get("display_name") or [""])[0]
        if place.startswith("view/"):
            self._places.append(place)
            (kind,) = own["class_identifier"]
            yield View(kind, name, tabs, self._contents(place, own), *self._ranges(place))
            return
        for inner in own.get("contents") or ():
            yield from self._inside(inner, (*tabs, name))

    def _contents(self, place: str, own: dict[str, Any]) -> tuple[str, ...]:
        origin = "/" + (own.get("space_origin") or ["/"])[0].strip("/")
        query = self._settings.get(f"/{place}/ViewContents", {}).get("query") or ["$origin/**"]
        found: set[str] = set()
        for line in "\n".join(query).splitlines():
            rule = line.strip().replace("$origin", origin.rstrip("/"))
            sign, pattern = (rule[0], rule[1:].strip()) if rule[0] in "+-" else ("+", rule)
            stem = pattern.removesuffix("/**")
            named = {
                entity
                for entity in self.entities
                if entity == stem or (stem != pattern and entity.startswith(f"{stem}/"))
            }
            found = found | named if sign == "+" else found - named
        return tuple(sorted(found))

    def _ranges(self, place: str) -> tuple[tuple[int, int] | None, tuple[float, float] | None]:
        """Of a plot's axes, where the blueprint sets them."""
        span = shown = None
        for said in self._settings.get(f"/{place}/ScalarAxis", {}).get("range") or ():
            span = tuple(said)
        for said in self._settings.get(f"/{place}/TimeAxis", {}).get("view_range") or ():
            shown = int(said["start"]), int(said["end"])
        return shown, span  # pyright: ignore[reportReturnType]


def empty_views(path: Path) -> list[str]:
    """Views that show nothing, with where that is."""
    review = Stored(path)
    return [
        f"{view.name!r} at {timeline} {time}"
        for view in review.views
        for timeline, time in review.stops(view) or [("", 0)]
        if not review.has_data(view, timeline, time)
    ]


def review_of(tuning: Tuning, folder: Path, verdict: str | None = None) -> Path:
    assert verdict in (None, tuning.verdict), tuning.reason
    write_review(tuning, record_of(tuning), folder / "a.rrd")
    return folder / "a.rrd"


def reviewed(tuning: Tuning, folder: Path) -> Stored:
    """A review that Rerun itself finds whole, and in which no view is empty."""
    path = review_of(tuning, folder)
    verified(path)
    assert empty_views(path) == []
    return Stored(path)


def _uuid(numbers: list[int]) -> str:
    text = bytes(numbers).hex()
    return "-".join((text[:8], text[8:12], text[12:16], text[16:20], text[20:]))


def verified(path: Path) -> None:
    words = [BIN / "rerun", "rrd", "verify", path]
    result = subprocess.run(words, capture_output=True, text=True, timeout=60)
    assert result.returncode == 0, result.stderr
