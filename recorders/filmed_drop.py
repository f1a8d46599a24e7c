"""Simulate a drop as a camera films it, for `tunenet-record --simulate drop --render`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from recorders.simulated_drop import DropOrder, simulate_drop
from recorders.simulators.ball_scene import BallScene
from recorders.simulators.drop import TOPIC
from recorders.simulators.pinhole import PinholeCamera, random_camera
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Channel, Episode, Frame
from tunenet_logs.errors import UsageError
from tunenet_logs.messages import CAMERA_TOPIC, COMPRESSED_IMAGE

# The camera is drawn from a stream of its own: a seed gives one drop, filmed or not.
CAMERA_SEED = 0xCA3E

_JPEG_QUALITY = 92  # of 100; webcams are near it: artefacts as in a real recording
_SUBFRAMES = 8  # positions of the ball while the shutter is open, whose mean is its blur
_FILMED_HEIGHT_M = (0.4, 2.0)  # range of drop heights before a camera: those of a table or a person


@dataclass(frozen=True)
class FilmOrder:
    """How to film a drop; None is drawn from the seed.

    Attributes:
        camera: the paper's random camera if None.
        size_px: (width, height) of a random camera's picture.
        fov_deg: vertical field of view of a random camera.
        exposure_s: how long the shutter is open, centred on a frame's stamp; 0 for no blur.
        noise: standard deviation of a pixel, of 255.
        lost_share: share of the frames that are missing.
    """

    camera: PinholeCamera | None = None
    size_px: tuple[int, int] = (320, 240)
    fov_deg: float = 60.0
    exposure_s: float = 0.0
    noise: float = 2.0
    lost_share: float = 0.0


def film_drop(order: DropOrder, film: FilmOrder) -> Episode:
    """Simulate and film one drop; the same orders give the same bits.

    Raises:
        UsageError: a value is out of range, or no random camera sees the whole drop.
    """
    rng = np.random.default_rng([order.seed, CAMERA_SEED])
    if order.height_m is None:
        order = replace(order, height_m=float(rng.uniform(*_FILMED_HEIGHT_M)))
    drop = simulate_drop(order)
    rig = drop.info.rig
    radius_m = rig["ball_diameter_m"] / 2
    camera = film.camera or random_camera(
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
    channel = Channel(
        topic=CAMERA_TOPIC,
        type_name=COMPRESSED_IMAGE,
        encoding="cdr",
        log_ns=stamps_ns[kept],
        pictures=True,
    )
    return Episode(info, {}, (channel,), open_frames=frames)


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
        quality = [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]
        _, data = cv2.imencode(".jpg", pixels[:, :, ::-1], quality)
        yield Frame(stamp_ns, "jpeg", data.tobytes())
