"""Options of a tuning by name: one list for the commands and for Python."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast, get_args

from analysis.registry import METHODS, kinds
from analysis.selection import Hints, Options, Selection
from recorders.simulators.arm.known_arms import name_alone
from recorders.simulators.balls import UNKNOWN_BALL, Ball, ball_named, contradict
from tunenet_logs.errors import UsageError
from tunenet_logs.formats.read_options import ReadingOptions, ReadOptions, reading_of
from tunenet_logs.regular_file import real_path
from tunenet_logs.terminal import short_name

if TYPE_CHECKING:
    from analysis.payload.arm_card import ArmCard
    from analysis.sysid.source import SimulatorSource
    from tunenet_logs.episode import Episode

AnyPath = str | PathLike[str]

PresetName = Literal["default", "paper", "paper-code"]
Gravity = Literal["included", "compensated"]
EffortSign = Literal["joint", "load"]

# Least, greatest and unit of each number that may be said.
RANGES: Mapping[str, tuple[float, float, str]] = {
    "start_s": (0.0, 1e9, "s"),
    "end_s": (0.0, 1e9, "s"),
    "height_m": (1e-3, 100.0, "m"),
    "ball_diameter_m": (0.001, 10.0, "m"),
    "ball_mass_kg": (0.0001, 1000.0, "kg"),
}

MAX_ITERATIONS = 1000


class TuneOptions(ReadingOptions, total=False):
    """Options of a tuning; each is the option of `tunenet-tune` of that name.

    Attributes:
        task: "drop" or "payload"; None to go by the log.
        preset: Simulator, observation and network: ours, or those of the paper's text or code.
        method: One of `analysis.registry.METHODS`; None for the preset's.
        iterations: Rollouts that the method may spend, 1 to 1000 (5).
        initial: Initial guess, one value per parameter; None for the method's own.
        weights: A file by `tunenet-train`; None for those that the package ships.
        topic: Channel of the log; None for the best.
        start_s: Start of the part to use [s since the log's first sample].
        end_s: End of the part to use [s since the log's first sample].
        height_m: Of the drop, for a log of impact times alone [m].
        roi: Left, top, width, height [px] of the image region in which the ball is.
        hsv: Lowest and highest hue (0 to 179), saturation and value (0 to 255) of the ball.
        ball_at: x, y [px] of the ball, and when [s since the first image].
        ball: A ball of known size and mass by its name, such as "table-tennis", or a `Ball`.
        ball_diameter_m: Diameter [m]; overrides that of the named ball.
        ball_mass_kg: Mass [kg], with the diameter.
        tares: Logs of the same arm with an empty gripper.
        arm: A known arm's name, such as "ur5e"; None to go by the log.
        urdf: A file of any other serial arm, with `tool_link`.
        tool_link: Link of that file in whose frame the payload is.
        gravity: Whether the arm's own weight is in the torques; None to go by the log.
        effort_sign: Whose the torques are, what the joint exerts or the load; None likewise.
        effort_unit: "N·m", or "A" for currents that `torque_constants` convert to torques.
        arm_card: File of what earlier runs identified of the arm.
        model: The user's own MuJoCo model, MJCF or URDF, to tune instead of an experiment.
        parameters: Parameters of it to tune, "KIND/NAME.FIELD" with "=LOW:HIGH" if the range is not
            the usual one, such as "joint/elbow.damping=0:5"; or YAML files with them.
        mapping: Names of the log to names of the model where they differ: a signal, a topic or
            "SIGNAL.COLUMN" -> "joint/NAME", "actuator/NAME", "body/NAME", "site/NAME" (with a "-"
            before it, a wrench of the other sign), "commands", "states", or "-" to leave it out.
    """

    task: str | None
    preset: PresetName
    method: str | None
    iterations: int
    initial: float | Sequence[float] | None
    weights: AnyPath | None
    topic: str | None
    start_s: float | None
    end_s: float | None
    height_m: float | None
    roi: tuple[int, int, int, int] | None
    hsv: tuple[tuple[int, int, int], tuple[int, int, int]] | None
    ball_at: tuple[float, float, float] | None
    ball: str | Ball | None
    ball_diameter_m: float | None
    ball_mass_kg: float | None
    tares: Sequence[AnyPath | Episode]
    arm: str | None
    urdf: AnyPath | None
    tool_link: str | None
    gravity: Gravity | None
    effort_sign: EffortSign | None
    effort_unit: str | None
    arm_card: AnyPath | None
    model: AnyPath | None
    parameters: Sequence[str] | None
    mapping: Mapping[str, str] | None


def options_of(given: TuneOptions, logs: Sequence[Path] = ()) -> Options:
    """Check named options, and build those of a tuning.

    Args:
        given: By name; missing ones and None are the defaults.
        logs: That will be tuned, which the arm card must not be from already.

    Raises:
        UsageError: There is no such option, or a value is invalid.
    """
    known = TuneOptions.__annotations__
    if unknown := [name for name in given if name not in known]:
        raise UsageError(f"there is no option {unknown[0]!r}; there is: {', '.join(known)}")
    said: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    for name, (low, high, unit) in RANGES.items():
        if name in said:
            said[name] = _number(name, said[name], low, high, unit)
    _check_choice("task", said, kinds())
    _check_choice("preset", said, get_args(PresetName))
    _check_choice("method", said, METHODS)
    _check_choice("gravity", said, get_args(Gravity))
    _check_choice("effort_sign", said, get_args(EffortSign))
    iterations = said.get("iterations", Options.iterations)
    if not isinstance(iterations, int) or not 1 <= iterations <= MAX_ITERATIONS:
        raise UsageError(f"iterations {iterations!r} is not a whole number from 1 to 1000")
    initial = said.get("initial")
    weights = said.get("weights")
    return Options(
        task=said.get("task"),
        preset=said.get("preset", "default"),
        iterations=iterations,
        initial=None if initial is None else _numbers("initial", initial),
        method=said.get("method"),
        weights=None if weights is None else Path(weights),
        selection=_selection(said, logs),
        source=_source(said),
    )


def _source(said: Mapping[str, Any]) -> SimulatorSource | None:
    """Return the user's own simulator, or None."""
    wanted = said.get("parameters") or ()
    if "model" not in said:
        for name, option in (("parameters", "--tune"), ("mapping", "--map")):
            if said.get(name):
                raise UsageError(f"{option} is about a model of one's own; name it with --model")
        return None
    if said.get("task") or said.get("preset", "default") != "default":
        raise UsageError("--model does not go with --task or --preset; leave them out")
    from analysis.sysid.parameter_file import listed_parameters
    from analysis.sysid.source import ModelSource

    wanted = (wanted,) if isinstance(wanted, str) else tuple(wanted)
    mapping = dict(said.get("mapping") or {})
    return ModelSource(Path(said["model"]), listed_parameters(wanted), mapping)


def _selection(said: Mapping[str, Any], logs: Sequence[Path]) -> Selection:
    start_s, end_s = said.get("start_s"), said.get("end_s")
    if start_s is not None and end_s is not None and start_s >= end_s:
        raise UsageError(f"--start {start_s:g} is not before --end {end_s:g}")
    if "hsv" in said and "ball_at" in said:
        raise UsageError("--hsv does not go with --ball-at; leave one out")
    tares = _tares(said.get("tares", ()))
    unit = effort_unit(said["effort_unit"]) if "effort_unit" in said else None
    reading, constants = _of_efforts(reading_of(cast("ReadingOptions", said)), unit)
    return Selection(
        said.get("topic"),
        start_s,
        end_s,
        Hints(said.get("roi"), said.get("hsv"), said.get("ball_at")),
        _ball(said),
        tares,
        _arm(said),
        said.get("height_m"),
        said.get("gravity"),
        said.get("effort_sign"),
        unit,
        constants,
        _card(said.get("arm_card"), [*logs, *(one for one in tares if isinstance(one, Path))]),
        reading,
    )


def effort_unit(text: str) -> str:
    """Parse the unit of torques: N·m in one of its spellings, or A.

    Raises:
        UsageError: It is neither.
    """
    unit = "N·m" if text in ("N·m", "Nm", "N.m", "N*m") else text
    if unit not in ("N·m", "A"):
        raise UsageError(f"{short_name(text)!r} is neither N·m (or Nm) nor A")
    return unit


def _of_efforts(reading: ReadOptions, unit: str | None) -> tuple[ReadOptions, tuple[float, ...]]:
    """Return how to read a log, and the torque constants [N·m/A] if its efforts are currents.

    If they are, the constants are theirs, and none of a table's currents.
    """
    if unit != "A":
        return reading, ()
    if not reading.torque_constants:
        raise UsageError(
            "--effort-unit A needs each joint's torque for each A; add --torque-constants K1,K2,..."
        )
    return replace(reading, torque_constants=()), reading.torque_constants


def _ball(said: Mapping[str, Any]) -> Ball:
    """Return the ball; measured values override the table."""
    named = said.get("ball", UNKNOWN_BALL)
    ball = named if isinstance(named, Ball) else ball_named(named)
    diameter_m, mass_kg = said.get("ball_diameter_m"), said.get("ball_mass_kg")
    if diameter_m is not None:
        ball = replace(ball, diameter_m=diameter_m, mass_kg=None if mass_kg else ball.mass_kg)
    if mass_kg is not None:
        if ball.diameter_m is None:
            raise UsageError(
                "--ball-mass says nothing without the ball's size; add --ball-diameter"
            )
        ball = replace(ball, mass_kg=mass_kg)
    return ball


def ball_doubts(given: TuneOptions, ball: Ball) -> tuple[str, ...]:
    """Describe what is odd about the stated ball.

    Args:
        given: As to `options_of`, which does not refuse it.
        ball: That it made of it.
    """
    doubts: list[str] = []
    named = given.get("ball")
    measured = Ball(given.get("ball_diameter_m"), given.get("ball_mass_kg"))
    if isinstance(named, str) and contradict(measured, ball_named(named)):
        known = ball_named(named).words
        doubts.append(f"the ball {named} has {known}; what was measured is used")
    if ball.is_denser_than_metal:
        doubts.append(
            f"a ball of {ball.diameter_m:g} m and {ball.mass_kg:g} kg is denser than any metal; "
            "--ball-mass is in kg"
        )
    return tuple(doubts)


def _tares(tares: Sequence[AnyPath | Episode]) -> tuple[Path | Episode, ...]:
    """Return the empty runs; refuse one that is named twice."""
    runs = tuple(Path(tare) if isinstance(tare, str | PathLike) else tare for tare in tares)
    found: set[Path] = set()
    for run in runs:
        if isinstance(run, Path):
            if real_path(run) in found:
                raise UsageError(f"--tare {run} is named twice; name each empty run once")
            found.add(real_path(run))
    return runs


def _arm(said: Mapping[str, Any]) -> str | tuple[Path, str] | None:
    """Return the arm's name, or its URDF and the link; None to go by the log."""
    urdf, link = said.get("urdf"), said.get("tool_link")
    urdf = None if urdf is None else Path(urdf)
    if "arm" in said:
        return name_alone(said["arm"], urdf, link)
    if (urdf is None) != (link is None):
        missing = "--tool-link" if link is None else "--urdf"
        raise UsageError(f"--urdf and --tool-link go together; add {missing}")
    return None if urdf is None or link is None else (urdf, link)


def _card(file: AnyPath | None, runs: Sequence[Path]) -> ArmCard | None:
    """Read the arm card, which must be from other runs than these."""
    if file is None:
        return None
    from analysis.payload.arm_card import read_arm_card
    from analysis.result_files import log_sha256

    card = read_arm_card(Path(file))
    for run in runs:
        with suppress(OSError):  # reading it says why in our own words
            card.check_new(run, log_sha256(run))
    return card


def _check_choice(name: str, said: Mapping[str, Any], choices: Iterable[str]) -> None:
    if name in said and said[name] not in choices:
        value = short_name(said[name])
        raise UsageError(f"{name} {value!r} is not known; choose one of: {', '.join(choices)}")


def _number(name: str, value: Any, low: float, high: float, unit: str) -> float:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or not low <= value <= high:
        raise UsageError(f"{name} {value!r} is not a number from {low:.15g} to {high:.15g} {unit}")
    return float(value)


def _numbers(name: str, given: float | Sequence[float]) -> tuple[float, ...]:
    values = (given,) if isinstance(given, int | float) else tuple(given)
    if not all(isinstance(value, int | float) and math.isfinite(value) for value in values):
        raise UsageError(f"{name} {given!r} are no numbers")
    return tuple(map(float, values))
