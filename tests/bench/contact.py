"""Compare effective with set restitution: PyBullet's defaults, and the calibrated settings.

`python -m tests.bench.contact` prints, for each setting, the worst deviation over 25 drop heights
from 0.3 to 5 m. Effective means the ratio of the speeds that the energies in mid-flight after and
before the first impact stand for.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tunenet_logs.recorders.simulators.ball import TOPIC, DropRig, DropSimulator
from tunenet_logs.recorders.simulators.base import CALIBRATED, PAPER, ContactSettings

SET = (0.1, 0.2, 0.3, 0.5, 0.7, 0.9, 1.0)
GAPS_M = np.geomspace(0.3, 5.0, 25)


def effective(contact: ContactSettings, gap_m: float, restitution: float, rate_hz: float) -> float:
    rig = DropRig(gap_m=float(gap_m), radius_m=0.05, rate_hz=rate_hz, samples=int(2.2 * rate_hz))
    values = DropSimulator(rig, contact).rollout({"restitution": restitution}).signals[TOPIC].values
    curve = values[:, 2] - rig.radius_m
    gravity = contact.gravity_m_s2
    fall = np.sqrt(2 * gap_m / gravity) * rate_hz
    before, after = int(fall / 2), int(fall * (1 + restitution)) + 1

    def energy(at: int) -> float:
        speed = (curve[at + 1] - curve[at - 1]) * rate_hz / 2
        return gravity * curve[at] + speed**2 / 2

    return float(np.sqrt(max(energy(after), 0.0) / energy(before)))


def main() -> None:
    fixed = replace(CALIBRATED, meet_impacts=False)
    settings = [
        ("defaults, 60 Hz (the paper's)", PAPER, 60.0),
        ("defaults, 240 Hz", PAPER, 240.0),
        ("calibrated, fixed steps, 240 Hz", fixed, 240.0),
        ("calibrated, fixed steps, 960 Hz", fixed, 960.0),
        ("calibrated, impacts met, 240 Hz", CALIBRATED, 240.0),
    ]
    print(f"{'worst |effective - set|':34}" + "".join(f"{value:>9}" for value in SET))
    for name, contact, rate_hz in settings:
        worst = [
            max(abs(effective(contact, gap, value, rate_hz) - value) for gap in GAPS_M)
            for value in SET
        ]
        print(f"{name:34}" + "".join(f"{value:9.5f}" for value in worst))


if __name__ == "__main__":
    main()
