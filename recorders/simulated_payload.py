"""Simulate an arm as ordered for `tunenet-record --simulate payload`, the rest by the seed."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from recorders.simulators.arm.description import Arm, Payload, jaco, read_arm
from recorders.simulators.arm.disturbances import (
    NO_ERRORS,
    REAL_ARM,
    Disturbances,
    drawn,
    through_kinovas_driver,
)
from recorders.simulators.arm.driver import driver_episode
from recorders.simulators.arm.known_arms import DEFAULT, known_arm, name_alone
from recorders.simulators.arm.path import (
    CIRCLE_RAD_S,
    JointPath,
    circle,
    eased,
    path_from_file,
    random_path,
)
from recorders.simulators.arm.payload import PAYLOAD_MASS, PayloadRollout
from recorders.simulators.arm.rollout import PAPER
from tunenet_logs.episode import Episode
from tunenet_logs.errors import UsageError

CIRCLE, RANDOM = "circle", "random"

_DRAWN_MASS_KG = (0.1, 1.5)  # range of a payload that is not ordered: what a Jaco can lift
_RATE_HZ = 60.0  # of an ideal log: the paper's
_DRIVER_RATE_HZ = 65.0  # messages of a Kinova driver, as measured in a log of one
_COMMAND_RATE_HZ = 100.0  # rows of a path for a real arm: what its position interface takes
# Of the motion between whose samples a driver's messages are interpolated: the engine's steps.
_FINE_RATE_HZ = 240.0

_SECONDS = 5.0  # of a motion: about one turn of the circle, 5.2 s
_EASED_S = 1.0  # in which a real arm gets to its speed, and to rest


@dataclass(frozen=True)
class PayloadOrder:
    """An arm's run to simulate; None is drawn from the seed or left to other fields.

    Attributes:
        com_m: the payload's centre of mass in the tool frame.
        is_empty: nothing is held (a tare); all else is as the seed draws it for a payload.
        path: "circle" (the paper's), "random", or a CSV's name; the Jaco's circle if None.
        arm: a known arm's name; None for the Jaco, or the URDF's.
        urdf: the user's arm, whose payload is in the frame of `tool_link`.
        is_driver: all disturbances, in the messages of a real driver. Each of the following
            overrides its part.
        torque_noise_nm: standard deviation, as `friction_nm`, `offset_nm` and `gain_error` are.
        lag_s: of the torques.
        preset: "default", or "paper": the paper's rollout, at 240 Hz.
    """

    mass_kg: float | None = None
    com_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    is_empty: bool = False
    path: str | None = None
    arm: str | None = None
    urdf: Path | None = None
    tool_link: str | None = None
    rate_hz: float | None = None
    seconds: float | None = None
    is_driver: bool = False
    torque_noise_nm: float | None = None
    friction_nm: float | None = None
    offset_nm: float | None = None
    gain_error: float | None = None
    lag_s: float | None = None
    preset: str = "default"
    seed: int = 0


def simulate_payload(order: PayloadOrder) -> Episode:
    """Simulate one run; the same order gives the same bits.

    Raises:
        UsageError: a value, file or combination is invalid.
    """
    arm = ordered_arm(order)
    drawn_kg = float(np.random.default_rng(order.seed).uniform(*_DRAWN_MASS_KG))
    mass_kg = drawn_kg if order.mass_kg is None else order.mass_kg
    payload = Payload(0.0 if order.is_empty else PAYLOAD_MASS.checked(mass_kg), order.com_m)
    notes = {"seed": str(order.seed), "arm": arm.name, "path": order.path or _usual_path(order)}
    if order.is_empty:
        notes["payload"] = "none (tare)"
    if order.preset == "paper":
        episode = _papers_rollout(arm, payload, order)
    else:
        disturbances = _disturbances(arm, order)
        seconds = order.seconds
        if order.path in (None, CIRCLE, RANDOM):
            seconds = (order.seconds or _SECONDS) + disturbances.lead_s
        is_timed = disturbances.rate_hz is not None
        path = _path(arm, order, _FINE_RATE_HZ if is_timed else _rate_hz(order), seconds)
        episode = driver_episode(arm, path, payload, disturbances)
    info = replace(episode.info, notes={**notes, **episode.info.notes})
    return Episode(info, episode.signals)


def command_path(order: PayloadOrder) -> tuple[Arm, JointPath]:
    """Plan the path for a real arm, from rest to rest; one turn where it is the circle.

    Raises:
        UsageError: as `simulate_payload`.
    """
    arm = ordered_arm(order)
    is_circle = (order.path or _usual_path(order)) == CIRCLE
    seconds = order.seconds
    if is_circle:
        seconds = (seconds or 2 * math.pi / CIRCLE_RAD_S) + 1 / _FINE_RATE_HZ
    rate_hz = order.rate_hz or _COMMAND_RATE_HZ
    return arm, eased(_path(arm, order, _FINE_RATE_HZ, seconds), _EASED_S, rate_hz)


def ordered_arm(order: PayloadOrder) -> Arm:
    """Load the ordered arm: the Jaco, a known arm, or a file's.

    Raises:
        UsageError: no such arm.
    """
    if order.arm is not None:
        return known_arm(name_alone(order.arm, order.urdf, order.tool_link)).arm()
    if order.urdf is None:
        if order.tool_link is not None:
            raise UsageError("--tool-link is for an arm of your own; name its file with --urdf")
        return jaco()
    if order.tool_link is None:
        raise UsageError(f"{order.urdf}: which link holds the payload? name it with --tool-link")
    return read_arm(order.urdf, order.tool_link)


def _usual_path(order: PayloadOrder) -> str:
    return CIRCLE if _is_on_circle(order) else RANDOM


def _is_on_circle(order: PayloadOrder) -> bool:
    """Return whether the arm is a Jaco with 7 joints, which the paper's circle is for."""
    return order.urdf is None and (order.arm or DEFAULT).lower().startswith("jaco7")


def _rate_hz(order: PayloadOrder) -> float:
    return order.rate_hz or (_DRIVER_RATE_HZ if order.is_driver else _RATE_HZ)


def _path(arm: Arm, order: PayloadOrder, rate_hz: float, seconds: float | None) -> JointPath:
    """Make the ordered path; a file's whole length if `seconds` is None."""
    wanted = order.path or _usual_path(order)
    if wanted == CIRCLE:
        if not _is_on_circle(order):
            raise UsageError(
                "--path circle is of a Jaco with 7 joints; take --path random or a CSV for this arm"
            )
        return circle(rate_hz, seconds or _SECONDS)
    if wanted == RANDOM:
        return random_path(arm, order.seed, rate_hz, seconds or _SECONDS)
    path = path_from_file(arm, Path(wanted), rate_hz)
    if seconds is None:
        return path
    samples = round(seconds * rate_hz)
    if samples > len(path.seconds):
        raise UsageError(
            f"{wanted}: lasts {path.seconds[-1]:.3f} s, --seconds asks for {seconds:g}"
        )
    return path.part(slice(None, samples))


def _disturbances(arm: Arm, order: PayloadOrder) -> Disturbances:
    base = REAL_ARM if order.is_driver else NO_ERRORS
    sizes = {
        "torque_noise_nm": order.torque_noise_nm,
        "friction_nm": order.friction_nm,
        "offset_nm": order.offset_nm,
        "gain_error": order.gain_error,
    }
    base = replace(base, **{name: size for name, size in sizes.items() if size is not None})
    disturbances = drawn(order.seed, arm, base)
    if order.lag_s is not None:
        disturbances = replace(disturbances, lag_s=order.lag_s)
    if order.is_driver:
        disturbances = through_kinovas_driver(disturbances, _rate_hz(order))
    return disturbances.another_run() if order.is_empty else disturbances


def _papers_rollout(arm: Arm, payload: Payload, order: PayloadOrder) -> Episode:
    asked = (order.torque_noise_nm, order.friction_nm, order.offset_nm, order.gain_error)
    if order.is_driver or any(value is not None for value in (*asked, order.lag_s)):
        raise UsageError("preset paper is a rollout without errors; leave those options out")
    if order.rate_hz not in (None, PAPER.step_hz):
        raise UsageError(f"preset paper is simulated at 240 Hz, not at {order.rate_hz:g} Hz")
    samples = round((order.seconds or _SECONDS) * PAPER.step_hz)
    settings = replace(PAPER, samples=samples)
    path = _path(arm, order, PAPER.step_hz, len(settings.times()) / PAPER.step_hz)
    simulator = PayloadRollout(arm, path, payload.com_m, settings, keep_every=1)
    return simulator.rollout({PAYLOAD_MASS.name: payload.mass_kg})
