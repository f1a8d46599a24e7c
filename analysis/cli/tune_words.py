"""Arguments and help texts of tunenet-tune."""

from __future__ import annotations

import argparse
from pathlib import Path

from analysis.cli.options import (
    arm_options,
    ball_options,
    jobs_option,
    json_option,
    preset_option,
    ray_option,
)
from analysis.registry import METHODS, kinds
from analysis.tune_options import MAX_ITERATIONS, RANGES
from recorders.engine_option import engine_option
from tunenet_logs.commandline import Parser, number, reading_options, whole

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
