"""Draw a simulated arm for viewers that open the log itself: its description, and transforms."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import partial

import numpy as np

from tunenet_logs import messages
from tunenet_logs.copying import TopicMessages
from tunenet_logs.episode import Array, Signal
from tunenet_logs.recorders.simulators.arm.description import Arm, rpy_from_rotation
from tunenet_logs.recorders.simulators.arm.path import link_poses
from tunenet_logs.writing.drawn import TF_TOPIC
from tunenet_logs.writing.writer import EpisodeWriter

_DESCRIPTION_TOPIC = "/robot_description"
_MAX_RATE_HZ = 30.0  # of its transforms: seven to ten a message are most of such a log
_THINNEST, _THICKEST = 0.026, 0.042  # radii of its links, of its reach


def drawn_arm(arm: Arm, topic: str, positions: Signal) -> TopicMessages:
    """Yield what draws an arm whose joints move as on `topic`: once its shape, then its frames."""
    stamps_ns = positions.stamps_ns
    period_ns = float(np.median(np.diff(stamps_ns))) if len(stamps_ns) > 1 else np.inf
    kept = slice(None, None, max(round(1e9 / _MAX_RATE_HZ / period_ns), 1))

    def write(writer: EpisodeWriter, to: str, kind: str, stamp_ns: int, message: object) -> None:
        data = messages.encode(message, kind)
        writer.write_message(to, kind, stamp_ns, data, shows=topic)

    first_ns = int(stamps_ns[0])
    shape = messages.text(_urdf(arm))
    begin = partial(write, to=_DESCRIPTION_TOPIC, kind=messages.TEXT, stamp_ns=first_ns)
    yield first_ns, _DESCRIPTION_TOPIC, partial(begin, message=shape)
    each = zip(stamps_ns[kept].tolist(), _frames(arm, positions.values[kept]), strict=True)
    for stamp_ns, frames in each:
        placed = [
            messages.transform(stamp_ns, parent, child, origin_m, turn)
            for parent, child, origin_m, turn in frames
        ]
        moved = partial(write, to=TF_TOPIC, kind=messages.TRANSFORMS, stamp_ns=stamp_ns)
        yield stamp_ns, TF_TOPIC, partial(moved, message=messages.transforms(placed))


def _frames(arm: Arm, position_rad: Array) -> Iterator[list[tuple[str, str, Array, Array]]]:
    """Yield parent, child, origin [m] and quaternion x, y, z, w of each link, sample by sample."""
    from scipy.spatial.transform import Rotation

    poses = link_poses(arm, position_rad)
    names = _names(arm)
    outer, inner = poses.rotation[:, :-1], poses.rotation[:, 1:]
    back = np.swapaxes(outer, -1, -2)
    steps_m = np.diff(poses.position_m, axis=1)[..., None]
    origins_m = (back @ steps_m)[..., 0]
    turns = Rotation.from_matrix((back @ inner).reshape(-1, 3, 3)).as_quat()
    turns = turns.reshape(*origins_m.shape[:2], 4)
    for origin_m, turn in zip(origins_m, turns, strict=True):
        yield list(zip(names, names[1:], origin_m, turn, strict=False))


def _names(arm: Arm) -> list[str]:
    return ["base", *(f"link_{number}" for number in range(1, len(arm.joints) + 1)), "tool"]


def _urdf(arm: Arm) -> str:
    """Describe the shapes of an arm's links: rods between joints, and a ball in its tool frame."""
    names = _names(arm)
    ends = [*(joint.origin_m for joint in arm.joints), arm.tool_from_last_m]
    turns = [*(joint.origin_rpy for joint in arm.joints), arm.tool_from_last_rpy]
    reach_m = float(sum(np.linalg.norm(end) for end in ends))
    radii_m = np.linspace(_THICKEST, _THINNEST, len(names)) * reach_m
    parts = [f'<robot name="{arm.name}">']
    for name, end_m, radius_m in zip(names, [*ends, None], radii_m, strict=True):
        rod = "" if end_m is None else _rod(np.array(end_m), radius_m)
        ball = f'<visual><geometry><sphere radius="{1.2 * radius_m:.4f}"/></geometry></visual>'
        parts.append(f'<link name="{name}">{ball}{rod}</link>')
    for parent, child, end_m, rpy in zip(names, names[1:], ends, turns, strict=False):
        parts.append(
            f'<joint name="to_{child}" type="floating"><parent link="{parent}"/>'
            f'<child link="{child}"/><origin xyz="{_row(end_m)}" rpy="{_row(rpy)}"/></joint>'
        )
    return "\n".join((*parts, "</robot>"))


def _rod(end_m: Array, radius_m: float) -> str:
    """Describe a cylinder from the origin to `end_m`, shape (3,); "" where that is too near."""
    length_m = float(np.linalg.norm(end_m))
    if length_m < radius_m:
        return ""
    along: Array = end_m / length_m
    aside: Array = np.cross(along, np.eye(3)[np.argmin(np.abs(along))]).astype(np.float64)
    aside /= np.linalg.norm(aside)
    other = np.cross(along, aside).astype(np.float64)
    axes = np.stack([aside, other, along], axis=1)
    return (
        f'<visual><origin xyz="{_row(end_m / 2)}" rpy="{_row(rpy_from_rotation(axes))}"/>'
        f'<geometry><cylinder radius="{radius_m:.4f}" length="{length_m:.4f}"/></geometry></visual>'
    )


def _row(values: Iterable[float]) -> str:
    return " ".join(f"{value:.5g}" for value in values)
