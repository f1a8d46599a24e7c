"""Command line of tunenet-logs: inspect, check, recover and import logs."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from tunenet_logs.console import Parser, run
from tunenet_logs.errors import TuneNetError
from tunenet_logs.files import real_path
from tunenet_logs.formats.options import read_options_of, reading_options
from tunenet_logs.terminal import Progress, one_line

_DESCRIPTION = """\
Logs of any kind: MCAP, ROS 1 and ROS 2 bags, CSV tables, videos."""
_EXAMPLES = """\
  tunenet-logs info drop.mcap
  tunenet-logs check drop.mcap arm.bag
  tunenet-logs recover drop.mcap.active -o drop.mcap   (what a killed recording left)
  tunenet-logs import arm.bag -o arm.mcap"""


def _verbs() -> Mapping[str, dict[str, Any]]:
    """Return what is done with logs: its help, what exit code 1 means, and what does it."""
    return {
        "info": {
            "help": (
                "what recorded it, its channels with types, counts, rates and gaps, which of them "
                "can be used and why not the others, what is damaged"
            ),
            "description": """\
Show what is in a log: what recorded it, its channels with their types, counts, rates
and gaps, which of them can be used and why not the others, what is damaged, and a
timeline of when each was heard (# as often as usual, . less, blank not at all).""",
            "examples": """\
  tunenet-logs info drop.mcap
  tunenet-logs info arm.bag rosbag2_2026_11_02/
  tunenet-logs info drop.mcap.active     (what a killed recording left)
  tunenet-logs info *.bag --json | jq -r .channels[].topic""",
            "failed": "a log could not be read",
            "body": _info,
        },
        "check": {
            "help": "is it whole: every checksum, record, message and picture",
            "description": """\
Read all of a log: every checksum, record, message and picture. Says what is damaged
and where. Most bags, and logs by other recorders, carry no checksum of their data:
then damage may go unseen, and a line says so.""",
            "examples": """\
  tunenet-logs check drop.mcap
  tunenet-logs check logs/*.mcap
  tunenet-logs check logs/*.mcap --json | jq -r 'select(.whole | not) | .log'""",
            "failed": "a log is damaged or could not be read",
            "body": _check,
        },
        "recover": {
            "help": "copy what is whole of a damaged log, as it is, to a new MCAP file",
            "description": """\
Copy every whole message of a damaged log, as it is, to a new MCAP file with an index
and all checksums, which opens in every reader of MCAP. The log itself is never
changed. What was lost is listed.

Messages of ROS 1 stay what they are, so readers that know ROS 2 alone refuse the copy
of a ROS 1 bag. `tunenet-logs import` makes a log of ROS 2 messages of it.""",
            "examples": """\
  tunenet-logs recover drop.mcap.active -o drop.mcap
  tunenet-logs recover broken.bag -o saved.mcap""",
            "failed": "nothing could be saved",
            "body": _recover,
        },
        "import": {
            "help": "bring a bag, a CSV table or a video into a log of our own format",
            "description": """\
Write the positions, joints, pictures and sound of a bag, CSV table, video, sound or log
of others to a log of our own format. Pictures that are compressed stay as they are. What no
task uses is left out, and named. So are topics that get another name, for ROS or
because two would have the same. One that is broken off leaves nothing.""",
            "examples": """\
  tunenet-logs import arm.bag                  (writes arm.mcap beside it)
  tunenet-logs import torques.csv -o arm.mcap
  tunenet-logs import bounce.wav -o bounce.mcap
  tunenet-logs import rosbag2_2026_11_02/ -o drop.mcap""",
            "failed": "nothing was imported",
            "body": _import,
        },
    }


_MAX_LINES = 100  # of what is said of one kind; a log of thousands is no reason to scroll


def build_parser() -> Parser:
    """Build the parser of the command's arguments."""
    verbs = _verbs()
    parser = Parser("tunenet-logs", _DESCRIPTION, _EXAMPLES, failed=verbs["check"]["failed"])
    below = parser.add_subparsers(
        dest="verb", title="what to do", metavar=f"{{{','.join(verbs)}}}", required=True
    )
    for name, verb in verbs.items():
        body = verb.pop("body")
        made = below.add_parser(name, prog=f"tunenet-logs {name}", **verb)
        made.set_defaults(body=body)
        add = made.add_argument
        if name in ("info", "check"):
            add("logs", nargs="+", type=Path, metavar="LOG")
            add(
                "--json",
                action="store_true",
                help="for scripts: one JSON object a log, each on a line (tunenet docs logs)",
            )
        else:
            is_needed = name == "recover"
            where = "log to write" if is_needed else "log to write (default: NAME.mcap beside it)"
            add("log", type=Path, metavar="LOG")
            add("-o", "--output", type=Path, metavar="OUT", required=is_needed, help=where)
            add("--overwrite", action="store_true", help="replace an existing log")
        if name != "info":
            add("--quiet", action="store_true", help="no progress bar")
        if name != "recover":
            reading_options(made)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run `tunenet-logs`."""
    return run(build_parser(), lambda arguments: arguments.body(arguments), argv)


def _each(
    arguments: argparse.Namespace,
    body: Callable[[Path], bool],
    unread: Callable[[Path, str], Mapping[str, Any]],
) -> int:
    """Run `body` for every log; return 1 if one fails. One that cannot be read stops no other."""
    good = True
    for log in arguments.logs:
        try:
            good &= body(log)
        except TuneNetError as error:
            if arguments.json:
                _print_json(unread(log, str(error)))
            if len(arguments.logs) == 1:
                raise
            print(one_line(f"tunenet-logs: {error}"), file=sys.stderr)
            good = False
    return 0 if good else 1


def _info(arguments: argparse.Namespace) -> int:
    from tunenet_logs.describe import describe, info_fields, unread_info
    from tunenet_logs.reader import read_episode

    options = read_options_of(arguments)

    def show(log: Path) -> bool:
        with Progress().stages(one_line(log)):
            episode = read_episode(log, options)
        if arguments.json:
            _print_json(info_fields(log, episode))
        else:
            print(describe(log, episode))
        return True

    return _each(arguments, show, unread_info)


def _check(arguments: argparse.Namespace) -> int:
    from tunenet_logs.copying import check
    from tunenet_logs.describe import check_fields, unread_check

    options = read_options_of(arguments)
    progress = Progress(quiet=arguments.quiet)

    def show(log: Path) -> bool:
        health = check(log, progress, options)
        fields = check_fields(log, health)
        if arguments.json:
            _print_json(fields)
            return health.whole
        state = "whole" if health.whole else "damaged" if health.damage else "not whole"
        held = f"{fields['messages']} messages in {fields['channels']} channels"
        print(one_line(f"{log}: {state}, {held}"))
        _say("damage", health.damage)
        _say("left out", [str(one) for one in health.left_out])
        _say("note", health.doubts)
        return health.whole

    return _each(arguments, show, unread_check)


def _print_json(fields: Mapping[str, Any]) -> None:
    from tunenet_logs.files import json_line

    print(json_line(fields), flush=True)


def _say(what: str, facts: Sequence[str]) -> None:
    """Print facts of one kind, one a line; of very many the first."""
    for fact in facts[:_MAX_LINES]:
        print(one_line(f"  {what}: {fact}"))
    if len(facts) > _MAX_LINES:
        print(f"  {what}: and {len(facts) - _MAX_LINES} more")


def _recover(arguments: argparse.Namespace) -> int:
    from tunenet_logs.copying import recover

    log, output = arguments.log, arguments.output
    recovered = recover(log, output, overwrite=arguments.overwrite)
    print(one_line(f"{output}: {recovered.messages} messages saved from {log}"))
    _say("lost", recovered.losses)
    if recovered.holds_ros1:
        print(
            "  note: its messages are still those of ROS 1, which readers of ROS 2 refuse; "
            "tunenet-logs import makes a log of ROS 2 messages"
        )
    return 0


def _import(arguments: argparse.Namespace) -> int:
    from tunenet_logs.copying import import_log

    log = arguments.log
    output = arguments.output or log.parent / f"{real_path(log).stem}.mcap"
    progress = Progress(quiet=arguments.quiet)
    imported = import_log(
        log,
        output,
        overwrite=arguments.overwrite,
        progress=progress,
        options=read_options_of(arguments),
    )
    print(one_line(f"{output}: {imported.messages} messages from {log}"))
    _say("renamed", imported.renamed)
    _say("left out", imported.left_out)
    for line in imported.warnings:
        print(one_line(f"tunenet-logs: {log}: {line}"), file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
