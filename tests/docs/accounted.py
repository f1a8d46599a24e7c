"""Commands of the documents that are not run, or only by `make docs-check`, each with the reason.

All others of ours are run by every run of the suite. A new command in a document needs nothing
where its files have stand-ins (`stand_ins.py`), else a line there, or here.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

# By what the whole command looks like.
NOT_RUN: Mapping[str, str] = {
    r"python -m (tests\.bench|tunenet_logs\.analysis).*": "takes long; its arguments are parsed",
    r"tunenet-record .*--preview.*": "waits for a person at a page",
    r"tunenet-tune .*--preview.*": "waits for a person at a page",
    r"tunenet-record --camera( 0)?( --ball .*)?( -o \S+)?$": "needs a camera",
    r"tunenet-record --camera 0 --size .*": "needs a camera",
    r"tunenet-record --camera 0 --microphone.*": "needs a camera and a microphone",
    r"tunenet-record --camera rtsps?://.*": "needs a network camera",
    r"tunenet-record --camera -( -o \S+)?$": "reads what another program sends",
    r"tunenet-record .*--joint-states .*": "needs a ROS 2 network",
    r"tunenet-eval .*": "takes minutes to hours; its own tests run its parts",
    r"tunenet-train .*": "takes minutes to hours; its own tests train small networks",
    r"tunenet-tune s3://.*": "needs a store on a network",
    r"tunenet-tune .*--ray HEAD:\d+.*": "needs a cluster",
    r"make (demo|test|test-all|smoke|bench)( .*)?": "takes minutes; its target is there",
    r"make (samples|pictures|docs|docs-check)": "changes the tree; its target is there",
    r"make \.venv/\w+": "installs 2 GB; its target is there",
    r"(\S*/)?(pip|python[\d.]* -m pip) .*": "needs a network; pip's own parser takes it",
    r"uv .*": "another program, on a network",
    r"python docs/examples/\w+\.py.*": "test_examples.py runs it",
    r"python docs/make_\w+\.py.*": "changes the documents",
    r"python3 -m venv \w+": "Python's own",
    r"\. \S+/activate": "the shell's own",
    r"(ray|rosbag|ros2|ffmpeg|gst-launch-1\.0|jq) .*": "other programs",
    r"du -sm .*|printf .*|mkdir \w+|(\.venv/bin/)?python -c .*": "the system's own",
}

# Likewise, of those that only `make docs-check` runs.
SLOW: Mapping[str, str] = {
    r"tunenet-tune .*(\.mp4|filmed|sample_logs/\*).*": "tunes a film",
    r"tunenet-tune .*--ray .*": "starts Ray",
    r"tunenet-tune runs/ .*": "starts processes",
    r"tunenet-record .*--render.*": "draws a film",
    r"tunenet-review .*campaign.*": "reviews a film",
}

VIEWER: Mapping[str, str] = {r"(\S*/)?rerun( .*)?": "opens a viewer: its file has to be there"}

# Options in the documents that are none of ours, and whose they are.
OTHER_OPTIONS: Mapping[str, str] = {
    **dict.fromkeys(
        ("--codec", "--host", "--inline", "--libav-format", "--listen", "--port", "--sout"),
        "programs that send pictures",
    ),
    **dict.fromkeys(
        ("--ignore-installed", "--no-binary", "--no-deps", "--only-binary",
         "--platform", "--python-version", "--target"),
        "pip",
    ),
    **dict.fromkeys(("--address", "--head"), "Ray"),
    "--python": "uv",
}  # fmt: skip


def reason(table: Mapping[str, str], text: str) -> str | None:
    """Why a command stands in a table; None where it does not."""
    for pattern, why in table.items():
        if re.fullmatch(pattern, text, re.DOTALL):
            return why
    return None
