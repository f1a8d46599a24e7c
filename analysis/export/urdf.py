"""URDF: a ball's link with its restitution, or a payload's with its inertia."""

from __future__ import annotations

from tunenet_logs.analysis.export.exported import (
    ExportedBall,
    ExportedPayload,
    ball_lines,
    one_restitution_lines,
    payload_lines,
    xml_comment,
)
from tunenet_logs.recorders.simulators.arm.description import Inertial

NAME, SUFFIX, STEP_S, LIBRARY = "urdf", ".urdf", None, None

_BALL = """\
<?xml version="1.0"?>
{head}
<robot name="ball">
  <link name="ball">
    <!-- A link without <inertial> weighs 1 kg in PyBullet. A solid ball: 2/5 m r^2. -->
{inertial}
    <visual>
      <geometry>
        <sphere radius="{radius}"/>
      </geometry>
    </visual>
    <!-- The shape that touches: a true sphere, no mesh. -->
    <collision>
      <geometry>
        <sphere radius="{radius}"/>
      </geometry>
    </collision>
    <!-- Bullet's own element, which other readers of URDF pass over: Gazebo wants it in SDF. -->
    <contact>
      <!-- Bullet multiplies it by the floor's, which is 0 by default: set the floor's to 1. -->
      <restitution value="{restitution}"/>
    </contact>
  </link>
</robot>
"""

_PAYLOAD = """\
<?xml version="1.0"?>
{head}
<robot name="payload">
  <!-- To mount it: copy this link into the arm's URDF, with
       <joint name="payload_mount" type="fixed">
         <parent link="THE ARM'S TOOL FRAME"/> <child link="payload"/>
       </joint> -->
  <link name="payload">
    <!-- PyBullet takes the inertia from the shapes unless it is loaded with
         URDF_USE_INERTIA_FROM_FILE. There is no shape: nothing collides. -->
{inertial}
  </link>
</robot>
"""


def ball_text(ball: ExportedBall) -> str:
    """See `ExportFormat`."""
    head = xml_comment([*ball_lines(ball), *one_restitution_lines(ball)])
    moment = ball.moment_kg_m2
    weight = Inertial(ball.mass_kg.value, (0.0, 0.0, 0.0), (moment, 0.0, 0.0, moment, 0.0, moment))
    return _BALL.format(
        head=head,
        inertial=_inertial(weight),
        radius=repr(ball.radius_m.value),
        restitution=repr(ball.restitution),
    )


def payload_text(payload: ExportedPayload) -> str:
    """See `ExportFormat`."""
    head = xml_comment(payload_lines(payload))
    return _PAYLOAD.format(head=head, inertial=_inertial(payload.inertial))


def _inertial(weight: Inertial) -> str:
    x, y, z = weight.com_m
    xx, xy, xz, yy, yz, zz = weight.inertia_kg_m2
    return f"""\
    <inertial>
      <!-- The centre of mass; the inertia is about it. -->
      <origin xyz="{x!r} {y!r} {z!r}" rpy="0 0 0"/>
      <mass value="{weight.mass_kg!r}"/>
      <inertia ixx="{xx!r}" ixy="{xy!r}" ixz="{xz!r}" iyy="{yy!r}" iyz="{yz!r}" izz="{zz!r}"/>
    </inertial>"""
