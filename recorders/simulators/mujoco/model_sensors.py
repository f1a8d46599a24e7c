"""What a log sees of a model, as MuJoCo's sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from recorders.simulators.mujoco.library import mujoco
from tunenet_logs.episode import Signal

Kind = Literal[
    "jointpos",
    "jointvel",
    "jointactuatorfrc",
    "framepos",
    "framexaxis",
    "framezaxis",
    "force",
    "torque",
]
"""Of joints; of bodies; of sites."""

_TYPES = {"jointactuatorfrc": "mjSENS_JOINTACTFRC"}
"""What MuJoCo calls otherwise."""


class Sensor(NamedTuple):
    """What one column of a signal is in the model.

    Attributes:
        kind: of MuJoCo's sensors. Forces and torques are those of a parent on its child.
        name: of the joint, body or site.
        axis: of what has three numbers.
        reference: the body that a body is seen from; "" for the world.
        is_at_body: whether a force or torque is that at the origin of the body of that name.
        sign: 1.0, or -1.0 of a log with forces of the child on its parent.
    """

    kind: Kind
    name: str
    axis: int = 0
    reference: str = ""
    is_at_body: bool = False
    sign: float = 1.0

    @property
    def whole(self) -> Sensor:
        """The model's sensor that this is a number of."""
        return self._replace(axis=0, sign=1.0)


@dataclass(frozen=True, eq=False)
class SensedSignal:
    """A signal of the log that the model has, too.

    Attributes:
        signal: of the log.
        columns: those of its columns that the model has.
        sensors: what they are there.
    """

    signal: Signal
    columns: tuple[str, ...]
    sensors: tuple[Sensor, ...]


def put_sensors(spec: Any, sensors: Sequence[Sensor]) -> None:
    """Give a model these sensors in place of its own, in their order."""
    kinds = mujoco().mjtObj
    for sensor in list(spec.sensors):
        spec.delete(sensor)
    for number, one in enumerate(sensors):
        name, is_frame = one.name, one.kind.startswith("frame")
        if one.is_at_body:
            name = f"seen at {number}"
            spec.body(one.name).add_site(name=name)
        sensor = spec.add_sensor(
            name=f"seen {number}",
            type=getattr(mujoco().mjtSensor, _TYPES.get(one.kind, f"mjSENS_{one.kind.upper()}")),
            objname=name,
        )
        if is_frame:
            sensor.objtype = kinds.mjOBJ_XBODY
        elif one.kind in ("force", "torque"):
            sensor.objtype = kinds.mjOBJ_SITE
        else:
            sensor.objtype = kinds.mjOBJ_JOINT
        if one.reference:
            sensor.reftype, sensor.refname = kinds.mjOBJ_XBODY, one.reference
