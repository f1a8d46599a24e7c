"""Logs of an arm whose truth is known: torques by the engine, never by the fit's own model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from tunenet_logs.analysis.payload.arm_log import read_arm_log
from tunenet_logs.analysis.payload.torque_model import ArmMotion, arm_motion
from tunenet_logs.episode import Episode, Signal
from tunenet_logs.recorders.simulators.arm.description import Payload, jaco
from tunenet_logs.recorders.simulators.arm.path import JointPath, circle, eased, random_path
from tunenet_logs.recorders.simulators.arm.payload import (
    Disturbances,
    drawn,
    driver_episode,
    through_kinovas_driver,
)

ARM = jaco()
CLEAN = Disturbances(rate_hz=60.0)
FINGERS = ("finger_1", "finger_2", "finger_3", "finger_tip_1", "finger_tip_2", "finger_tip_3")
FULL_HZ = 500.0
SECONDS = 5.2


def circle_log(payload: Payload | None, disturbances: Disturbances = CLEAN) -> Episode:
    return driver_episode(ARM, circle(FULL_HZ, SECONDS), payload, disturbances)


def any_log(payload: Payload | None, seed: int, disturbances: Disturbances = CLEAN) -> Episode:
    return driver_episode(ARM, random_path(ARM, seed, FULL_HZ, SECONDS), payload, disturbances)


def motion_of(episode: Episode) -> ArmMotion:
    return arm_motion(read_arm_log(episode, ARM))


def driver(seed: int, rate_hz: float = 65.0) -> Disturbances:
    return through_kinovas_driver(drawn(seed, ARM), rate_hz)


def changed(episode: Episode, **fields) -> Episode:
    """The same with functions applied to its signals: `position`, `velocity`, `effort`."""
    signals = dict(episode.signals)
    for name, change in fields.items():
        full = f"/joint_states.{name}"
        signals[full] = change(signals[full])
    return replace(episode, signals=signals)


def with_values(change):
    return lambda signal: replace(signal, values=change(np.array(signal.values)))


def of_all(change) -> dict:
    """For `changed`: the same change of all three."""
    return dict.fromkeys(("position", "velocity", "effort"), change)


def stuck(first: int, last: int):
    """For `with_values`: what is said once is said again for a while."""

    def change(values):
        values[first:last] = values[first]
        return values

    return change


def renamed(signal: Signal, columns: tuple[str, ...]) -> Signal:
    return replace(signal, columns=columns)


def with_fingers(signal: Signal) -> Signal:
    """13 joints, as Kinova's driver names them, in another order than the arm's."""
    names = (*signal.columns, *(f"j2s7s300_joint_{one}" for one in FINGERS))
    values = np.concatenate([signal.values, np.zeros((len(signal.values), len(FINGERS)))], axis=1)
    order = np.random.default_rng(3).permutation(len(names))
    return replace(signal, columns=tuple(names[at] for at in order), values=values[:, order])


def on_topic(signal: Signal, topic: str, columns: tuple[str, ...] | None = None) -> Signal:
    ending = signal.name.rsplit(".", 1)[1]
    return replace(signal, name=f"{topic}.{ending}", columns=columns or signal.columns)


EASED_S = 0.8


def paused(
    path: JointPath,
    cuts_s: Sequence[float],
    pause_s: float = 2.0,
    *,
    before_s: float = 0.0,
    after_s: float = 0.0,
) -> JointPath:
    """The same way with stops at some of its times; from rest to rest."""
    edges = [0, *(round(cut * FULL_HZ) for cut in cuts_s), len(path.seconds) - 1]
    parts = [
        eased(path.part(slice(begin, end + 1)), EASED_S, FULL_HZ) for begin, end in pairwise(edges)
    ]
    rows = [np.zeros((0, 3, path.position_rad.shape[1]))]
    for index, part in enumerate(parts):
        rows.append(_at_rest(part, 0, pause_s if index else before_s))
        fields = (part.position_rad, part.velocity_rad_s, part.acceleration_rad_s2)
        rows.append(np.stack(fields, axis=1)[:-1])
    rows.append(_at_rest(parts[-1], -1, after_s + 1 / FULL_HZ))
    position, velocity, acceleration = np.moveaxis(np.concatenate(rows), 1, 0)
    return JointPath(np.arange(len(position)) / FULL_HZ, position, velocity, acceleration)


def _at_rest(part: JointPath, row: int, seconds: float) -> np.ndarray:
    """Position and zeros for so long, shape (T, 3, J)."""
    rest = np.zeros((round(seconds * FULL_HZ), 3, part.position_rad.shape[1]))
    rest[:, 0] = part.position_rad[row]
    return rest
