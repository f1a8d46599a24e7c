"""tunenet-record: from a source of episodes to a log."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from recorders.camera.options import camera_options, record_camera_as_asked
from tunenet_logs.commandline import Parser, number, run, whole

_DESCRIPTION = """\
Record an episode to an MCAP log: a real ball that is dropped before a camera or in a
video (--camera), or a simulated one (--simulate drop: PyBullet, with contact settings
in which the ball has the restitution that was set). Ctrl-C ends a recording cleanly."""

_EXAMPLES = """\
  tunenet-record --camera                              (the first webcam, until Ctrl-C)
  tunenet-record --camera 2 --size 1280x720 --rate 60 --exposure 4 --seconds 8
  tunenet-record --camera drop.mp4 --ball-diameter 0.04 --drop-height 1
  tunenet-record --camera slow.mp4 --fps 240           (slow motion without a tag)
  tunenet-record --camera http://192.168.1.20:8080/video -o drop.mcap
  tunenet-record --camera rtsp://user:password@192.168.1.21/stream1
  tunenet-record --simulate drop --restitution 0.75 --height 1.2 -o drop.mcap
  tunenet-record --simulate drop --seed 7              (draws restitution and height)
  tunenet-record --simulate drop --rate 240 --noise 0.001 --hold 0.5 -o mocap.mcap
  tunenet-record --simulate drop --preset paper        (the paper's 60 Hz settings)"""


def build_parser() -> Parser:
    """The command's arguments; `camera_only` and `drop_only` are those of one source alone."""
    parser = Parser("tunenet-record", _DESCRIPTION, _EXAMPLES)
    source = parser.add_argument_group("source, one of").add_mutually_exclusive_group(required=True)
    source.add_argument(
        "--camera",
        nargs="?",
        const="0",
        metavar="SOURCE",
        help="a camera's number or /dev/... path (default: 0), an http:// (MJPEG) or rtsp:// "
        "address, or a video file",
    )
    source.add_argument("--simulate", choices=["drop"], help="what to simulate")
    _shared_options(parser.add_argument_group("both"))
    camera = camera_options(parser.add_argument_group("camera"))
    drop = _drop_options(parser.add_argument_group("simulated drop"))
    parser.set_defaults(camera_only=camera, drop_only=drop)
    return parser


def _shared_options(group: argparse._ArgumentGroup) -> None:
    add = group.add_argument
    add(
        "-o",
        "--output",
        type=Path,
        metavar="LOG",
        help="log to write (default: drop_DATE_TIME.mcap here)",
    )
    add(
        "--rate",
        type=number(10, 10_000, "Hz"),
        metavar="HZ",
        help="samples a second (default: 60), or frames a second asked of a plugged-in camera",
    )
    add(
        "--seconds",
        type=number(0.1, 600, "s"),
        metavar="S",
        help="how long; simulated, after the release (default: 400/60, the paper's; "
        "a camera: until it ends or Ctrl-C)",
    )
    add("--overwrite", action="store_true", help="replace an existing log")
    add("--quiet", action="store_true", help="no progress bar")


def _drop_options(group: argparse._ArgumentGroup) -> list[argparse.Action]:
    """Add the options that are the simulated drop's alone; None where they are not given."""
    add = group.add_argument
    return [
        add(
            "--restitution",
            type=number(0, 1),
            metavar="E",
            help="coefficient of restitution, 0 to 1 (default: drawn from .1 to .95)",
        ),
        add(
            "--height",
            type=number(0.01, 1000, "m"),
            metavar="M",
            help="drop height, from the ball's underside to the table [m] "
            "(default: drawn, .3 to 5)",
        ),
        add(
            "--radius",
            type=number(0.001, 10, "m"),
            metavar="M",
            help="of the ball [m] (default: .05; preset paper: .5)",
        ),
        add(
            "--hold",
            type=number(0, 600, "s"),
            metavar="S",
            help="hold the ball before letting go [s] (default: 0)",
        ),
        add(
            "--noise",
            type=number(0, 1, "m"),
            metavar="M",
            help="standard deviation of the sensor's noise [m] (default: 0)",
        ),
        add(
            "--preset",
            choices=["default", "paper"],
            help="contact settings: calibrated, or PyBullet's defaults at 60 Hz as in the paper",
        ),
        add(
            "--seed",
            type=whole(0, 2**32 - 1),
            metavar="N",
            help="for what is drawn: restitution, height, noise (default: 0)",
        ),
    ]


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point of `tunenet-record`."""
    parser = build_parser()

    def record(arguments: argparse.Namespace) -> int:
        is_camera = arguments.camera is not None
        source = "--camera" if is_camera else "--simulate"
        for action in arguments.drop_only if is_camera else arguments.camera_only:
            if getattr(arguments, action.dest) is not None:
                parser.error(f"{action.option_strings[0]} does not go with {source}; leave it out")
        path = arguments.output or Path(f"drop_{datetime.now():%Y%m%d_%H%M%S}.mcap")
        recorded = (record_camera_as_asked if is_camera else _record_drop)(arguments, path)
        print(f"{path}: {recorded}")
        return 0

    return run(parser, record, argv)


def _record_drop(arguments: argparse.Namespace, path: Path) -> str:
    """Record a simulated drop; what to say of it on the last line."""
    from recorders.session import record_episode
    from recorders.simulated_drop import DropOrder, simulate_drop
    from tunenet_logs.progress import Progress

    given = {
        "restitution": arguments.restitution,
        "height_m": arguments.height,
        "radius_m": arguments.radius,
        "rate_hz": arguments.rate,
        "seconds": arguments.seconds,
        "hold_s": arguments.hold,
        "noise_m": arguments.noise,
        "preset": arguments.preset,
        "seed": arguments.seed,
    }
    order = DropOrder(**{name: value for name, value in given.items() if value is not None})
    episode = simulate_drop(order)
    progress = Progress(quiet=arguments.quiet)
    summary = record_episode(episode, path, overwrite=arguments.overwrite, progress=progress)
    truth, rig = episode.info.truth, episode.info.rig
    return (
        f"restitution {truth['restitution']:.4f}, drop height {rig['drop_height_m']:.3f} m; "
        + summary.in_words("samples")
    )


if __name__ == "__main__":
    sys.exit(main())
