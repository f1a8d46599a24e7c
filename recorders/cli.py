"""tunenet-record: from a source of episodes to a log."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from recorders.camera.options import camera_options, record_camera_as_asked
from recorders.drop_options import drop_options, record_drop_as_asked
from tunenet_logs.commandline import Parser, number, run, size_px
from tunenet_logs.wording import one_line

_DESCRIPTION = """\
Record an episode to an MCAP log: a real ball that is dropped before a camera or in a
video (--camera), or a simulated one (--simulate drop: PyBullet, with contact settings
in which the ball has the restitution that was set; --render films it). Ctrl-C ends a
recording cleanly."""

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
  tunenet-record --simulate drop --render --seed 7     (the same, filmed)
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
    drop = drop_options(parser.add_argument_group("simulated drop"))
    parser.set_defaults(camera_only=camera, drop_only=drop)
    return parser


def _shared_options(group: argparse._ArgumentGroup) -> None:
    add = group.add_argument
    add(
        "-o",
        "--output",
        type=_log_path,
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
    add(
        "--size",
        type=size_px,
        metavar="WxH",
        help="of the picture [px], of a plugged-in camera or a rendered one (there: 320x240)",
    )
    add(
        "--min-free",
        type=number(0, 1e9, "MB"),
        default=100.0,
        metavar="MB",
        help="end, with a whole log, before the disk has less left [MB] (default: 100; 0: never)",
    )
    add("--overwrite", action="store_true", help="replace an existing log")
    add("--quiet", action="store_true", help="no progress bar")


def _log_path(text: str) -> Path:
    path = Path(text)
    if path.suffix != ".mcap" and not path.is_dir():  # what is wrong with a folder is told later
        name = path.with_suffix(".mcap")
        raise argparse.ArgumentTypeError(f"{text!r}: what is written is MCAP; name it {name}")
    return path


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
        recorded = (record_camera_as_asked if is_camera else record_drop_as_asked)(arguments, path)
        print(one_line(f"{path}: {recorded}"))
        return 0

    return run(parser, record, argv)


if __name__ == "__main__":
    sys.exit(main())
