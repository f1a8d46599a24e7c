"""Recognize headerless tables by their rows: trajectories, echoed messages."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import takewhile
from math import isfinite
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.errors import LogError
from tunenet_logs.formats.tables.lines import cells_of
from tunenet_logs.terminal import short_name

LOOK_ROWS = 50  # looked at: what all of them keep is no accident
_MIN_ROWS = 3

# By which a quaternion's length, or a rotation, may differ from 1: files round to few digits.
_OFF = 0.02

_TURN = tuple(f"orientation.{axis}" for axis in "xyzw")
_POSE = ("x", "y", "z", *_TURN)
_ROS_POSE = ("x (m)", "y (m)", "z (m)", *_TURN)
_COVARIANCE = tuple(f"covariance{at}" for at in range(36))
_STAMP = ("header.stamp.sec", "header.stamp.nanosec")
_TWIST = tuple(f"twist{at}" for at in range(6 + 36))
_MATRIX = ("r11", "r12", "r13", "x", "r21", "r22", "r23", "y", "r31", "r32", "r33", "z")

_SEPARATORS = (",", "\t", ";", None)

_SECOND_NS = 10**9
_MAX_COUNTED = 1000  # in a second column that counts something else


@dataclass(frozen=True)
class KnownRows:
    """Recognized format of headerless rows.

    Attributes:
        what: in words.
        separator: of cells; None is white space.
        names: of the columns.
        has_clock: whether rows have times; else a row is a frame.
        remedy: what the user has to state, where the rows are ambiguous; "" where they are not.
        texts: text columns, which are equal in every row.
    """

    what: str
    separator: str | None
    names: tuple[str, ...]
    has_clock: bool = True
    remedy: str = ""
    texts: tuple[int, ...] = ()

    @property
    def refusal(self) -> str:
        """Why the rows are not read without the user's options, and which these are."""
        return f"is {self.what}; {self.remedy}"

    def of_one(
        self, path: Path, rows: Iterable[tuple[int, str | None]]
    ) -> Iterator[tuple[int, str | None]]:
        """Yield the rows, which all have to name the same object.

        Raises:
            LogError: one names another: rows of several objects in one column are no track.
        """
        first: list[str] = []
        for number, line in rows:
            cells = cells_of(line, self.separator) if line is not None else []
            texts = [cells[at].strip() for at in self.texts if len(cells) == len(self.names)]
            first = first or texts
            if texts and texts != first:
                one, other = next(
                    both for both in zip(first, texts, strict=True) if len(set(both)) > 1
                )
                raise LogError(
                    f"{path}: line {number} is of {short_name(other)!r}, those before it of "
                    f"{short_name(one)!r}",
                    f"keep one of them, for example: grep ,{one or ','}, {path.name} > one.csv",
                )
            yield number, line


def known_rows(lines: Sequence[str]) -> KnownRows | None:
    """Recognize headerless rows by their numbers; None where these are inconclusive."""
    for separator in _SEPARATORS:
        rows = [cells_of(line, separator) for line in lines]
        widths = {len(row) for row in rows}
        if len(rows) >= _MIN_ROWS and len(widths) == 1 and min(widths) > 1:
            stripped = [[cell.strip() for cell in row] for row in rows]
            numbers = np.array([[_number(cell) for cell in row] for row in stripped])
            return _echoed(separator, stripped, numbers) or _trajectory(separator, numbers)
    return None


def _trajectory(separator: str | None, numbers: NDArray[np.float64]) -> KnownRows | None:
    """Recognize TUM (time, position, quaternion) and KITTI (3 x 4 matrix) trajectories."""
    if not np.isfinite(numbers).all():
        return None
    width = numbers.shape[1]
    increases = bool((np.diff(numbers[:, 0]) > 0).all())
    if width == 8 and increases and _is_turn(numbers[:, 4:]):
        return KnownRows("a TUM trajectory", separator, ("t", *_POSE))
    if width == 7 and _is_turn(numbers[:, 3:]):
        remedy = "--columns x=1,y=2,z=3 --fps RATE, or write them with their times"
        return KnownRows("a list of poses without times", separator, _POSE, False, remedy)
    if width in (12, 13) and _is_rotation(numbers[:, -12:]):
        if width == 13 and not increases:
            return None
        names = _MATRIX if width == 12 else ("t", *_MATRIX)
        return KnownRows("a KITTI trajectory", separator, names, width == 13)
    return None


def _echoed(
    separator: str | None, rows: Sequence[Sequence[str]], numbers: NDArray[np.float64]
) -> KnownRows | None:
    """Recognize stamped messages of `ros2 topic echo --csv`: field by field, no names."""
    if separator != "," or numbers.shape[1] < 4 or not _are_stamps(numbers[:, :2]):
        return None
    columns = list(zip(*rows, strict=True))[2:]
    count = sum(1 for _ in takewhile(lambda cells: all(map(_is_text, cells)), columns))
    values = numbers[:, 2 + count :]
    if not count or any(_is_text(cell) for cells in columns[count:] for cell in cells):
        return None
    what = "`ros2 topic echo --csv` of "
    width = values.shape[1]
    is_pose = width >= 7 and _is_turn(values[:, 3:7])
    if is_pose and count == 1 and width in (7, 7 + 36):
        kind = "PoseStamped" if width == 7 else "PoseWithCovarianceStamped"
        names = (*_STAMP, "frame_id", *_ROS_POSE, *_COVARIANCE[: width - 7])
        return KnownRows(what + kind, separator, names, texts=(2,))
    if is_pose and count == 2 and width in (7, 7 + 36 + 42):
        kind = "TransformStamped" if width == 7 else "Odometry"
        more = (*_COVARIANCE, *_TWIST) if width > 7 else ()
        names = (*_STAMP, "frame_id", "child_frame_id", *_ROS_POSE, *more)
        return KnownRows(what + kind, separator, names, texts=(2, 3))
    texts = tuple(range(2, 2 + count))
    joints = rows[0][3 : 2 + count]
    if joints and width == 3 * len(joints) and len(set(joints)) == len(joints) and all(joints):
        names = (
            *(*_STAMP, "frame_id", *(f"name of joint {at}" for at in range(1, count))),
            *(f"/joint_states/{joint}/position" for joint in joints),
            *(f"/joint_states/{joint}/velocity" for joint in joints),
            *(f"/joint_states/{joint}/effort" for joint in joints),
        )
        return KnownRows(what + "JointState", separator, names, texts=texts)
    places = zip("xyz"[: width if width < 4 else 3], range(3 + count, 6 + count), strict=False)
    said = ",".join(f"{axis}={at}" for axis, at in places) if width != 1 else f"z={3 + count}"
    remedy = f"where the numbers in columns {said} are a place, say so with --columns {said}"
    names = (*_STAMP, *(f"text {at + 1}" for at in texts), *_numbered(2 + count, width))
    return KnownRows(what + "a type that its rows do not tell", separator, names, True, remedy)


def _numbered(first: int, count: int) -> tuple[str, ...]:
    return tuple(f"column {at + 1}" for at in range(first, first + count))


def _are_stamps(values: NDArray[np.float64]) -> bool:
    """Return whether columns are integer seconds, and nanoseconds that are no mere counts."""
    if not np.isfinite(values).all() or (values != np.floor(values)).any():
        return False
    rest = values[:, 1]
    in_range = (values >= 0).all() and (rest < _SECOND_NS).all()
    return bool(in_range and (rest > _MAX_COUNTED).any())


def _is_turn(values: NDArray[np.float64]) -> bool:
    return bool((np.abs(np.linalg.norm(values, axis=1) - 1) < _OFF).all())


def _is_rotation(values: NDArray[np.float64]) -> bool:
    turns = values.reshape(-1, 3, 4)[:, :, :3]
    products = turns @ turns.transpose(0, 2, 1)
    return bool((np.abs(products - np.eye(3)) < _OFF).all() and (np.linalg.det(turns) > 0).all())


def _is_text(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return True
    return False


def _number(cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        return float("nan")
    return value if isfinite(value) else float("nan")
