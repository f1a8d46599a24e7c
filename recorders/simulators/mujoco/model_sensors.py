"""Map a log's signals to MuJoCo sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from recorders.simulators.mujoco.library import mujoco
from tunenet_logs.episode import Signal

# Of joints; of bodies; of sites.
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

_TYPES = {"jointactuatorfrc": "mjSENS_JOINTACTFRC"}  # what MuJoCo calls otherwise


class Sensor(NamedTuple):
    """One column of a signal as a sensor in the model.

    Attributes:
        kind: MuJoCo's sensor type. Forces and torques are those of a parent on its child.
        name: of the joint, body or site.
        axis: component of a vector sensor.
        reference: the body whose frame a pose is in; "" for the world.
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
        """The model's vector sensor that this is a component of."""
        return self._replace(axis=0, sign=1.0)


@dataclass(frozen=True, eq=False)
class SensedSignal:
    """A signal of the log that the model reproduces.

    Attributes:
        columns: those of its columns that the model has.
        sensors: their sensors.
    """

    signal: Signal
    columns: tuple[str, ...]
    sensors: tuple[Sensor, ...]


def put_sensors(spec: Any, sensors: Sequence[Sensor]) -> None:
    """Replace a model's sensors by these, in their order."""
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
