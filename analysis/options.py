"""Options of a tuning, each declared once, and options that commands share.

The fields of `TuneOptions` are the arguments of `tunenet-tune` and of `tunenet_logs.tune`. The
digest that tells whether a log must be tuned again, the provenance in a record, the warning that an
option is not used and docs/options.md follow from them.
"""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

from tunenet_logs.console import CheckedOptions, made_of, numbers, option, whole
from tunenet_logs.errors import UsageError
from tunenet_logs.files import real_path
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.recorders.simulators.arm.known import ARMS, DEFAULT, name_alone
from tunenet_logs.recorders.simulators.known import (
    BALLS,
    UNKNOWN_BALL,
    Ball,
    ball_named,
    contradict,
)
from tunenet_logs.terminal import short_name

if TYPE_CHECKING:
    from tunenet_logs.analysis.payload.arm_card import ArmCard
    from tunenet_logs.analysis.sysid.source import SimulatorSource
    from tunenet_logs.episode import Episode

AnyPath = str | PathLike[str]

# What options are about: an experiment, or a method of estimation, says which of them it uses.
Subject = Literal["pictures", "ball", "height", "lengths", "arm", "network", "start", "rollouts"]

Gravity = Literal["included", "compensated"]
EffortSign = Literal["joint", "load"]

_REGISTRY = "tunenet_logs.analysis.registry"  # it knows experiments, which know these options


# ---- Values as texts: argparse types


_MAX_PX = 1e6  # more than any picture has; of a place and a time, too

_vector = numbers(0, 0, _MAX_PX, "a number, or some with commas between them")
_place = numbers(3, 0, _MAX_PX, "a place and time X,Y,S, such as 310,95.5,1.2")


def _box(text: str) -> tuple[int, ...]:
    values = numbers(4, 0, _MAX_PX, "a box X,Y,W,H of whole pixels, such as 400,0,500,1080")(text)
    if any(value != int(value) for value in values) or not values[2] or not values[3]:
        raise argparse.ArgumentTypeError(f"{text!r} is not a box of whole pixels")
    return tuple(int(value) for value in values)


def _hsv(text: str) -> tuple[tuple[int, ...], ...]:
    what = "a range H,S,V:H,S,V, such as 5,120,80:20,255,255"
    try:
        low, high = map(numbers(3, 0, _MAX_PX, what), text.split(":"))
    except (ValueError, argparse.ArgumentTypeError) as error:
        raise argparse.ArgumentTypeError(f"{text!r} is not {what}") from error
    most = (179, 255, 255)
    if any(value > top for end in (low, high) for value, top in zip(end, most, strict=True)):
        raise argparse.ArgumentTypeError(f"{text!r}: hue goes to 179, saturation and value to 255")
    return tuple(int(value) for value in low), tuple(int(value) for value in high)


def _effort_unit(text: str) -> str:
    unit = "N·m" if text in ("N·m", "Nm", "N.m", "N*m") else text
    if unit not in ("N·m", "A"):
        raise argparse.ArgumentTypeError(f"{short_name(text)!r} is neither N·m (or Nm) nor A")
    return unit


def parse_mapping(texts: Sequence[str]) -> dict[str, str]:
    """Parse `--map` options, SIGNAL=TARGET."""
    mapping: dict[str, str] = {}
    for text in texts:
        key, sign, target = text.partition("=")
        if not (key and sign and target):
            raise UsageError(f"--map {text!r} is no SIGNAL=TARGET", "such as /arm/j1=joint/elbow")
        if key in mapping:
            raise UsageError(f"--map {key} is given twice", "leave one out")
        mapping[key] = target
    return mapping


# ---- Options of a tuning


RUN = re.compile(r"(run|episode|demo):0*(\d+)")  # how `hold_out` names one in a log
_of_pictures = partial(option, group="drop", subject="pictures")
_of_ball = partial(option, group="drop", subject="ball")
_of_arm = partial(option, group="payload", subject="arm")
_of_model = partial(option, group="model")
_of_method = partial(option, group="method")


@dataclass(frozen=True)
class Hints(CheckedOptions):
    """Hints on the ball in images; none is needed."""

    roi: tuple[int, int, int, int] | None = _of_pictures(
        "look for the ball in this box only [px]: left, top, width, height",
        metavar="X,Y,W,H",
        parse=_box,
    )
    hsv: tuple[tuple[int, int, int], tuple[int, int, int]] | None = _of_pictures(
        "its colour as H,S,V:H,S,V, lowest and highest; hue 0 to 179 (170 to 10 is red), "
        "saturation and value 0 to 255",
        metavar="RANGE",
        parse=_hsv,
    )
    ball_at: tuple[float, float, float] | None = _of_pictures(
        "where it is seen moving [px], and when [s since the first picture]",
        metavar="X,Y,S",
        parse=_place,
    )


@dataclass(frozen=True, kw_only=True)
class TuneOptions(Hints, ReadOptions):
    """Options of a tuning: those of `tunenet-tune`, by their names in Python."""

    task: str | None = option(
        "what the log shows (default: what it says itself, or what is in it)",
        choices=f"{_REGISTRY}:kinds",
    )
    topic: str | None = option(
        "channel with the ball's position or pictures, or with torques (default: /ball/pose, one "
        "named like a ball, else the first that shows it)"
    )
    start_s: float | None = option(
        "leave out what comes before [s since the first sample]", limits=(0.0, 1e9, "s")
    )
    end_s: float | None = option(
        "leave out what comes after [s]", flag="--end", metavar="S", limits=(0.0, 1e9, "s")
    )
    height_m: float | None = option(
        "of the drop, where a log holds impact times alone [m]",
        group="drop",
        subject="height",
        limits=(1e-3, 100.0, "m"),
    )
    ball: str | Ball | None = _of_ball(
        f"a ball of known size and mass: {', '.join(BALLS)}", metavar="NAME", offered=BALLS
    )
    ball_diameter_m: float | None = _of_ball(
        "of the ball [m], also in place of a named one's; lets the frame rate be checked, too",
        limits=(0.001, 10.0, "m"),
    )
    ball_mass_kg: float | None = _of_ball(
        "of the ball [kg], with its diameter: what the air does to it follows",
        limits=(0.0001, 1000.0, "kg"),
    )
    tares: tuple[Path | Episode, ...] = _of_arm(
        "a run of the same arm with nothing in its gripper, best along the same motion: what "
        "friction, offsets and the model's errors do is then known. May be given several times",
        (),
        flag="--tare",
        metavar="LOG",
        is_many=True,
        parse=Path,
    )
    arm_card: ArmCard | None = _of_arm(
        "what earlier runs of the same arm said of its friction, sensors and links, as "
        "--save-arm-card wrote it; with and without --tare",
        metavar="FILE",
        parse=Path,
    )
    arm: str | None = _of_arm(
        f"whose torques these are: {', '.join(ARMS)} (default: as the joints' names say, else "
        f"{DEFAULT})",
        metavar="NAME",
        offered=ARMS,
    )
    urdf: Path | None = _of_arm("any other serial arm", metavar="FILE", parse=Path)
    tool_link: str | None = _of_arm(
        "the link of that URDF in whose frame the payload is", metavar="NAME"
    )
    gravity: Gravity | None = _of_arm(
        "whether the arm's own weight is in the torques (default: as the log shows)",
        choices=get_args(Gravity),
    )
    effort_sign: EffortSign | None = _of_arm(
        "whose torques these are: what the joint exerts, or the load, the opposite (default: "
        "as the log shows)",
        choices=get_args(EffortSign),
    )
    effort_unit: str | None = _of_arm(
        "of the torques; with A they are currents, and --torque-constants makes them torques: "
        "one number a joint from base to tool, or one for all (default: N·m)",
        metavar="{N·m,A}",
        parse=_effort_unit,
    )
    model: Path | None = _of_model(
        "tune this model, MJCF or URDF, in place of a ball or a payload", metavar="FILE", parse=Path
    )
    parameters: tuple[str, ...] = _of_model(
        "what of it, with the range to look in (default: a fifth to five times the model's "
        "value): joint/NAME.damping, .frictionloss, .armature, .stiffness, .springref; "
        "body/NAME.mass, .ipos[i], .inertia[i], .spread[i], .inertial; geom/NAME.friction[i], "
        ".solref[i], .solimp[i]; of sensors: joint/NAME.effort_gain, .effort_offset, "
        "site/NAME.force_offset[i], .torque_offset[i], delay/efforts, /poses, /wrenches; "
        "actuator/NAME.kp, .kv, .gear[i], .forcerange; actuators: all that its servos have, as far "
        "as the log tells it; tendon/NAME.damping, .frictionloss, .stiffness; "
        "option.gravity[i], .density, .viscosity; delay/commands; or a YAML file with ADDRESS: "
        "[LOW, HIGH] lines. May be given several times",
        (),
        flag="--tune",
        metavar="ADDRESS[=LOW:HIGH]",
        is_many=True,
    )
    mapping: Mapping[str, str] = _of_model(
        "what of the log is what of the model, where their names differ: a topic, a signal or "
        "SIGNAL.COLUMN, and joint/NAME, actuator/NAME, body/NAME, site/NAME (with a - before it, "
        "such as -site/NAME: a wrench of the child on its parent), commands, states, or - to leave "
        "it out. May be given several times",
        dict,
        flag="--map",
        metavar="SIGNAL=TARGET",
        is_many=True,
    )
    together: tuple[Path | Episode, ...] | None = _of_model(
        "take the logs, and the episodes or runs in each, for runs of one machine, and tune one "
        "set of values to all, each with its own start: one result, under the first log's name (in "
        "Python: the other logs, () for none)",
        metavar="LOG",
        is_many=True,
        parse=Path,
    )
    hold_out: Path | Episode | None = _of_model(
        "judge the values by another run of the machine, which they are not fitted to: a log, or "
        "a run in the first one, such as episode:7 or run:2 (default: by the last 40 % of the time "
        "of each log)",
        metavar="LOG",
        parse=Path,
    )
    preset: str = _of_method(
        "simulator, observation and network: ours, or those of the paper's text or code",
        "default",
        choices=("default", "paper", "paper-code"),
    )
    method: str | None = _of_method(
        "how the parameters are estimated: the network's steps and the exact fit after them "
        "(tunenet+refine, the default of the preset default), the steps alone (tunenet), the fit "
        "alone (fit), or by rollouts alone, as all others of {choices}. Only fits give an interval",
        metavar="NAME",
        choices=f"{_REGISTRY}:METHODS",
    )
    iterations: int = _of_method(
        "rollouts that the method may spend, before those that check its answer (default: 5)",
        5,
        subject="rollouts",
        metavar="K",
        limits=(1, 1000, ""),
        is_whole=True,
    )
    initial: tuple[float, ...] | None = _of_method(
        "restitution or mass [kg] to start from, one value a parameter (default with a "
        "network: 0, a ball that does not bounce; 0.5 kg; without: the middle of the range)",
        subject="start",
        metavar="X[,Y,...]",
        parse=_vector,
    )
    weights: Path | None = _of_method(
        "weights by tunenet-train (default: shipped)", subject="network", metavar="FILE", parse=Path
    )
    source: SimulatorSource | None = None  # of `model`, or of a simulator that Python gives

    def __post_init__(self) -> None:
        if not isinstance(self.mapping, Mapping):
            object.__setattr__(self, "mapping", parse_mapping(self.mapping))
        super().__post_init__()
        if self.initial is not None:
            given = self.initial
            values = (given,) if isinstance(given, int | float) else tuple(given)
            if not all(isinstance(value, int | float) and math.isfinite(value) for value in values):
                raise UsageError(f"initial {given!r} are no numbers")
            object.__setattr__(self, "initial", tuple(map(float, values)))
        if self.start_s is not None and self.end_s is not None and self.start_s >= self.end_s:
            raise UsageError(f"--start {self.start_s:g} is not before --end {self.end_s:g}")
        if self.hsv is not None and self.ball_at is not None:
            raise UsageError("--hsv does not go with --ball-at; leave one out")
        if self.effort_unit == "A" and not self.torque_constants:
            what = "--effort-unit A needs each joint's torque for each A"
            raise UsageError(what, "add --torque-constants K1,K2,...")
        _ = self.given_ball  # there is such a ball
        if isinstance(arm := self.given_arm, str):
            object.__setattr__(self, "arm", arm)  # as it is spelled here
        _check_once("--tare ", self.tares, "empty run")
        _check_once("", (*(self.together or ()), self.hold_out), "run of the machine")
        if self.model is None:
            for name, flag in (("parameters", "--tune"), ("mapping", "--map")):
                if getattr(self, name):
                    raise UsageError(f"{flag} is about a model of one's own; name it with --model")
        elif self.task or self.preset != "default":
            raise UsageError("--model does not go with --task or --preset; leave them out")

    @property
    def hints(self) -> Hints:
        """Those on the ball in images."""
        return Hints(self.roi, self.hsv, self.ball_at)

    @property
    def reading(self) -> ReadOptions:
        """How to read the log and its tares."""
        constants = () if self.effort_constants else self.torque_constants
        return ReadOptions(self.columns, self.fps, self.length_unit, self.angle_unit, constants)

    @property
    def effort_constants(self) -> tuple[float, ...]:
        """Torque for each A of efforts that are currents [N·m/A], joint by joint; else none."""
        return self.torque_constants if self.effort_unit == "A" else ()

    @property
    def given_ball(self) -> Ball:
        """The ball, by name and measure: what is measured overrides the table."""
        named = UNKNOWN_BALL if self.ball is None else self.ball
        ball = named if isinstance(named, Ball) else ball_named(named)
        diameter_m, mass_kg = self.ball_diameter_m, self.ball_mass_kg
        if diameter_m is not None:
            ball = replace(ball, diameter_m=diameter_m, mass_kg=None if mass_kg else ball.mass_kg)
        if mass_kg is None:
            return ball
        if ball.diameter_m is None:
            what = "--ball-mass says nothing without the ball's size"
            raise UsageError(what, "add --ball-diameter")
        return replace(ball, mass_kg=mass_kg)

    @property
    def given_arm(self) -> str | tuple[Path, str] | None:
        """The arm's name, or its URDF and the link that holds the payload; None: by the log."""
        urdf, link = self.urdf, self.tool_link
        if self.arm is not None:
            return name_alone(self.arm, urdf, link)
        if (urdf is None) != (link is None):
            missing = "--tool-link" if link is None else "--urdf"
            raise UsageError(f"--urdf and --tool-link go together; add {missing}")
        return None if urdf is None or link is None else (urdf, link)

    @property
    def ball_doubts(self) -> tuple[str, ...]:
        """What is odd about the stated ball, which is not refused for it."""
        doubts: list[str] = []
        measured, ball = Ball(self.ball_diameter_m, self.ball_mass_kg), self.given_ball
        if isinstance(self.ball, str) and contradict(measured, ball_named(self.ball)):
            known = ball_named(self.ball).words
            doubts.append(f"the ball {self.ball} has {known}; what was measured is used")
        if ball.is_denser_than_metal:
            doubts.append(
                f"a ball of {ball.diameter_m:g} m and {ball.mass_kg:g} kg is denser than any "
                "metal; --ball-mass is in kg"
            )
        return tuple(doubts)

    @property
    def provenance(self) -> dict[str, Any]:
        """Options with another value than usual, as JSON values; files by their names."""
        names = [name for name in self.given().values() if name not in _LOGS]
        found = {name: _as_json(getattr(self, name)) for name in names}
        return found if self.source is None else {**found, **self.source.told_as()}


def _check_once(option: str, logs: Sequence[Path | Episode | None], what: str) -> None:
    """Raise UsageError where a log is named twice."""
    runs = [run for run in logs if isinstance(run, Path)]
    for at, run in enumerate(runs):
        if real_path(run) in map(real_path, runs[:at]):
            raise UsageError(f"{option}{run} is named twice; name each {what} once")


_LOGS = ("tares", "together", "hold_out")  # options that name other logs


def _as_json(value: Any) -> Any:
    if isinstance(value, Path):
        return value.name
    if isinstance(value, Ball):
        return {part.name: getattr(value, part.name) for part in fields(value)}
    if hasattr(value, "runs"):  # an arm card
        return {"file": value.file, "logs": [run["log"] for run in value.runs]}
    return dict(value) if isinstance(value, Mapping) else value


def options_of(given: Mapping[str, Any], logs: Sequence[Path] = ()) -> TuneOptions:
    """Check named options, and read the files that they name."""
    options = made_of(TuneOptions, given)
    if options.model is not None:
        from tunenet_logs.analysis.sysid.source import ModelSource, listed_parameters

        wanted = listed_parameters(options.parameters)
        options = replace(options, source=ModelSource(options.model, wanted, options.mapping))
    if isinstance(file := options.arm_card, Path):  # what it holds is read once, for all logs
        from tunenet_logs.analysis.payload.arm_card import read_arm_card
        from tunenet_logs.analysis.result_files import log_sha256

        card = read_arm_card(file)
        for run in (*logs, *(tare for tare in options.tares if isinstance(tare, Path))):
            with suppress(OSError):  # reading it says why in our own words
                card.check_new(run, log_sha256(run))
        options = replace(options, arm_card=card)
    return options


# ---- Options that commands share


def jobs_option(parser: argparse._ActionsContainer, what: str) -> None:
    """Add `--jobs`: `what` at a time."""
    parser.add_argument(
        "--jobs", type=whole(1, 256), metavar="N", help=f"{what} (default: all cores)"
    )


def json_option(group: argparse._ActionsContainer, what: str, *names: str) -> None:
    """Add `--json`: `what` to a file, or to standard output."""
    group.add_argument(
        *names,
        "--json",
        type=Path,
        metavar="FILE",
        help=f"{what} to FILE, or with - to standard output in place of all else",
    )


def ray_option(parser: argparse._ActionsContainer, what: str) -> None:
    """Add `--ray`: `what` on a cluster."""
    parser.add_argument(
        "--ray",
        nargs="?",
        const="local",
        type=_cluster,
        metavar="ADDRESS",
        help=f"{what} on a Ray cluster, by its head's address HOST:PORT, or auto; without one, on "
        "a cluster that is started here",
    )


def _cluster(text: str) -> str:
    """Parse the address of a Ray cluster; refuse a log behind `--ray`."""
    host, _, port = text.removeprefix("ray://").rpartition(":")
    if text not in ("local", "auto") and not (host and port.isdecimal()):
        raise argparse.ArgumentTypeError(f"{text!r} is no HOST:PORT; write logs before --ray")
    return text
