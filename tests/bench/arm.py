"""Compare arm torques by inverse dynamics and by a rollout: difference and speed.

`python -m tests.bench.arm` prints both, over 5 s of the paper's circle with a payload.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

import numpy as np

from tunenet_logs.recorders.simulators.arm.description import Payload, jaco
from tunenet_logs.recorders.simulators.arm.path import circle, circle_at
from tunenet_logs.recorders.simulators.arm.payload import (
    CALIBRATED,
    PAPER,
    joint_efforts_nm,
    roll_out,
)
from tunenet_logs.recorders.simulators.base import RolloutSettings

ARM = jaco()
HELD = Payload(0.7)
ROUNDS = 30


def milliseconds(work: Callable[[], object]) -> float:
    """Return the best of a few rounds [ms]."""
    times = []
    for _ in range(ROUNDS):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return 1e3 * min(times)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def agreement(settings: RolloutSettings) -> tuple[float, float]:
    """Return RMS differences from inverse dynamics [N·m]: along the circle, and the arm's path."""
    times = settings.times()
    rollout = roll_out(ARM, circle_at(times), HELD, settings)
    recorded = circle_at(times[settings.burn_in : -1])
    ideal = joint_efforts_nm(ARM, recorded, HELD, settings.gravity_m_s2)
    own = joint_efforts_nm(ARM, rollout.path, HELD, settings.gravity_m_s2)
    return rms(rollout.effort_nm - ideal), rms(rollout.effort_nm - own)


def main() -> None:
    path = circle(60)
    inverse_ms = milliseconds(lambda: joint_efforts_nm(ARM, path, HELD))
    print(f"inverse dynamics, 5 s at 60 Hz   {inverse_ms:7.2f} ms")
    for settings in (CALIBRATED, PAPER):
        steps = circle_at(settings.times())
        took_ms = milliseconds(partial(roll_out, ARM, steps, HELD, settings))
        along, own = agreement(settings)
        print(
            f"rollout, settings {settings.name:7}        {took_ms:7.2f} ms, "
            f"{took_ms / inverse_ms:.0f} times that; its torques differ by {along:.5f} N·m rms "
            f"along the circle, by {own:.1e} along its own way"
        )


if __name__ == "__main__":
    main()
