"""Group the coordinates of a table into tracks of objects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from tunenet_logs.formats.tables.group import Group, Used, plain_words, stamp_for
from tunenet_logs.formats.tables.meaning import CoordinateColumn, Meaning, UnusedColumn
from tunenet_logs.formats.tables.times import Clock

# What the one coordinate of a motion sensor is.
_ALONG_A_LINE = "a distance along one line, up or down"

_DISTANCE = 3  # rank of a bare distance: beside x and y it is that from the start, and no z
# Why a coordinate is not used where there is one of a better name.
_INSTEAD = ("there is a column z", "there is a column of heights", "there is a column of positions")


@dataclass(frozen=True)
class _Coordinate:
    """A column that is a coordinate."""

    at: int
    meaning: CoordinateColumn


def tracks_of(
    header: Sequence[str],
    meanings: Mapping[int, Meaning],
    clock: Clock,
    stamps: Sequence[Clock],
    unused: dict[str, str],
) -> list[Group]:
    """Group coordinate columns by moving object.

    Args:
        header: the names of all columns.
        meanings: of columns, by index.
        clock: of the rows.
        stamps: of messages.
        unused: reasons by name; to be added to.
    """
    things: dict[str, list[_Coordinate]] = {}
    for at, meaning in _with_pictures(header, meanings).items():
        if isinstance(meaning, CoordinateColumn):
            unused.pop(header[at], None)
            things.setdefault(meaning.thing, []).append(_Coordinate(at, meaning))
    groups: list[Group] = []
    for thing, places in things.items():
        if _is_doubtful(places):
            for place in places:
                unused[header[place.at]] = f"it is the one column of {thing!r}; name it {thing}_x"
            continue
        axes = _axes(header, _in_lengths(header, places, unused), unused)
        chosen = [place for found in axes.values() for place in found]
        if any(len(found) > 1 for found in axes.values()):
            for place in chosen:
                unused[header[place.at]] = f"several columns are a coordinate of {thing!r}"
            continue
        unit, default = _unit_of(chosen)
        used = tuple(
            Used(place.at, axis, place.meaning.scale if place.meaning.unit else default)
            for axis, (place,) in axes.items()
        )
        stamp = stamp_for(plain_words(header[chosen[0].at]), stamps)
        note = _ALONG_A_LINE if any(place.meaning.rank > 1 for place in chosen) else ""
        groups.append(Group(thing, ("x", "y", "z"), unit, used, True, clock, stamp, note=note))
    return groups


def _is_doubtful(places: Sequence[_Coordinate]) -> bool:
    """Return whether columns are hardly an object's: an axis named first, without another."""
    axes = {place.meaning.axis for place in places}
    return len(axes) < 2 and all(place.meaning.is_doubtful for place in places)


def _with_pictures(header: Sequence[str], meanings: Mapping[int, Meaning]) -> dict[int, Meaning]:
    """Interpret pairs (u, v) as image coordinates x and y; u alone is a control input."""
    names = {plain_words(header[at]): at for at in meanings}
    found = dict(meanings)
    for words, at in names.items():
        partner = names.get((*words[:-1], "v")) if words[-1:] == ("u",) else None
        is_free = partner is not None and all(
            isinstance(meanings[one], UnusedColumn) for one in (at, partner)
        )
        if partner is not None and is_free:
            thing = "_".join(words[:-1]) or "track"
            found[at] = CoordinateColumn(thing, 0, 1.0, "px")
            found[partner] = CoordinateColumn(thing, 1, 1.0, "px")
    return found


def _in_lengths(
    header: Sequence[str], places: list[_Coordinate], unused: dict[str, str]
) -> list[_Coordinate]:
    """Drop columns in pixels where others are in lengths."""
    lengths = [place for place in places if place.meaning.unit != "px"]
    if not lengths:
        return places
    for place in places:
        if place.meaning.unit == "px":
            unused[header[place.at]] = "there are columns in a unit of length"
    return lengths


def _axes(
    header: Sequence[str], places: list[_Coordinate], unused: dict[str, str]
) -> dict[int, list[_Coordinate]]:
    """Return the columns of each axis, of the best kind of name."""
    axes: dict[int, list[_Coordinate]] = {}
    has_axes = {0, 1}.issubset(place.meaning.axis for place in places)
    for place in places:
        if has_axes and place.meaning.rank == _DISTANCE:
            unused[header[place.at]] = "there are columns x and y"
        else:
            axes.setdefault(place.meaning.axis, []).append(place)
    for axis, found in axes.items():
        best = min(place.meaning.rank for place in found)
        axes[axis] = [place for place in found if place.meaning.rank == best]
        for place in found:
            if place.meaning.rank > best:
                unused[header[place.at]] = _INSTEAD[best]
    return axes


def _unit_of(chosen: Sequence[_Coordinate]) -> tuple[str, float]:
    """Return a track's unit, and the scale of columns without a unit beside others with one."""
    sizes = {place.meaning.scale for place in chosen if place.meaning.unit == "m"}
    if sizes:
        return "m", sizes.pop() if len(sizes) == 1 else 1.0
    return chosen[0].meaning.unit, 1.0
