"""Move an arm along joint paths: the paper's circle, random smooth ones, the user's.

With the files that hold such paths, forward kinematics, and the easing of a path from rest to rest.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tunenet_logs.episode import Array
from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.files import csv_line, open_regular_text, text_of
from tunenet_logs.recorders.simulators.arm.description import Arm, Transform
from tunenet_logs.terminal import short_name
from tunenet_logs.writing.owned_path import OutputPlace, begins_with

# ---- Path files: a table of time_s, then a column of radians per joint

# An hour at 50 Hz, more joints and turns than an arm has: beyond it, a file is no path.
_MAX_ROWS, _MAX_COLUMNS, _MAX_RAD, _MAX_S = 200_000, 100, 1000.0, 3600.0


def read_path_file(file: Path) -> tuple[tuple[str, ...], Array, Array]:
    """Read joint names (J), times [s], shape (T,), and positions [rad], shape (T, J)."""
    try:
        with open_regular_text(file, "utf-8-sig", newline="") as stream:
            # A file without line ends must not fill the memory.
            lines = iter(lambda: stream.readline(10_000), "")
            return _read(file, csv.reader(lines))
    except OSError as error:
        raise UsageError(f"{file}: {error.strerror}; a path is a CSV with time_s first") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise UsageError(f"{file}: is no CSV in UTF-8 ({error})") from error


def _read(file: Path, lines: Iterable[list[str]]) -> tuple[tuple[str, ...], Array, Array]:
    rows: list[list[float]] = []
    header: list[str] = []
    for number, cells in enumerate(lines, start=1):
        if not any(cell.strip() for cell in cells):
            continue
        if not header:
            header = [text_of(cell.strip()) for cell in cells]
            if header[0] != "time_s" or not 2 <= len(header) <= _MAX_COLUMNS:
                raise UsageError(
                    f"{file}: begins with {short_name(','.join(header))}; a path begins with "
                    "time_s and the joints' names"
                )
            if len(set(header)) < len(header):
                raise UsageError(f"{file}: two columns have one name")
            continue
        line = f"{file}: line {number}"
        if len(cells) != len(header):
            raise UsageError(f"{line}: {len(cells)} values under {len(header)} columns")
        values: list[float] = []
        for cell, name in zip(cells, header, strict=True):
            try:
                value = float(cell)
            except ValueError:
                value = math.nan
            most, unit = (_MAX_S, "s") if name == "time_s" else (_MAX_RAD, "rad")
            if not abs(value) <= most:
                raise UsageError(
                    f"{line}: {short_name(name)} is {short_name(cell)!r}, not a number within "
                    f"{most:g} {unit}"
                )
            values.append(value)
        rows.append(values)
        if len(rows) > _MAX_ROWS:
            raise UsageError(f"{file}: over {_MAX_ROWS} rows; give fewer samples a second")
        if len(rows) > 1 and rows[-1][0] <= rows[-2][0]:
            raise UsageError(f"{line}: time_s does not increase")
    if len(rows) < 2:
        raise UsageError(f"{file}: holds {len(rows)} rows of numbers; a path has two or more")
    table = np.array(rows)
    return tuple(header[1:]), table[:, 0], table[:, 1:]


def write_path_file(
    file: Path, names: Iterable[str], seconds: Array, position_rad: Array, *, overwrite: bool
) -> None:
    """Write a path; the counterpart of `read_path_file`."""
    # Replaces only a path of the same joints, and only with `overwrite`.
    rows = [csv_line(["time_s", *names])]
    begins = begins_with(rows[0].encode())
    for time_s, angles in zip(seconds.tolist(), position_rad.tolist(), strict=True):
        rows.append(csv_line([f"{time_s:.6f}", *(f"{angle:.12f}" for angle in angles)]))
    place = OutputPlace(file, "path of these joints", begins, elsewhere="choose another name")
    why = place.why_not()
    if why is None and file.exists() and not overwrite:
        why = f"{file}: exists; choose another name, or give --overwrite"
    if why:
        raise LogError(why)
    try:
        with place.replacing() as partial:
            partial.write_text("".join(rows), "utf-8")
    except OSError as error:
        raise LogError(f"{file}: cannot be written ({error.strerror})") from error


# ---- Joint paths, and the poses of the links on them

CIRCLE_CSV = Path(__file__).with_name("circle.csv")
# The paper's: (-0.4, 0.2 cos(1.2 t), 0.2 sin(1.2 t)) m, here 0.3 m over the arm's base.
CIRCLE_RAD_S = 1.2

_FREE_RAD = math.pi  # a joint without limits stays within one turn, as cables allow
_MAX_TRIES = 2000  # draws after which an arm is said to leave no room; they take some seconds


@dataclass(frozen=True, eq=False)
class JointPath:
    """A sampled joint path; its arrays are read-only."""

    seconds: Array  # increasing, shape (T,)
    position_rad: Array  # shape (T, J), as all that follow; m, m/s and m/s² of a prismatic joint
    velocity_rad_s: Array  # its derivative
    acceleration_rad_s2: Array  # its second derivative

    def __post_init__(self) -> None:
        shape = np.shape(self.position_rad)
        for item in fields(self):
            values = np.array(getattr(self, item.name), np.float64)
            wanted = shape[:1] if item.name == "seconds" else shape
            if values.shape != wanted or len(shape) != 2 or not np.isfinite(values).all():
                raise UsageError(
                    f"a path's {item.name} has the shape {values.shape} or is not finite; "
                    f"wanted is {wanted}"
                )
            values.flags.writeable = False
            object.__setattr__(self, item.name, values)
        if np.any(np.diff(self.seconds) <= 0):
            raise UsageError("a path's times do not increase")

    def part(self, kept: slice) -> JointPath:
        """Slice the samples."""
        return JointPath(*(getattr(self, item.name)[kept] for item in fields(self)))

    def checked(self, arm: Arm) -> JointPath:
        """Return the path if it fits the arm's joints and their limits."""
        count = self.position_rad.shape[1]
        if count != len(arm.joints):
            raise UsageError(f"a path of {count} joints is none of {arm.name}: {len(arm.joints)}")
        for joint, column in zip(arm.joints, self.position_rad.T, strict=True):
            low, high = joint.limits_rad
            least, most = float(column.min()), float(column.max())
            if least < low - 1e-6 or most > high + 1e-6:
                raise UsageError(
                    f"the path takes {joint.name} from {least:.3f} to {most:.3f}, its limits are "
                    f"{low:.3f} and {high:.3f}; choose another path"
                )
        return self


@dataclass(frozen=True, eq=False)
class LinkPoses:
    """Frames of an arm's base, of each joint's link and of its tool, in that order."""

    position_m: Array  # origins in the base frame, shape (T, J + 2, 3)
    rotation: Array  # rotations to the base frame (axes as columns), shape (T, J + 2, 3, 3)


def link_poses(arm: Arm, position_rad: ArrayLike) -> LinkPoses:
    """Compute forward kinematics; `position_rad` has shape (T, J)."""
    angles = np.asarray(position_rad, np.float64)
    samples = len(angles)
    origin = np.zeros((samples, 3))
    rotation = np.broadcast_to(np.eye(3), (samples, 3, 3))
    origins, rotations = [origin], [rotation]
    for index, joint in enumerate(arm.joints):
        at = Transform.at(joint.origin_m, joint.origin_rpy)
        axis, moved = np.array(joint.axis), angles[:, index]
        origin = origin + rotation @ at.origin_m
        rotation = rotation @ at.rotation
        if joint.is_prismatic:
            origin = origin + (rotation @ axis) * moved[:, None]
        else:
            # Rodrigues' formula, for all samples at once.
            x, y, z = axis
            cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
            sine, rest = np.sin(moved)[:, None, None], (1 - np.cos(moved))[:, None, None]
            rotation = rotation @ (np.eye(3) + sine * cross + rest * (cross @ cross))
        origins.append(origin)
        rotations.append(rotation)
    tool = Transform.at(arm.tool_from_last_m, arm.tool_from_last_rpy)
    origins.append(origin + rotation @ tool.origin_m)
    rotations.append(rotation @ tool.rotation)
    return LinkPoses(np.stack(origins, axis=1), np.stack(rotations, axis=1))


def sample_times(rate_hz: float, seconds: float) -> Array:
    """Return times from 0 at a uniform rate that fit before `seconds`, shape (T,) [s]."""
    return np.arange(max(round(seconds * rate_hz), 2)) / rate_hz


def circle(rate_hz: float = 60.0, seconds: float = 5.0) -> JointPath:
    """Trace the paper's circle by the shipped Jaco, at full speed throughout."""
    return circle_at(sample_times(rate_hz, seconds))


def circle_at(seconds: Array) -> JointPath:
    """Evaluate the paper's circle at any times [s], shape (T,), by its Fourier series."""
    coefficients = _circle_coefficients()
    harmonics = 1j * CIRCLE_RAD_S * np.arange(len(coefficients))
    waves = np.exp(np.asarray(seconds, np.float64)[:, None] * harmonics)
    position, velocity, acceleration = (  # einsum: threads of a matrix product cost more here
        np.real(np.einsum("th,hj->tj", waves, coefficients * harmonics[:, None] ** order))
        for order in range(3)
    )
    return JointPath(np.asarray(seconds), position, velocity, acceleration)


@cache
def _circle_coefficients() -> NDArray[np.complex128]:
    """Compute Fourier coefficients of the shipped turn, shape (harmonics, 7)."""
    _, _, position_rad = read_path_file(CIRCLE_CSV)
    turn = position_rad[:-1]
    spectrum = np.fft.rfft(turn, axis=0)[:32] / len(turn)
    spectrum[1:] *= 2
    return spectrum


def random_path(arm: Arm, seed: int, rate_hz: float = 60.0, seconds: float = 5.0) -> JointPath:
    """Draw a smooth motion of all joints within their limits and 70 % of their speeds."""
    # Each joint follows a few slow sine waves about a posture. Tool and wrist stay above the base
    # plane and out of the base's column.
    rng = np.random.default_rng([seed, 0x9A7B])
    times = sample_times(rate_hz, seconds)
    for _ in range(_MAX_TRIES):
        path = _waves(arm, rng, times)
        if path is not None and _is_clear(arm, path.position_rad):
            return path
    raise UsageError(f"no smooth motion of {arm.name} stays clear of its base; give a path's file")


def _waves(arm: Arm, rng: np.random.Generator, times: Array) -> JointPath | None:
    """Sum three sine waves of 0.1 to 0.5 Hz; None where one joint's limits leave no room."""
    columns: list[tuple[Array, Array, Array]] = []
    for joint in arm.joints:
        rad_s = 2 * np.pi * rng.uniform(0.1, 0.5, 3)
        amplitudes = rng.normal(0.0, 1.0, 3) / rad_s
        phase = np.multiply.outer(times, rad_s) + rng.uniform(0.0, 2 * np.pi, 3)
        position, velocity = np.sin(phase) @ amplitudes, np.cos(phase) @ (amplitudes * rad_s)
        acceleration = -np.sin(phase) @ (amplitudes * rad_s**2)
        # For real arms, of 1 rad/s at most: a driver refuses a path that is at its limits.
        fastest = min(joint.max_velocity_rad_s, 1.0) * 0.7
        scale = rng.uniform(0.5, 1.0) * fastest / np.abs(velocity).max()
        low, high = joint.limits_rad
        low, high = max(low, -_FREE_RAD), min(high, max(low, -_FREE_RAD) + 2 * _FREE_RAD)
        room = (high - low) - scale * np.ptp(position)
        if room <= 0:
            return None
        start = low + rng.uniform(0.0, room) - scale * position.min()
        columns.append((start + scale * position, scale * velocity, scale * acceleration))
    return JointPath(times, *(np.column_stack(part) for part in zip(*columns, strict=True)))


def _is_clear(arm: Arm, position_rad: Array) -> bool:
    """Return whether the arm's outer half stays above the base plane and out of its column."""
    outer_m = link_poses(arm, position_rad).position_m[:, -1 - len(arm.joints) // 2 :]
    beside_m = np.hypot(outer_m[..., 0], outer_m[..., 1])
    reach_m = sum(math.hypot(*joint.origin_m) for joint in arm.joints)
    return bool(outer_m[..., 2].min() > 0.05 * reach_m and beside_m.min() > 0.1 * reach_m)


def eased(path: JointPath, ease_s: float, rate_hz: float) -> JointPath:
    """Time-scale a path to go from rest to rest, with smoothsteps of `ease_s` at both ends."""
    # The path's time runs at 0 first, at 1 after `ease_s`, and at 0 at the end. It takes `ease_s`
    # and up to one row longer than the path, and is nowhere faster.
    from scipy.interpolate import CubicHermiteSpline

    start_s, end_s = float(path.seconds[0]), float(path.seconds[-1])
    rows = math.ceil((end_s - start_s + min(ease_s, (end_s - start_s) / 2)) * rate_hz)
    lasts_s = rows / rate_hz
    ease_s = lasts_s - (end_s - start_s)
    seconds = np.arange(rows + 1) / rate_hz
    phases = np.clip(seconds / ease_s, 0, 1), np.clip((lasts_s - seconds) / ease_s, 0, 1)
    begun, to_end = (ease_s * (phase**3 - phase**4 / 2) for phase in phases)
    middle = np.clip(seconds, ease_s, lasts_s - ease_s) - ease_s
    path_s = start_s + begun + middle + (ease_s / 2 - to_end)
    speed = np.minimum(*(3 * phase**2 - 2 * phase**3 for phase in phases))
    slope = np.where(seconds < lasts_s / 2, 1.0, -1.0)
    phase = np.minimum(*phases)
    change = slope * 6 * phase * (1 - phase) / ease_s
    spline = CubicHermiteSpline(path.seconds, path.position_rad, path.velocity_rad_s)
    velocity, acceleration = spline(path_s, 1), spline(path_s, 2)
    return JointPath(
        seconds,
        spline(path_s),
        velocity * speed[:, None],
        acceleration * speed[:, None] ** 2 + velocity * change[:, None],
    )


def path_from_file(arm: Arm, file: Path, rate_hz: float = 60.0) -> JointPath:
    """Read a user's path (time_s, joint positions [rad]) and fit a quintic spline to it."""
    names, times, position_rad = read_path_file(file)
    # The arm's joints' indices among the file's columns.
    missing = [name for name in arm.joint_names if name not in names]
    if missing:
        raise UsageError(
            f"{file}: has no column {missing[0]}; its columns are {', '.join(names)}, wanted are "
            f"time_s and {', '.join(arm.joint_names)}"
        )
    order = [names.index(name) for name in arm.joint_names]
    if len(times) < 6:
        raise UsageError(f"{file}: {len(times)} rows are no path; give at least 6")
    from scipy.interpolate import make_interp_spline

    spline = make_interp_spline(times - times[0], position_rad[:, order], k=5)
    wanted = sample_times(rate_hz, float(times[-1] - times[0]))
    path = JointPath(wanted, *(spline(wanted, nu) for nu in range(3)))
    try:
        return path.checked(arm)
    except UsageError as error:
        raise UsageError(f"{file}: {error}") from error
