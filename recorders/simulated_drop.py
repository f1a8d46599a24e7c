"""Simulate a drop as ordered for `tunenet-record --simulate drop`, the rest drawn by the seed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from recorders.simulators.contact import PRESETS
from recorders.simulators.drop import DRAG, RESTITUTION, SLOPE, TOPIC, DropRig, DropSimulator
from tunenet_logs.episode import Episode, Signal
from tunenet_logs.errors import UsageError

_PAPER_RATE_HZ, _PAPER_SAMPLES = 60.0, 400  # the paper's recordings of a drop
_RADIUS_M = {"default": 0.05, "paper": 0.5}  # of the ball, by preset; the paper's is its authors'
# Ranges of what is not ordered: several impacts are then in the usual 6.7 s.
_DRAWN_RESTITUTION, _DRAWN_HEIGHT_M = (0.1, 0.95), (0.3, 5.0)


@dataclass(frozen=True)
class DropOrder:
    """A drop to simulate; None is drawn from the seed or left to the preset.

    Attributes:
        restitution: coefficient of restitution at the first impact's speed.
        slope: its exponent over speed; see `SpeedLaw`.
        drag_1_m: air drag on the ball.
        height_m: the ball's underside over the table.
        seconds: recorded after the release.
        hold_s: recorded before it.
        noise_m: standard deviation added to each coordinate.
    """

    restitution: float | None = None
    slope: float = 0.0
    drag_1_m: float = 0.0
    height_m: float | None = None
    radius_m: float | None = None
    rate_hz: float | None = None
    seconds: float | None = None
    hold_s: float = 0.0
    noise_m: float = 0.0
    preset: str = "default"
    seed: int = 0


def simulate_drop(order: DropOrder) -> Episode:
    """Simulate one drop; the same order gives the same bits.

    Raises:
        UsageError: a value is out of range.
    """
    rng = np.random.default_rng(order.seed)
    restitution, height_m = rng.uniform(*_DRAWN_RESTITUTION), rng.uniform(*_DRAWN_HEIGHT_M)
    rate_hz = order.rate_hz or _PAPER_RATE_HZ
    if order.preset == "paper" and rate_hz != _PAPER_RATE_HZ:
        raise UsageError(f"preset paper is simulated at 60 Hz by definition, not at {rate_hz:g} Hz")
    if order.preset == "paper" and (order.slope or order.drag_1_m):
        raise UsageError("preset paper has neither slope nor drag: leave them out")
    seconds = order.seconds or _PAPER_SAMPLES / _PAPER_RATE_HZ
    rig = DropRig(
        gap_m=height_m if order.height_m is None else order.height_m,
        radius_m=order.radius_m or _RADIUS_M[order.preset],
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
