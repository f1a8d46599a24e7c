"""DDS definitions of the received message types.

Names and order of the fields are those of sensor_msgs, std_msgs and builtin_interfaces (ROS 2) and
of kinova_msgs. Only cyclonedds reads them: what arrives goes into the log as it came. It
evaluates the annotations, so they cannot wait as text (`from __future__ import annotations`).
"""

from dataclasses import dataclass

from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import float32, float64, int32, sequence, uint32

from tunenet_logs.messages import JOINT_ANGLES, JOINT_STATE


@final
@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    """builtin_interfaces/msg/Time."""

    sec: int32
    nanosec: uint32


@final
@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    """std_msgs/msg/Header."""

    stamp: Time
    frame_id: str


@final
@dataclass
class JointState(IdlStruct, typename="sensor_msgs::msg::dds_::JointState_"):
    """sensor_msgs/msg/JointState [rad, rad/s, N·m]."""

    header: Header
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


@final
@dataclass
class JointAngles(IdlStruct, typename="kinova_msgs::msg::dds_::JointAngles_"):
    """kinova_msgs/msg/JointAngles: degrees, or N·m on a topic of torques."""

    joint1: float32
    joint2: float32
    joint3: float32
    joint4: float32
    joint5: float32
    joint6: float32
    joint7: float32


# By what ROS 2 calls them.
WIRE_TYPES: dict[str, type[IdlStruct]] = {JOINT_STATE: JointState, JOINT_ANGLES: JointAngles}
