"""Simulate a drop, filmed or not, a payload or a bounce shot as ordered; the seed draws the rest.

`orders` says what may be asked for. The same order gives the same bits.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Array, Channel, Episode, Frame, Signal
from tunenet_logs.errors import UsageError
from tunenet_logs.messages import CAMERA_TOPIC, COMPRESSED_IMAGE
from tunenet_logs.recorders.orders import DropOrder, FilmOrder, PayloadOrder, ShotOrder
from tunenet_logs.recorders.simulators.arm.description import Arm, Payload, jaco, read_arm
from tunenet_logs.recorders.simulators.arm.known import DEFAULT, known_arm, name_alone
from tunenet_logs.recorders.simulators.arm.path import (
    CIRCLE_RAD_S,
    JointPath,
    circle,
    eased,
    path_from_file,
    random_path,
)
from tunenet_logs.recorders.simulators.arm.payload import (
    NO_ERRORS,
    PAPER,
    PAYLOAD_MASS,
    REAL_ARM,
    Disturbances,
    PayloadRollout,
    drawn,
    driver_episode,
    through_kinovas_driver,
)
from tunenet_logs.recorders.simulators.ball import (
    DRAG,
    RESTITUTION,
    SLOPE,
    TOPIC,
    DropRig,
    DropSimulator,
)
from tunenet_logs.recorders.simulators.base import PRESETS
from tunenet_logs.recorders.simulators.camera import BallScene, PinholeCamera, random_camera
from tunenet_logs.recorders.simulators.shot import BounceShot, ShotRig, read_rig

# ---- Drop

_PAPER_RATE_HZ = 60.0  # of the paper's recordings of a drop


def simulate_drop(order: DropOrder) -> Episode:
    """Simulate one drop; the same order gives the same bits."""
    rng = np.random.default_rng(order.seed)
    # What is not ordered; several impacts are then in the usual 6.7 s.
    restitution, height_m = rng.uniform(0.1, 0.95), rng.uniform(0.3, 5.0)
    rate_hz = order.rate_hz or _PAPER_RATE_HZ
    if order.preset == "paper" and rate_hz != _PAPER_RATE_HZ:
        raise UsageError(f"preset paper is simulated at 60 Hz by definition, not at {rate_hz:g} Hz")
    if order.preset == "paper" and (order.slope or order.drag_1_m):
        raise UsageError("preset paper has neither slope nor drag: leave them out")
    seconds = order.seconds or 400 / _PAPER_RATE_HZ
    rig = DropRig(
        gap_m=height_m if order.height_m is None else order.height_m,
        radius_m=order.radius_m or (0.5 if order.preset == "paper" else 0.05),
        rate_hz=rate_hz,
        samples=round((seconds + order.hold_s) * rate_hz),
        hold_s=order.hold_s,
    )
    wanted = restitution if order.restitution is None else order.restitution
    simulator = DropSimulator(rig, PRESETS[order.preset])
    values = {RESTITUTION.name: wanted, SLOPE.name: order.slope, DRAG.name: order.drag_1_m}
    known = {one.name for one in simulator.parameters}
    episode = simulator.rollout({name: one for name, one in values.items() if name in known})
    notes = {"seed": str(order.seed), "noise_m": repr(order.noise_m)}
    info = replace(episode.info, notes=notes)
    ball = episode.signals[TOPIC]
    noise = rng.normal(0.0, 1.0, ball.values.shape) * order.noise_m
    noisy = Signal(TOPIC, ball.stamps_ns, ball.values + noise, ball.columns, ball.unit)
    return Episode(info, {TOPIC: noisy})


# ---- Filmed drop

_SUBFRAMES = 8  # positions of the ball while the shutter is open, whose mean is its blur


def film_drop(order: DropOrder, film: FilmOrder) -> Episode:
    """Simulate and film one drop; the same orders give the same bits."""
    # The camera is drawn from a stream of its own: a seed gives one drop, filmed or not.
    rng = np.random.default_rng([order.seed, 0xCA3E])
    camera = _placed_camera(order, film)
    if order.height_m is None:  # from a table, or from a person's hand
        order = replace(order, height_m=float(rng.uniform(0.4, 2.0)))
    drop = simulate_drop(order)
    rig = drop.info.rig
    radius_m = rig["ball_diameter_m"] / 2
    camera = camera or random_camera(
        rng, rig["drop_height_m"], radius_m, film.size_px, film.fov_deg
    )
    centers_m = _shutter_centers(drop, order, film)
    stamps_ns = drop.signals[TOPIC].stamps_ns
    kept = rng.random(len(stamps_ns)) >= film.lost_share
    kept[0] = True
    scene_seed = int(rng.integers(2**63))
    x, y, z = camera.position_m
    notes = {
        **drop.info.notes,
        "camera_position_m": f"{x:.4f}, {y:.4f}, {z:.4f}",
        "camera_target_m": ", ".join(f"{value:.4f}" for value in camera.target_m),
        "camera_fov_deg": f"{camera.fov_deg:g}",
        "camera_focal_px": f"{camera.focal_px:.3f}",
        "exposure_s": f"{film.exposure_s:g}",
        "pixel_noise": f"{film.noise:g}",
        "lost_frames": str(int(np.count_nonzero(~kept))),
    }
    frames = partial(
        _frames, camera, radius_m, stamps_ns[kept], centers_m[kept], film.noise, scene_seed
    )
    info = replace(drop.info, source=f"{drop.info.source}, rendered", notes=notes)
    channel = Channel(CAMERA_TOPIC, COMPRESSED_IMAGE, "cdr", stamps_ns[kept], pictures=True)
    return Episode(info, {}, (channel,), open_frames=frames)


def _placed_camera(order: DropOrder, film: FilmOrder) -> PinholeCamera | None:
    """Return the camera whose place is given; None if it is to be drawn."""
    if film.camera_at is None:
        if film.look_at is not None:
            raise UsageError("--look-at needs --camera-at: where does the camera stand?")
        return film.camera
    target = film.look_at
    if target is None:
        if order.height_m is None:
            raise UsageError("--camera-at needs --look-at or --height: where is the drop?")
        target = (0.0, 0.0, 0.44 * order.height_m)
    return PinholeCamera(film.camera_at, target, film.size_px, film.fov_deg)


def _shutter_centers(drop: Episode, order: DropOrder, film: FilmOrder) -> Array:
    """Return the ball's centres while the shutter is open, shape (T, S, 3) [m]."""
    signal = drop.signals[TOPIC]
    if not film.exposure_s:
        return signal.values[:, None]
    if order.preset == "paper":
        raise UsageError("preset paper knows the ball only 60 times a second: no --blur with it")
    seconds = signal.seconds
    offsets = (np.arange(_SUBFRAMES) + 0.5) / _SUBFRAMES - 0.5
    fine_rate = min(_SUBFRAMES / film.exposure_s, 20_000.0)
    last_s = float(seconds[-1]) + film.exposure_s - order.hold_s
    finer = replace(order, rate_hz=fine_rate, noise_m=0.0, seconds=last_s)
    fine = simulate_drop(finer).signals[TOPIC]
    wanted = seconds[:, None] + offsets * film.exposure_s
    heights = np.interp(wanted, fine.seconds, fine.values[:, 2])
    return np.stack([np.zeros_like(heights), np.zeros_like(heights), heights], axis=-1)


def _frames(
    camera: PinholeCamera,
    radius_m: float,
    stamps_ns: NDArray[np.int64],
    centers_m: Array,
    noise: float,
    seed: int,
    _topic: str,
) -> Iterator[Frame]:
    import cv2

    rng = np.random.default_rng(seed)
    scene = BallScene(camera, radius_m, rng)
    for stamp_ns, centers in zip(stamps_ns.tolist(), centers_m, strict=True):
        picture = scene.picture(centers)
        noisy = picture + rng.normal(0.0, 1.0, picture.shape) * noise
        pixels = np.clip(np.round(noisy), 0, 255).astype(np.uint8)
        quality = [cv2.IMWRITE_JPEG_QUALITY, 92]  # a webcam's: artefacts as in a real recording
        _, data = cv2.imencode(".jpg", pixels[:, :, ::-1], quality)
        yield Frame(stamp_ns, "jpeg", data.tobytes())


# ---- Payload: an arm that holds it moves along a path

_CIRCLE, _RANDOM = "circle", "random"
_FINE_RATE_HZ = 240.0  # of the motion that a driver's messages sample by interpolation
_MOTION_S = 5.0  # of a motion: about one turn of the circle, 5.2 s


def simulate_payload(order: PayloadOrder) -> Episode:
    """Simulate one run; the same order gives the same bits."""
    arm = ordered_arm(order)
    drawn_kg = float(np.random.default_rng(order.seed).uniform(0.1, 1.5))  # what a Jaco can lift
    mass_kg = drawn_kg if order.mass_kg is None else order.mass_kg
    payload = Payload(0.0 if order.is_empty else PAYLOAD_MASS.checked(mass_kg), order.com_m)
    notes = {"seed": str(order.seed), "arm": arm.name, "path": _wanted_path(order)}
    if order.is_empty:
        notes["payload"] = "none (tare)"
    if order.preset == "paper":
        asked = (order.torque_noise_nm, order.friction_nm, order.offset_nm, order.gain_error)
        if order.is_driver or any(value is not None for value in (*asked, order.lag_s)):
            raise UsageError("preset paper is a rollout without errors; leave those options out")
        if order.rate_hz not in (None, PAPER.step_hz):
            raise UsageError(f"preset paper is simulated at 240 Hz, not at {order.rate_hz:g} Hz")
        samples = round((order.seconds or _MOTION_S) * PAPER.step_hz)
        settings = replace(PAPER, samples=samples)
        path = _path(arm, order, PAPER.step_hz, len(settings.times()) / PAPER.step_hz)
        simulator = PayloadRollout(arm, path, payload.com_m, settings, keep_every=1)
        episode = simulator.rollout({PAYLOAD_MASS.name: payload.mass_kg})
    else:
        disturbances = _disturbances(arm, order)
        seconds = order.seconds
        if order.path in (None, _CIRCLE, _RANDOM):
            seconds = (order.seconds or _MOTION_S) + disturbances.lead_s
        is_timed = disturbances.rate_hz is not None
        path = _path(arm, order, _FINE_RATE_HZ if is_timed else _rate_hz(order), seconds)
        episode = driver_episode(arm, path, payload, disturbances)
    info = replace(episode.info, notes={**notes, **episode.info.notes})
    return Episode(info, episode.signals)


def command_path(order: PayloadOrder) -> tuple[Arm, JointPath]:
    """Plan the path for a real arm, from rest to rest; one turn where it is the circle."""
    arm = ordered_arm(order)
    is_circle = _wanted_path(order) == _CIRCLE
    seconds = order.seconds
    if is_circle:
        seconds = (seconds or 2 * math.pi / CIRCLE_RAD_S) + 1 / _FINE_RATE_HZ
    rate_hz = order.rate_hz or 100.0  # what a real arm's position interface takes
    # In one second the arm gets to its speed, and to rest.
    return arm, eased(_path(arm, order, _FINE_RATE_HZ, seconds), 1.0, rate_hz)


def ordered_arm(order: PayloadOrder) -> Arm:
    """Load the ordered arm: the Jaco, a known arm, or a file's."""
    if order.arm is not None:
        return known_arm(name_alone(order.arm, order.urdf, order.tool_link)).arm()
    if order.urdf is None:
        if order.tool_link is not None:
            raise UsageError("--tool-link is for an arm of your own; name its file with --urdf")
        return jaco()
    if order.tool_link is None:
        raise UsageError(f"{order.urdf}: which link holds the payload? name it with --tool-link")
    return read_arm(order.urdf, order.tool_link)


def _is_on_circle(order: PayloadOrder) -> bool:
    """Return whether the arm is a Jaco with 7 joints, which the paper's circle is for."""
    return order.urdf is None and (order.arm or DEFAULT).lower().startswith("jaco7")


def _wanted_path(order: PayloadOrder) -> str:
    return order.path or (_CIRCLE if _is_on_circle(order) else _RANDOM)


def _rate_hz(order: PayloadOrder) -> float:
    # Of an ideal log as in the paper; of a Kinova driver as measured in a log of one.
    return order.rate_hz or (65.0 if order.is_driver else 60.0)


def _path(arm: Arm, order: PayloadOrder, rate_hz: float, seconds: float | None) -> JointPath:
    """Make the ordered path; a file's whole length if `seconds` is None."""
    wanted = _wanted_path(order)
    if wanted == _CIRCLE:
        if not _is_on_circle(order):
            raise UsageError(
                "--path circle is of a Jaco with 7 joints; take --path random or a CSV for this arm"
            )
        return circle(rate_hz, seconds or _MOTION_S)
    if wanted == _RANDOM:
        return random_path(arm, order.seed, rate_hz, seconds or _MOTION_S)
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
    names = ("torque_noise_nm", "friction_nm", "offset_nm", "gain_error")
    sizes = {name: size for name in names if (size := getattr(order, name)) is not None}
    disturbances = drawn(order.seed, arm, replace(base, **sizes))
    if order.lag_s is not None:
        disturbances = replace(disturbances, lag_s=order.lag_s)
    if order.is_driver:
        disturbances = through_kinovas_driver(disturbances, _rate_hz(order))
    return disturbances.another_run() if order.is_empty else disturbances


# ---- Bounce shot


def simulate_shot(order: ShotOrder) -> Episode:
    """Simulate one shot; the same order gives the same bits."""
    rng = np.random.default_rng(order.seed)
    rig = read_rig(order.rig) if isinstance(order.rig, Path) else order.rig or ShotRig()
    rig = rig if order.drag_1_m is None else rig.with_drag(order.drag_1_m)
    reach = rig.release
    restitution = float(rng.uniform(0.5, 0.85))  # table tennis, squash, tennis, golf
    height_m = float(rng.uniform(reach.lowest_m, reach.highest_m))
    height_m = height_m if order.height_m is None else order.height_m
    simulator = BounceShot(rig=rig, height_m=height_m, slope=order.slope, rate_hz=order.rate_hz)
    wanted = restitution if order.restitution is None else order.restitution
    episode = simulator.rollout({RESTITUTION.name: wanted})
    notes = {"seed": str(order.seed), "slope": repr(order.slope)}
    return Episode(replace(episode.info, notes=notes), episode.signals)
