"""Options of a tuning: for Python, for the commands that share them, and all of tunenet-tune's.

`TuneOptions` has each by its name; `options_of` checks them, for Python and for the command alike.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast, get_args

from tunenet_logs.analysis.registry import METHODS, kinds
from tunenet_logs.analysis.selection import Hints, Options, Selection
from tunenet_logs.console import Parser, number, offering, whole
from tunenet_logs.errors import UsageError
from tunenet_logs.files import real_path
from tunenet_logs.formats.options import ReadingOptions, ReadOptions, reading_of, reading_options
from tunenet_logs.recorders.simulators.arm.known import ARMS, DEFAULT, name_alone
from tunenet_logs.recorders.simulators.known import (
    BALLS,
    UNKNOWN_BALL,
    Ball,
    ball_named,
    contradict,
    engine_option,
)
from tunenet_logs.terminal import short_name

if TYPE_CHECKING:
    from tunenet_logs.analysis.payload.arm_card import ArmCard
    from tunenet_logs.analysis.sysid.source import SimulatorSource
    from tunenet_logs.episode import Episode


# ---- Options by name: one list for the commands and for Python.

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
        method: One of `tunenet_logs.analysis.registry.METHODS`; None for the preset's.
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
        initial=None if initial is None else _finite_numbers("initial", initial),
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
    from tunenet_logs.analysis.sysid.source import ModelSource, listed_parameters

    wanted = (wanted,) if isinstance(wanted, str) else tuple(wanted)
    mapping = dict(said.get("mapping") or {})
    return ModelSource(Path(said["model"]), listed_parameters(wanted), mapping)


def parse_mapping(texts: Sequence[str]) -> dict[str, str]:
    """Parse `--map` options, SIGNAL=TARGET.

    Raises:
        UsageError: One of them is no pair, or two are of one signal.
    """
    mapping: dict[str, str] = {}
    for text in texts:
        key, sign, target = text.partition("=")
        if not (key and sign and target):
            raise UsageError(f"--map {text!r} is no SIGNAL=TARGET", "such as /arm/j1=joint/elbow")
        if key in mapping:
            raise UsageError(f"--map {key} is given twice", "leave one out")
        mapping[key] = target
    return mapping


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
    from tunenet_logs.analysis.payload.arm_card import read_arm_card
    from tunenet_logs.analysis.result_files import log_sha256

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


def _finite_numbers(name: str, given: float | Sequence[float]) -> tuple[float, ...]:
    values = (given,) if isinstance(given, int | float) else tuple(given)
    if not all(isinstance(value, int | float) and math.isfinite(value) for value in values):
        raise UsageError(f"{name} {given!r} are no numbers")
    return tuple(map(float, values))


# ---- Options that commands share, and those that describe the ball or the arm.


def preset_option(parser: argparse.ArgumentParser) -> None:
    """Add `--preset`."""
    parser.add_argument(
        "--preset",
        choices=["default", "paper", "paper-code"],
        default="default",
        help="simulator, observation and network: ours, or those of the paper's text or code",
    )


def jobs_option(parser: argparse.ArgumentParser, what: str) -> None:
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


def ball_options(group: argparse._ArgumentGroup) -> None:
    """Add the options that describe the ball."""
    add = group.add_argument
    ball = add("--ball", metavar="NAME", help=f"a ball of known size and mass: {', '.join(BALLS)}")
    offering(ball, BALLS)
    add(
        "--ball-diameter",
        type=number(*RANGES["ball_diameter_m"]),
        metavar="M",
        help="of the ball [m]; lets the frame rate be checked, too",
    )
    add(
        "--ball-mass",
        type=number(*RANGES["ball_mass_kg"]),
        metavar="KG",
        help="of the ball [kg], with its diameter: what the air does to it follows",
    )


def arm_options(group: argparse._ArgumentGroup) -> None:
    """Add the options of the payload experiment."""
    add = group.add_argument
    add(
        "--tare",
        type=Path,
        metavar="LOG",
        action="append",
        help="a run of the same arm with nothing in its gripper, best along the same motion: what "
        "friction, offsets and the model's errors do is then known. May be given several times",
    )
    add(
        "--arm-card",
        type=Path,
        metavar="FILE",
        help="what earlier runs of the same arm said of its friction, sensors and links, as "
        "--save-arm-card wrote it; with and without --tare",
    )
    add(
        "--save-arm-card",
        type=Path,
        metavar="FILE",
        help="write what the log, its tares and the --arm-card say of the arm; for one log",
    )
    arm = add(
        "--arm",
        metavar="NAME",
        help=f"whose torques these are: {', '.join(ARMS)} (default: as the joints' names say, else "
        f"{DEFAULT})",
    )
    offering(arm, ARMS)
    add("--urdf", type=Path, metavar="FILE", help="any other serial arm")
    add("--tool-link", metavar="NAME", help="the link of that URDF in whose frame the payload is")
    add(
        "--gravity",
        choices=["included", "compensated"],
        help="whether the arm's own weight is in the torques (default: as the log shows)",
    )
    add(
        "--effort-sign",
        choices=["joint", "load"],
        help="whose torques these are: what the joint exerts, or the load, the opposite (default: "
        "as the log shows)",
    )
    add(
        "--effort-unit",
        type=_effort_unit,
        metavar="{N·m,A}",
        help="of the torques; with A they are currents, and --torque-constants makes them torques: "
        "one number a joint from base to tool, or one for all (default: N·m)",
    )


def _effort_unit(text: str) -> str:
    """Parse an effort unit for argparse: N·m in one of its spellings, or A."""
    try:
        return effort_unit(text)
    except UsageError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def check_card_place(arguments: argparse.Namespace) -> None:
    """Check before the work that the arm card can be written.

    Raises:
        UsageError: It cannot, or there are several logs.
    """
    saved, logs = arguments.save_arm_card, arguments.logs
    if saved is None:
        return
    from tunenet_logs.analysis.payload.experiment import card_place

    if len({real_path(log) for log in logs}) != 1:
        raise UsageError(f"--save-arm-card is for one log, not {len(logs)}; name one")
    card_place(saved, None, overwrite=True).check()


# ---- tunenet-tune: its help texts and arguments.

_DESCRIPTION = """\
Find the physical parameters that make a simulator move as a log shows: for a
dropped ball, its coefficient of restitution; for an arm that moves and holds something,
its mass. Reads videos (.mp4, .mov, ...), sound (.wav, .m4a, .mp3, ...), tables (.csv),
exports of motion capture, video trackers, sensors and robots, and logs (MCAP, ROS 1
.bag, ROS 2 .db3 and bag folders) that hold the ball's position (PoseStamped, Odometry,
TF, ...), a camera's pictures, sound, or joints with their torques (JointState,
Kinova's) under any topic, ours or not.

Writes NAME.json (the result) and NAME.rrd (the review, for `rerun NAME.rrd`)
beside each log, and prints a table. Of many logs (several, a folder, a pattern) with
-o DIR it keeps DIR/ledger.parquet, a row a log, for pandas and every tool of tables,
and DIR/ledger.rrd, all of them in one view."""

_EXAMPLES = """\
  tunenet-tune drop.mcap
  tunenet-tune sample_logs/*.mcap -o tuned --jobs 2
  tunenet-tune recordings/ -o tuned                (a folder with all that lies below it)
  tunenet-tune recordings/ -o tuned --resume       (what is new, or was not done)
  tunenet-tune 'runs/**/ball*.mcap' -o tuned --review-only suspect --csv tuned.csv
  tunenet-tune drop.mcap --json - | jq .parameters.restitution
  tunenet-tune phone.mp4
  tunenet-tune bounce.wav                          (a ball by its sound)
  tunenet-tune phone.mp4 --preview                 (mark the ball on a page)
  tunenet-tune phone.mp4 --roi 400,0,500,1080 --start 2.5
  tunenet-tune phone.mp4 --ball table-tennis       (takes the air's drag into account)
  tunenet-tune phone.mp4 --ball-diameter 0.04 --ball-mass 0.0027
  tunenet-tune mocap.mcap --topic /vrpn/ball/pose --start 3.5 --end 8
  tunenet-tune Take_07.csv                         (OptiTrack, Vicon, Qualisys, ...)
  tunenet-tune ball.csv --columns t=Zeit,z='Hoehe (cm)'
  tunenet-tune spots.csv --fps 240                 (frames and no times)
  tunenet-tune claps.csv --columns times=1         (times of impacts alone)
  tunenet-tune drop.mcap --iterations 10 --initial 0.5
  tunenet-tune payload.bag --tare empty.bag        (what a Jaco holds)
  tunenet-tune payload.bag --arm ur5e
  tunenet-tune run.mcap --tare empty.mcap --save-arm-card arm.json
  tunenet-tune next.mcap --arm-card arm.json       (no tare needed)
  tunenet-tune run.mcap --gravity included --effort-unit A --torque-constants 9.5
  tunenet-tune run.mcap --urdf arm.urdf --tool-link flange
  tunenet-tune drop.mcap --weights my-drop.safetensors
  tunenet-tune run.mcap --model robot.xml --tune joint/elbow.damping=0:5 --dry-run
  tunenet-tune run.mcap --model robot.xml --tune body/tool.mass=0:2 --tune delay/commands
  tunenet-tune run.mcap --model robot.urdf --tune tuned.yaml --map /arm/j1=joint/elbow"""


def build_parser() -> Parser:
    """Build the argument parser."""
    parser = Parser("tunenet-tune", _DESCRIPTION, _EXAMPLES)
    add = parser.add_argument
    add(
        "logs",
        nargs="+",
        type=_named,
        metavar="LOG",
        help="log, film or sound to tune from, a folder that holds logs, or a pattern such as "
        "'runs/**/*.mcap'",
    )
    add("-o", "--output", type=Path, metavar="DIR", help="folder for the results")
    add(
        "--task",
        choices=kinds(),
        help="what the log shows (default: what it says itself, or what is in it)",
    )
    add(
        "--topic",
        help="channel with the ball's position (default: /ball/pose, one named like a "
        "ball, else the first in which a ball drops), with pictures of it, or with torques",
    )
    add(
        "--start",
        type=number(*RANGES["start_s"]),
        metavar="S",
        help="leave out what comes before [s]",
    )
    add("--end", type=number(*RANGES["end_s"]), metavar="S", help="leave out what comes after [s]")
    add(
        "--height",
        type=number(*RANGES["height_m"]),
        metavar="M",
        help="of the drop, where a log holds impact times alone [m]",
    )
    _picture_options(parser.add_argument_group("ball in pictures (found by its flight without)"))
    ball_options(parser.add_argument_group("ball in pictures, where it is known"))
    arm_options(parser.add_argument_group("payload of an arm"))
    _model_options(parser.add_argument_group("a MuJoCo model of your own"))
    reading_options(parser.add_argument_group("what a file does not say itself"))
    preset_option(parser)
    engine_option(parser)
    add(
        "--method",
        choices=METHODS,
        metavar="NAME",
        help="how the parameters are estimated: the network's steps and the exact fit after them "
        "(tunenet+refine, the default of the preset default), the steps alone (tunenet), the fit "
        f"alone (fit), or by rollouts alone: {', '.join(list(METHODS)[3:])}. Only fits give an "
        "interval",
    )
    add(
        "--iterations",
        type=whole(1, MAX_ITERATIONS),
        default=5,
        metavar="K",
        help="rollouts that the method may spend, before those that check its answer (default: 5)",
    )
    add(
        "--initial",
        type=_vector,
        metavar="X[,Y,...]",
        help="restitution or mass [kg] to start from, one value a parameter (default with a "
        "network: 0, a ball that does not bounce; 0.5 kg; without: the middle of the range)",
    )
    add("--weights", type=Path, metavar="FILE", help="weights by tunenet-train (default: shipped)")
    json_option(parser, "for scripts: what each NAME.json holds but the curves, a line a log,")
    jobs_option(parser, "logs at a time")
    add("--overwrite", action="store_true", help="replace results of other logs")
    _batch_options(parser.add_argument_group("many logs"))
    add("--quiet", action="store_true", help="no progress bar")
    add(
        "-v",
        "--verbose",
        action="store_true",
        help="say where what was found, how it was estimated, how long each part took, and what "
        "each check saw",
    )
    return parser


def _model_options(group: argparse._ArgumentGroup) -> None:
    add = group.add_argument
    add(
        "--model",
        type=Path,
        metavar="FILE",
        help="tune this model, MJCF or URDF, in place of a ball or a payload",
    )
    add(
        "--tune",
        action="append",
        metavar="ADDRESS[=LOW:HIGH]",
        help="what of it, with the range to look in (default: a fifth to five times the model's "
        "value): joint/NAME.damping, .frictionloss, .armature, .stiffness, .springref; "
        "body/NAME.mass, .ipos[i], .inertia[i]; geom/NAME.friction[i], .solref[i], .solimp[i]; "
        "actuator/NAME.kp, .kv, .gear[i]; tendon/NAME.damping, .frictionloss, .stiffness; "
        "option.gravity[i], .density, .viscosity; delay/commands; or a YAML file with ADDRESS: "
        "[LOW, HIGH] lines. May be given several times",
    )
    add(
        "--map",
        action="append",
        metavar="SIGNAL=TARGET",
        help="what of the log is what of the model, where their names differ: a topic, a signal or "
        "SIGNAL.COLUMN, and joint/NAME, actuator/NAME, body/NAME, site/NAME (with a - before it, "
        "such as -site/NAME: a wrench of the child on its parent), commands, states, or - to leave "
        "it out. May be given several times",
    )
    add(
        "--dry-run",
        action="store_true",
        help="say what of the log would drive the model and be compared with it, and end",
    )


def _batch_options(group: argparse._ArgumentGroup) -> None:
    add = group.add_argument
    add(
        "--resume",
        action="store_true",
        help="leave out what the ledger of -o DIR has: logs that did not change, tuned with the "
        "same options",
    )
    add("--csv", type=Path, metavar="FILE", help="also write the ledger as a text table")
    ray_option(group, "work")
    reviews = group.add_mutually_exclusive_group()
    reviews.add_argument("--no-review", action="store_true", help="write no NAME.rrd")
    reviews.add_argument(
        "--review-only",
        choices=("ok", "suspect", "rejected"),
        metavar="VERDICT",
        help="write NAME.rrd of logs with this verdict alone: ok, suspect or rejected",
    )


def _picture_options(group: argparse._ArgumentGroup) -> None:
    add = group.add_argument
    add("--roi", type=_box, metavar="X,Y,W,H", help="look for the ball in this box only [px]")
    add(
        "--hsv",
        type=_hsv,
        metavar="RANGE",
        help="its colour as H,S,V:H,S,V, lowest and highest; hue 0 to 179 (170 to 10 is red), "
        "saturation and value 0 to 255",
    )
    add(
        "--ball-at",
        type=_place,
        metavar="X,Y,S",
        help="where it is seen moving [px], and when [s since the first picture]",
    )
    add(
        "--preview",
        action="store_true",
        help="show the pictures on a page of this machine, to mark the ball with a click; "
        "for one log",
    )


def _named(text: str) -> Path | str:
    """Parse a log's path, or its address."""
    return text if "://" in text else Path(text)


def _numbers(text: str, count: int, what: str) -> tuple[float, ...]:
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != count or not all(0 <= value < 1e6 for value in values):
        raise argparse.ArgumentTypeError(f"{text!r} is not {what}")
    return values


def _vector(text: str) -> tuple[float, ...]:
    return _numbers(text, text.count(",") + 1, "a number, or some with commas between them")


def _box(text: str) -> tuple[int, ...]:
    values = _numbers(text, 4, "a box X,Y,W,H of whole pixels, such as 400,0,500,1080")
    if any(value != int(value) for value in values) or not values[2] or not values[3]:
        raise argparse.ArgumentTypeError(f"{text!r} is not a box of whole pixels")
    return tuple(int(value) for value in values)


def _place(text: str) -> tuple[float, ...]:
    return _numbers(text, 3, "a place and time X,Y,S, such as 310,95.5,1.2")


def _hsv(text: str) -> tuple[tuple[int, ...], ...]:
    ends = text.split(":")
    what = "a range H,S,V:H,S,V, such as 5,120,80:20,255,255"
    if len(ends) != 2:
        raise argparse.ArgumentTypeError(f"{text!r} is not {what}")
    low, high = (_numbers(end, 3, what) for end in ends)
    most = (179, 255, 255)
    if any(value > top for end in (low, high) for value, top in zip(end, most, strict=True)):
        raise argparse.ArgumentTypeError(f"{text!r}: hue goes to 179, saturation and value to 255")
    return tuple(int(value) for value in low), tuple(int(value) for value in high)
