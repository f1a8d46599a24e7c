"""Read and write a bounce shot's rig as a small YAML file that a person edits."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from recorders.simulators.shot.rig import NULLABLE, Hoop, Plane, Release, ShotBall, ShotRig
from tunenet_logs.errors import UsageError
from tunenet_logs.small_files import read_small_file
from tunenet_logs.terminal import one_line, short_name

# Ten times what a rig takes, and more than it has: YAML reads nested ones in quadratic time.
_MAX_BYTES, _MAX_BRACKETS = 20_000, 64

_PARTS: Mapping[str, type] = {"ball": ShotBall, "plane": Plane, "hoop": Hoop, "release": Release}
_GRAVITY = "gravity_m_s2"

_TEXT = """\
# The rig of a bounce shot. Lengths in m, from the impact point: where the ball touches the plane.
# What is left out is as here.
ball:
  radius_m: {ball[radius_m]}
  mass_kg: {ball[mass_kg]}            # for the air's drag; null leaves the air out
  drag_coefficient: {ball[drag_coefficient]}
  inertia_share: {ball[inertia_share]}       # over m r^2: 0.4 solid, 0.667 a thin shell
  drag_1_m: {ball[drag_1_m]}           # measured [1/m]; null: by size, mass and drag_coefficient
plane:
  incline_deg: {plane[incline_deg]}        # from the horizontal, down towards the hoop
  downhill_m: {plane[downhill_m]}         # from the impact point to its lower edge, along its slope
  friction: {plane[friction]}
hoop:                      # horizontal
  forward_m: {hoop[forward_m]}          # its centre, horizontally
  up_m: {hoop[up_m]}               # negative: below the impact point
  free_radius_m: {hoop[free_radius_m]}     # of the opening
  rim_m: {hoop[rim_m]}             # how thick the rim is
  restitution: {hoop[restitution]}         # of the ball on the rim
  friction: {hoop[friction]}
release:                   # how far the ball falls until it touches the plane
  lowest_m: {release[lowest_m]}
  highest_m: {release[highest_m]}
  height_sd_m: {release[height_sd_m]}       # how well the robot keeps a height
gravity_m_s2: {gravity_m_s2}
"""


def rig_text(rig: ShotRig) -> str:
    """Format the rig as a commented file."""
    told = asdict(rig)
    told["ball"] = {key: "null" if one is None else one for key, one in told["ball"].items()}
    return _TEXT.format(**told)


def read_rig(path: Path) -> ShotRig:
    """Read a rig from a file; the default rig's values replace missing ones.

    Raises:
        UsageError: cannot be read, is no YAML, or holds an invalid value; names file and value.
    """
    try:
        data = read_small_file(path, _MAX_BYTES)
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror}); give --rig a file") from error
    except ValueError as error:
        raise UsageError(
            f"{path}: {error}, and no rig's file is; give --rig such a file"
        ) from error
    try:
        return _rig_of(_loaded(data))
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from error


def _loaded(data: bytes) -> Any:
    """Load the YAML; the safe loader makes plain values only."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    told = b"".join(line.partition(b"#")[0] for line in data.split(b"\n"))
    if sum(map(told.count, (b"[", b"{"))) > _MAX_BRACKETS:
        raise UsageError(f"over {_MAX_BRACKETS} brackets; see tunenet-plan --save-rig for a rig")
    if any(mark in told for mark in (b"&", b"*", b"!")):
        raise UsageError("holds &, * or !, which a rig's YAML does without; remove them")
    try:
        return YAML(typ="safe", pure=True).load(io.StringIO(data.decode("utf-8")))
    except (YAMLError, ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        where = "" if mark is None else f" in line {mark.line + 1}"
        what = getattr(error, "problem", None) or type(error).__name__
        raise UsageError(
            f"no YAML{where} ({one_line(what)}); see tunenet-plan --save-rig"
        ) from error


def _rig_of(told: Any) -> ShotRig:
    values = _mapping(told, "the file", [*_PARTS, _GRAVITY])
    given: dict[str, Any] = {}
    for name, kind in _PARTS.items():
        if name in values:
            known = [item.name for item in fields(kind)]
            part = _mapping(values[name], name, known)
            given[name] = kind(**{key: _number(f"{name}.{key}", one) for key, one in part.items()})
    if _GRAVITY in values:
        given[_GRAVITY] = _number(_GRAVITY, values[_GRAVITY])
    return ShotRig(**given)


def _mapping(told: Any, what: str, known: list[str]) -> dict[str, Any]:
    if told is None:
        return {}
    if not isinstance(told, dict):
        raise UsageError(f"{what} is not a list of names with values; there is: {', '.join(known)}")
    for key in told:
        if key not in known:
            raise UsageError(
                f"{short_name(key)} is nothing of {what}; there is: {', '.join(known)}"
            )
    return told


def _number(name: str, value: Any) -> float | None:
    if value is None and name in NULLABLE:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise UsageError(f"{name} {short_name(value)} is not a number")
    try:
        return float(value)
    except OverflowError as error:
        raise UsageError(f"{name} is not a number of this size") from error
