"""SDF for Gazebo: a world with the ball and a ground, or a payload's model."""

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

NAME, SUFFIX, LIBRARY = "sdf", ".sdf", None
STEP_S = 0.001  # Gazebo's own
_WARNINGS = (
    "Gazebo: how the coefficients of a pair combine is not documented. DART multiplies them, ODE",
    "takes the smaller one; with 1 for the ground both give the ball's. DART takes them into",
    "account since gz-physics 2 (Citadel). This file has not been run in Gazebo by its writer.",
)

_BALL = """\
<?xml version="1.0"?>
{head}
<sdf version="1.7">
  <world name="drop">
    <!-- Standard gravity, which the tuning assumed too. -->
    <gravity>0 0 -9.80665</gravity>
    <physics name="drop" type="ignored">
      <!-- The ball sinks in by speed times step: longer steps are less exact. -->
      <max_step_size>{step}</max_step_size>
      <real_time_factor>1</real_time_factor>
    </physics>
    <model name="ground">
      <static>true</static>
      <link name="ground">
        <collision name="surface">
          <geometry>
            <plane><normal>0 0 1</normal><size>10 10</size></plane>
          </geometry>
          <surface>
            <bounce>
              <!-- 1: the pair then has the ball's. The default, 0, would take every bounce. -->
              <restitution_coefficient>1</restitution_coefficient>
              <!-- Slower impacts do not bounce; the default of 100000 m/s is all of them. -->
              <threshold>{threshold}</threshold>
            </bounce>
          </surface>
        </collision>
      </link>
    </model>
    <!-- For a world of your own copy this model, and give your ground the bounce above. -->
    <model name="ball">
      <!-- The recorded drop: the gap under the ball, and its radius. -->
      <pose>0 0 {centre} 0 0 0</pose>
      <link name="ball">
        <!-- A solid ball: 2/5 m r^2. -->
        <inertial>
          <mass>{mass}</mass>
          <inertia>
            <ixx>{moment}</ixx><ixy>0</ixy><ixz>0</ixz>
            <iyy>{moment}</iyy><iyz>0</iyz><izz>{moment}</izz>
          </inertia>
        </inertial>
        <!-- Damping is a drag; what the restitution here stands for has it already. -->
        <velocity_decay><linear>0</linear><angular>0</angular></velocity_decay>
        <collision name="surface">
          <geometry>
            <sphere><radius>{radius}</radius></sphere>
          </geometry>
          <surface>
            <bounce>
              <!-- The tuned one. -->
              <restitution_coefficient>{restitution}</restitution_coefficient>
              <!-- Slower impacts do not bounce; the default of 100000 m/s is all of them. -->
              <threshold>{threshold}</threshold>
            </bounce>
          </surface>
        </collision>
        <visual name="surface">
          <geometry>
            <sphere><radius>{radius}</radius></sphere>
          </geometry>
        </visual>
      </link>
    </model>
  </world>
</sdf>
"""

_PAYLOAD = """\
<?xml version="1.0"?>
{head}
<sdf version="1.7">
  <!-- To mount it: include this model in the arm's, and join it to the tool frame with
       <joint name="payload_mount" type="fixed">
         <parent>THE ARM'S TOOL FRAME</parent> <child>payload::payload</child>
       </joint> -->
  <model name="payload">
    <link name="payload">
      <inertial>
        <!-- The centre of mass in the tool frame; the inertia is about it. -->
        <pose>{x} {y} {z} 0 0 0</pose>
        <mass>{mass}</mass>
        <inertia>
          <ixx>{xx}</ixx><ixy>{xy}</ixy><ixz>{xz}</ixz>
          <iyy>{yy}</iyy><iyz>{yz}</iyz><izz>{zz}</izz>
        </inertia>
      </inertial>
      <!-- No shape: nothing of it collides. -->
    </link>
  </model>
</sdf>
"""

_MIN_BOUNCE_SPEED_M_S = 0.01  # slower impacts do not bounce: after a fall of 5 micrometres


def ball_text(ball: ExportedBall) -> str:
    """See `ExportFormat`."""
    return _BALL.format(
        head=xml_comment([*ball_lines(ball), *one_restitution_lines(ball), *_WARNINGS]),
        step=repr(STEP_S if ball.step_s is None else ball.step_s),
        centre=repr(ball.radius_m.value + ball.drop_height_m.value),
        mass=repr(ball.mass_kg.value),
        moment=repr(ball.moment_kg_m2),
        radius=repr(ball.radius_m.value),
        restitution=repr(ball.restitution),
        threshold=repr(_MIN_BOUNCE_SPEED_M_S),
    )


def payload_text(payload: ExportedPayload) -> str:
    """See `ExportFormat`."""
    return payload_model(xml_comment(payload_lines(payload)), payload.inertial)


def payload_model(head: str, weight: Inertial) -> str:
    """Return a payload's model, which every reader of SDF understands."""
    x, y, z = (repr(part) for part in weight.com_m)
    xx, xy, xz, yy, yz, zz = (repr(moment) for moment in weight.inertia_kg_m2)
    moments = {"xx": xx, "xy": xy, "xz": xz, "yy": yy, "yz": yz, "zz": zz}
    return _PAYLOAD.format(head=head, mass=repr(weight.mass_kg), x=x, y=y, z=z, **moments)
