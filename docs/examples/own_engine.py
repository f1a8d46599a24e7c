"""Tune from a log, and step the tuned ball in MuJoCo: `python docs/examples/own_engine.py LOG`."""

import sys
import tempfile
from pathlib import Path

import mujoco
import numpy as np

import tunenet_logs as tn


def main(log: str) -> None:
    """The exported file is a scene of its own; its ball starts where the recorded one did."""
    tuning = tn.tune(log)
    with tempfile.TemporaryDirectory() as folder:
        (scene,) = tn.export(tuning, "mujoco", Path(folder) / "ball.xml")
        model = mujoco.MjModel.from_xml_path(str(scene))
    data = mujoco.MjData(model)
    ball = data.body("tuned_ball")
    radius_m = float(model.geom("tuned_ball").size[0])
    heights_m = []
    while data.time < 2:
        mujoco.mj_step(model, data)
        heights_m.append(float(ball.xpos[2]) - radius_m)
    first = int(np.argmax(np.array(heights_m) <= 0))
    rebound_m = max(heights_m[first:])
    tuned = tuning.to_frame().loc["restitution", "value"]
    print(f"tuned {tuned:.4f}")
    print(f"stepped {np.sqrt(rebound_m / heights_m[0]):.4f}, from the first rebound's height")


if __name__ == "__main__":
    main(*sys.argv[1:])
