"""What the commands refuse: one line on standard error that says why, and nothing written."""

from __future__ import annotations

import json
import os
import shlex
import shutil
import tomllib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.conftest import COMMANDS, ROOT, Command
from tests.engines import HAS_PYBULLET
from tunenet_logs.analysis import tunenet
from tunenet_logs.episode import Episode, EpisodeInfo, Signal
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.session import record_episode
from tunenet_logs.recorders.simulators.arm.description import JACO_URDF
from tunenet_logs.terminal import Progress

SAMPLES = ROOT / "sample_logs"
PAPER = Path(tunenet.__path__[0]) / "weights" / "drop-paper.safetensors"
OTHER = "0" * 64  # a fingerprint, of no certificate
LONG = "a" * 300  # a name that no file system takes

BALL, HELD = {"restitution": 0.8}, {"payload_mass": 0.8, "payload_com": [0.01, -0.02, 0.03]}


def tuning(parameters: dict[str, Any] | None, **changed: Any) -> str:
    """A tuning's file: of a payload if it has a mass, else of a ball of one bounce."""
    task = "payload" if "payload_mass" in (parameters or {}) else "drop"
    fields = {
        "log": "made.mcap",
        "task": task,
        "verdict": "ok",
        "reason": None,
        "parameters": parameters
        and {
            name: {"value": value, "interval95": None, "unit": "1"}
            for name, value in parameters.items()
        },
        "bounces": [bounce(3.0, (parameters or BALL).get("restitution", 0.8))],
    }
    return json.dumps(fields | changed)


def bounce(speed: float, restitution: float) -> dict[str, Any]:
    ends = [restitution - 0.01, restitution + 0.01]
    return {"restitution": restitution, "interval95": ends, "impact_speed": speed, "unit": "m/s"}


# Files by name, and what is in them.
TEXTS = {
    "text.mcap": "hello",
    "notes.txt": "[1, 2]",
    "page.html": "<html><body>hello</body></html>",
    "empty.mcap": "",
    "a.mp4": "",
    "password": "x",
    "own.yaml": "hoop: {forward_m: 0.45}",
    "brace.json": "{",
    "list.json": "[1]",
    "nothing.json": "{}",
    "nul.json": "\0",
    "broken.json": '{"verdict": "ok", "parameters": {',
    "card.json": '{"kind": "ball"}',
    "ball.json": tuning(BALL),
    "payload.json": tuning(HELD),
    "rejected.json": tuning(None, verdict="rejected", reason="stays in view: 20 %"),
    "light.json": tuning(HELD | {"payload_mass": 0.0}),
    "lighter.json": tuning(HELD | {"payload_mass": -0.1}),
    "far.json": tuning(HELD | {"payload_com": [0, 0, 99.0]}),
    "no_ball.json": tuning(HELD, task="drop"),
    "lively.json": tuning({"restitution": 1.4}),
    "steep.json": tuning(BALL | {"restitution_slope": 3.0}),
    "none_found.json": tuning(None),
    "unphysical.json": tuning(BALL, physical=False),
    "no_speed.json": tuning(BALL, bounces=[]),
    "upwards.json": tuning(BALL, bounces=[bounce(-3.0, 0.8)]),
    "nan.json": tuning({"restitution": float("nan")}),
}

_TUNE, _ARM, _FILM = "tunenet-tune drop.mcap", "tunenet-tune held.mcap", "tunenet-tune film.mcap"
_LOGS, _PLAN, _EXPORT = "tunenet-logs", "tunenet-plan", "tunenet-export"
_CAMERA, _STATES = "tunenet-record --camera", "tunenet-record --joint-states"
_DROP, _PAYLOAD = "tunenet-record --simulate drop", "tunenet-record --simulate payload"
_SHOT, _BALLS_SHOT = "tunenet-record --outcome success", "tunenet-record --outcome success --ball b"
_EVAL, _REPORT, _COMPARE = "tunenet-eval", "tunenet-report", "tunenet-compare"

# By a command's first words: the exit code, its other words, and what the line says, in this order.
TABLE: dict[str, list[tuple[int, str, str]]] = {
    "tunenet-tune": [
        (1, "none.mcap", "none.mcap: no such file"),
        (1, "folder.mcap", "folder.mcap: is a directory"),
        (2, "", "LOG"),
        (2, "s3://lab/a.mcap", "give -o DIR"),
        (2, "file:///etc/passwd -o out", "no address that is read"),
        (2, "simplecache::s3://lab/a.mcap -o out", "no address that is read"),
        (2, "ftp://host/a.mcap -o out", "no address that is read"),
        (2, "a.mcap b.mcap --save-arm-card arm.json", "is for one log, not 2"),
        (2, "both.mcap -o out", "--task drop or --task payload"),
        (2, "--print-completion cmd.exe", "'bash', 'zsh', 'tcsh'"),
        (2, "--help cooking", "cooking … payload … all"),
    ],
    _TUNE: [
        (2, "--seeds 3", "--seeds"),
        (2, "--unknown", "--unknown"),
        (2, "--iterations 0", "--iterations … '0'"),
        (2, "--iterations none", "--iterations … 'none'"),
        (2, "--initial 1.2", "restitution 1.2 is not a number from 0 to 1"),
        (2, "--initial nan", "--initial … nan"),
        (2, "--preset best", "--preset … 'best'"),
        (2, "--start 3 --end 2", "--start"),
        (2, "--engine gazebo", "'gazebo' … mujoco"),
        (1, f"--weights {PAPER}", "preset 'paper', not 'default'"),
        # a ball that cannot be, or goes against itself
        (2, "--ball cricket", "there is: table-tennis, tennis, squash … basketball"),
        (2, "--ball-mass 0.01", "add --ball-diameter"),
        (2, "--ball basketball --ball-mass 0.0027", "lighter than the air"),
        (2, "--ball-diameter 0", "'0' is not a number from 0.001"),
        (2, "--ball-mass -1", "'-1' is not a number"),
        (2, "--ball-diameter 40mm", "'40mm'"),
        # outputs
        (1, "-o notes.txt", "notes.txt … not a folder"),
        (2, "--json drop.mcap", "is a log of this batch"),
        (2, "--json drop.json", "is where a log's own results go"),
        (2, "--json notes.txt", "is no file of --json that tunenet-logs wrote"),
        (2, "--json nowhere/a.json", "no such folder"),
        (2, "--json pipe", "pipe"),
        (2, "--resume", "give it"),
        (2, "-o out --csv drop.mcap", "is a log of this batch"),
        (2, "-o out --csv drop.mcap --overwrite", "is a log of this batch"),
        (2, "-o out --csv notes.txt", "is no ledger that tunenet-logs wrote"),
        (2, "-o out --csv out/drop.json", "other results"),
        (2, "-o out --csv out/drop.RRD", "other results"),
        (2, "-o out --csv out/ledger.jsonl", "other results"),
        (2, "-o out --csv out/ledger.parquet", "other results"),
        (2, "--preview", "no pictures"),
    ],
    _FILM: [
        (2, "--roi 900,0,20,20", "--roi … 320 x 240"),
        (2, "--roi 1,2,3", "--roi"),
        (2, "--roi 0,0,0,5", "--roi"),
        (2, "--roi a,b,c,d", "--roi"),
        (2, "--hsv 1,2,3", "--hsv"),
        (2, "--hsv 200,0,0:10,255,255", "--hsv"),
        (2, "--ball-at 1,2", "--ball-at"),
        (2, "--ball-at nan,2,3", "--ball-at"),
        (2, "--hsv 5,120,80:20,255,255 --ball-at 1,2,3", "--hsv does not go with --ball-at"),
        (2, "--preview --ball-at 1,2,3", "--ball-at"),
        (2, "--preview --hsv 0,0,0:9,9,9", "--hsv"),
        (2, "--preview --topic /nix", "/camera/image_raw/compressed"),
        (2, "--preview --start 900", "s long"),
        (2, "film.mcap --preview", "one log"),
    ],
    _ARM: [
        (2, "--effort-unit A", "--effort-unit A needs each joint's torque for each A"),
        (2, "--effort-unit lb", "'lb' is neither N·m (or Nm) nor A"),
        (2, "--gravity on", "--gravity"),
        (2, "--effort-sign -1", "--effort-sign"),
        (2, "--tare x.mcap --tare ./x.mcap", "named twice; name each empty run once"),
        (2, "--tare x.mcap y.mcap", "--tare takes one LOG, and y.mcap was not expected"),
        (2, "--urdf arm.urdf", "go together; add --tool-link"),
        (2, "--tool-link hand", "go together; add --urdf"),
        (2, "--urdf none.urdf --tool-link hand", "none.urdf"),
        (2, "--arm pandda", "did you mean panda"),
        (2, "--arm panda --urdf a.urdf", "--arm panda does not go with --urdf"),
        (2, "--arm panda --tool-link a", "--arm panda does not go with --tool-link"),
        (2, "--save-arm-card no/arm.json", "no such folder"),
        (2, "--arm-card none.json", "none.json: cannot be read"),
        (2, "--initial 50", "payload_mass"),
    ],
    _LOGS: [
        (2, "", "required"),
        (2, "inform drop.mcap", "'inform'"),
        (1, "info none.mcap", "none.mcap"),
        (1, "info text.mcap", "text.mcap"),
        (1, "info notes.txt", "notes.txt"),
        (1, f"info {LONG}.mcap", LONG),
        (1, "info pipe", "pipe … regular file"),
        (1, "check text.mcap", "text.mcap"),
        (1, "recover none.mcap -o a.mcap", "none.mcap"),
        (1, "import text.mcap -o a.mcap", "text.mcap"),
        (1, "import drop.mcap -o no/where/a.mcap", "no/where: no such folder; make it first, or"),
        (1, "recover drop.mcap -o no/where/a.mcap", "no/where: no such folder; make it first, or"),
        (1, "import drop.mcap -o notes.txt/a.mcap", "notes.txt: is no folder; "),
        (1, "recover drop.mcap -o notes.txt/a.mcap", "notes.txt: is no folder; "),
        (2, "import drop.mcap -o notes.txt", "notes.txt"),
    ],
    "tunenet-review": [
        (1, "none -o a.rrd", "none: no such file"),
        (1, "empty -o a.rrd", "holds no drop and no outcome"),
        (1, "list.json -o a.rrd", "list.json"),
        (2, "ball.json -o a.mcap", "name it a.rrd"),
        (2, "ball.json -o no/a.rrd", "no: no such folder"),
        (2, "ball.json", "-o"),
    ],
    _PLAN: [
        (2, "", "which ball?"),
        (2, "a.json --restitution 0.5", "leave one out"),
        (2, "a.json --slope 0.1", "--slope is for --restitution"),
        (2, "a.json --restitution-sd 0.1", "--restitution-sd is for --restitution"),
        (2, "--restitution 7", "'7' is not a number from 0 to 1"),
        (2, "--restitution 0.7 --rig none.yaml", "none.yaml: cannot be read"),
        (2, "--restitution 0.7 --rrd x.txt", "Rerun opens .rrd"),
        (2, "--restitution 0.7 --json no/x.json", "no such folder"),
        # no tuning of a ball
        (1, "none.json", "none.json"),
        (1, "brace.json", "brace.json: is no JSON"),
        (1, "list.json", "list.json: is no tuning"),
        (1, "none_found.json", "none_found.json: holds no restitution"),
        (1, "payload.json", "tuning of a payload"),
        (1, "lively.json", "restitution 1.4 is not a number from 0 to 1"),
        (1, "upwards.json", "impact_speed -3.0"),
        (1, "nan.json", "NaN is no number"),
        (1, "rejected.json", "rejected (stays in view: 20 %); drop the ball again"),
        # outputs that are inputs
        (2, "ball.json --json ball.json", "ball.json: is the tuning too; give --json another"),
        (2, "ball.json --json link.json", "link.json: is the tuning too"),
        (2, "ball.json --json empty/../ball.json", "is the tuning too"),
        (2, "link.rrd --rrd link.rrd", "link.rrd: is the tuning too; give --rrd another"),
        (2, "ball.json --rig own.yaml --json own.yaml", "own.yaml: is --rig too"),
        (2, "ball.json --json x.rrd --rrd x.rrd", "x.rrd: is --json too"),
        (2, "ball.json --json x.rrd --rrd empty/../x.rrd", "x.rrd: is --json too"),
    ],
    _EXPORT: [
        (2, "ball.json --to unreal", "invalid choice: 'unreal'"),
        (2, "ball.json", "required: --to"),
        (2, "ball.json --to json --step 0.001", "leave --step out"),
        (2, "ball.json --to drake --step 0.001", "leave --step out"),
        (2, "ball.json --to json --speed 0", "--speed"),
        (2, "ball.json --to json --mass nan", "--mass"),
        (2, "ball.json --to json -o ball.xml", "ends .json"),
        (2, "ball.json --to json -o no/ball.json", "no such folder"),
        (2, "ball.json --to json -o ball.json", "is the tuning itself"),
        (2, "ball.json --to json -o ball.json --overwrite", "is the tuning itself"),
        (2, "ball.json --to yaml -o own.yaml", "own.yaml: exists"),
        (2, "ball.json --to yaml -o own.yaml --overwrite", "own.yaml: exists"),
        (2, "payload.json --to urdf --radius 0.1", "--radius is for a ball"),
        (2, "payload.json --to urdf --speed 3", "--speed is for a ball"),
        (2, "no_speed.json --to urdf --speed 3", "no impact speed"),
        (1, "light.json --to urdf", "weighs nothing"),
        (1, "lighter.json --to urdf", "payload mass -0.1"),
        (1, "far.json --to urdf", "within 10 m"),
        (1, "no_ball.json --to urdf", "holds neither"),
        (1, "lively.json --to urdf", "1.4 is not from 0 to 1"),
        (1, "steep.json --to urdf", "3 is not from -1 to 1"),
        (1, "none_found.json --to urdf", "holds neither"),
        (1, "unphysical.json --to urdf", "--preset default"),
        (1, "rejected.json --to yaml", "rejected"),
        *(
            (1, f"{name} --to urdf", name)
            for name in (
                "none.json", "empty.mcap", "list.json", "nothing.json", "nul.json", "broken.json",
                "card.json",
            )
        ),
    ],
    _COMPARE: [
        (1, "none.json", "no such file"),
        (1, "empty", "empty"),
        (1, "brace.json", "brace.json"),
        (2, "ball.json --csv no/where.csv", "no such folder"),
        (2, "ball.json --csv ball.json --overwrite", "ball.json"),
    ],
    _REPORT: [
        (2, "", "required"),
        (2, "ball.json", "say what to write"),
        (2, "ball.json -o page.txt", "ends .html"),
        (2, "ball.json -o no/a.html", "no such folder"),
        (2, "ball.json --pdf figure.svg", "figure.svg"),
        (2, "ball.json -o ball.json --overwrite", "ball.json"),
        (2, "ball.json -o link.html --overwrite", "one of the files that are read"),
        (1, "none.json -o a.html", "no such file"),
        (1, "empty -o a.html", "empty"),
        (1, "notes.txt -o a.html", "is no tuning"),
    ],
    "tunenet-train": [
        (2, "fall", "'fall'"),
        (2, "drop --epochs 0", "--epochs"),
        (2, "drop-video --preset paper-code -o w.safetensors", "default, paper"),
    ],
    _EVAL: [
        (2, "", "required"),
        (2, "everything", "invalid choice"),
        (2, "drop --methods mean,best", "no 'best'; there is: mean, entropy-search"),
        (2, "drop --methods ''", "--methods names none; there is: mean, entropy-search"),
        (2, "drop --methods ,", "--methods names none"),
        (2, "drop --methods difference --png a.png", "--png: no method chosen has a"),
        (2, "drop --methods difference --rrd a.rrd", "--rrd: no method chosen has a"),
        (2, "motion --csv -", "--csv -: only --json goes to standard output"),
        (2, "drop --png a.jpg", "a.jpg: --png writes .png"),
        (2, "drop --rrd a", "a: --rrd writes .rrd"),
        (2, "intervals --methods mean", "--methods is for drop, not intervals"),
        (2, "drop --json no/a.json", "no: no such folder"),
        (2, "drop --png .", "is a folder; give --png another file"),
        (2, "drop --json a --csv a", "both --json and --csv name it"),
        (2, "drop --seeds 0", "not a whole number"),
        (2, "drop --rollouts 0", "not a whole number"),
        (2, "drop --rollouts 101", "--rollouts"),
        (2, "motion --rollouts 5", "--rollouts is for drop, not motion"),
        (2, "motion --png a.png", "--png is for drop, not motion"),
        (2, "video --rrd a.rrd", "--rrd is for drop, not video"),
        (2, "video --sections set-D", "no 'set-D'; there is: set-A, set-B"),
        (2, "video --sections ,", "--sections names none; there is: set-A"),
        (2, "payload --sections bad", "there is: masses, logs"),
        (2, "drop --sections bad", "sysid and sound, not drop; leave it out"),
        (2, "video --campaign a", "--campaign is for bounce-shot, not video"),
        (2, "bounce-shot --campaign .", "is there already"),
    ],
    "tunenet-record": [
        (2, "", "--camera"),
        (2, "--simulate fall -o a.mcap", "'fall'"),
        (2, "--help cooking", "cooking … camera, microphone, simulate … all"),
    ],
    _CAMERA: [
        (2, "a.mp4 --simulate drop", "--simulate"),
        (2, "a.mp4 --restitution 0.5", "--restitution"),
        (2, "a.mp4 --seed 0", "--seed"),
        (2, "--hold 0", "--hold"),
        (2, "a.mp4 --exposure 4", "--exposure"),
        (2, "http://127.0.0.1/ --size 640x480", "--size"),
        (2, "a.mp4 --rate 60", "--rate"),
        (2, "0 --fps 60", "--fps"),
        (2, "http://127.0.0.1/ --fps 60", "--fps"),
        (2, "a.mp4 --loopback", "--loopback"),
        (2, "film.avi --preview", "--preview"),
        (1, "film.avi -o drop.mcap", "--overwrite"),
        (1, "film.avi -o text.mcap", "text.mcap … move it away"),
        (2, "a.mp4 --wait 1", "--wait is for a camera in a network"),
        (2, "a.mp4 --microphone", "live camera"),
        (2, "a.mp4 --engine mujoco", "--engine does not go with --camera; leave it out"),
        (2, "a.mp4 -o x.mp4", "x.mp4 … name it x.mcap"),
        (2, "a.mp4 -o x", "x … name it x.mcap"),
        (2, "a.mp4 -o x.mcap.active", "x.mcap.active … name it x.mcap.mcap"),
        (2, "a.mp4 -o x.MCAP", "x.MCAP … name it x.mcap"),
        (1, "film.avi -o a.mcap --min-free 99999999", " GB left and 100000 GB are … --min-free"),
        (2, "a.mp4 --mass 1", "--mass"),
        (2, "a.mp4 --driver", "--driver"),
        (2, "a.mp4 --save-path a.csv", "--save-path"),
        (2, "a.mp4 --size 0x9", "'0x9'"),
        (2, "a.mp4 --size big", "'big'"),
        (2, "a.mp4 --ball-diameter -1", "'-1'"),
        (2, "a.mp4 --ball-mass nan", "'nan'"),
        (2, "a.mp4 --ball basketball --ball-mass 0.001", "lighter than"),
        (2, "a.mp4 --ball-diameter 4 --ball-mass 0.0027", "give its diameter in m"),
        (2, "a.mp4 --stall 0", "'0'"),
        (2, "a.mp4 --seconds inf", "'inf'"),
        (2, "a.mp4 --ball 'a\nb'", "--ball"),
        (2, "a.mp4 --fps 1e9", "--fps"),
        # addresses, encryption, passwords
        (2, "http://", "http"),
        (2, "http://me:secret@host:port/", "http"),
        (2, "'http://host/a path'", "http"),
        (2, "ftp://me:secret@host/video", "ftp"),
        (1, "none.mp4", "no such file; name a video, a camera's number or address"),
        (2, "srt://1.2.3.4:5000", "srtsrc uri=srt://... ! fdsink | tunenet-record --camera -"),
        (2, "rtp://@:5004", "rtpjitterbuffer ! rtph264depay"),
        (2, "rtmp://cam/live", "ffmpeg … -i rtmp://..."),
        (2, "file:///etc/passwd", "file:// is not recorded; there is http, https, rtsp"),
        (2, "tcp://127.0.0.1", "a host and a port alone"),
        (2, "tcp://me:secret@127.0.0.1:5000", "a host and a port alone"),
        (2, "tcp://127.0.0.1:5000/x", "a host and a port alone"),
        (2, "udp://127.0.0.1", "no udp address"),
        (2, "udp://@:99999", "no udp address"),
        (2, "cam:99999/video", "no http address"),
        (2, "http://me%0d%0aX:%20y@127.0.0.1:1/", "characters that nobody can type"),
        (2, "rtsp://me%0d%0aX:%20y@127.0.0.1:1/", "characters that nobody can type"),
        (2, "http://127.0.0.1/ --insecure", "--insecure"),
        (2, f"rtsp://127.0.0.1/ --fingerprint {OTHER}", "--fingerprint"),
        (2, "https://127.0.0.1/ --fingerprint 12:34", "64 hex digits"),
        (2, f"https://127.0.0.1/ --fingerprint {OTHER} --insecure", "--insecure"),
        (2, "a.mp4 --insecure", "--insecure"),
        (2, "http://127.0.0.1/ --rtsp-transport udp", "--rtsp-transport"),
        (2, "rtsps://127.0.0.1/ --rtsp-transport udp", "--rtsp-transport"),
        (2, "http://127.0.0.1:1/ --password-file password", "Write USER@ before the host"),
        (2, "http://me:x@127.0.0.1:1/ --password-file password", "leave one out"),
        (2, "a.mp4 --password-file password", "leave it out"),
        (2, "tcp://127.0.0.1:1 --password-file password", "leave it out"),
        (2, "http://me@127.0.0.1:1/ --password-file pipe", "no regular file"),
        (2, "http://me@127.0.0.1:1/ --password-file none", "No such file"),
        (2, "http://me@127.0.0.1:1/ --password-file .", "directory"),
        # no devices, and files that are no video
        *((1, one, f"{one} … /dev/video") for one in ("97", "/dev/video97", "/dev/null")),
        *(
            (1, name, name)
            for name in ("a.mp4", "text.mcap", "page.html", "folder.mcap")
        ),
    ],
    _STATES: [
        (2, "'joint states'", "'joint states'"),
        (2, ",", "0 topics"),
        (2, "a --domain 233", "'233'"),
        (2, "a --timeout 0", "'0'"),
        (2, "a --joint-names a,,b", "--joint-names"),
        (2, "a --joint-names a,a", "twice"),
        (2, "a --rate 50", "--rate"),
        (2, "a --ball red", "--ball"),
        (2, "a --height 1", "--height"),
        (2, "a --simulate drop", "--simulate"),
    ],
    _DROP: [
        (2, "--microphone", "--microphone"),
        (2, "--fps 60", "--fps"),
        (2, "--ball red", "--ball does not go with --simulate drop"),
        (2, "--reason rim", "--reason does not go with --simulate drop"),
        (2, "--drop-height 1", "--drop-height"),
        (2, "--domain 3", "--domain"),
        (2, "--rig x.yaml", "--rig does not go with --simulate drop"),
        (2, "--mass 1", "--mass"),
        (2, "--driver", "--driver"),
        (2, "--save-path a.csv", "--save-path"),
        (2, "--restitution -0.1", "--restitution … -0.1"),
        (2, "--restitution 1.01", "--restitution … 1.01"),
        (2, "--restitution nan", "--restitution … nan"),
        (2, "--height 0", "--height … 0"),
        (2, "--height inf", "--height … inf"),
        (2, "--rate x", "--rate … x"),
        (2, "--seed -1", "--seed … -1"),
        # names of logs
        (2, "-o x.mp4", "x.mp4 … name it x.mcap"),
        (2, "-o x", "x … name it x.mcap"),
        (2, "-o x.mcap.active", "x.mcap.active … name it x.mcap.mcap"),
        (2, "-o x.MCAP", "x.MCAP … name it x.mcap"),
        (1, "-o .", "is a folder"),
        (1, "-o /", "is a folder"),
        (1, "-o drop.mcap", "--overwrite"),
        (1, "-o no/where/a.mcap", "no/where: no such folder; make it first, or"),
        (1, "-o notes.txt/a.mcap", "notes.txt: is no folder; "),
        (1, "-o a.mcap --min-free 999999999", " GB left and 1000000 GB are to stay … --min-free"),
        # a film of it
        (2, "--blur 4", "--blur"),
        (2, "--size 320x240", "--size"),
        (2, "--render --look-at 0,0,1", "--look-at"),
        (2, "--render --camera-at 0,0,5 --height 1", "camera"),
        (2, "--render --camera-at 1,2", "--camera-at"),
        (2, "--render --lost 1", "--lost"),
        (2, "--render --size 5", "--size"),
        (2, "--render --fov 2", "--fov"),
        *[(2, "--render --preset paper --blur 4", "--blur")] * HAS_PYBULLET,
    ],
    _PAYLOAD: [
        (2, "--mass -1", "--mass … '-1'"),
        (2, "--mass nan", "--mass … 'nan'"),
        (2, "--com 0,0", "--com … '0,0'"),
        (2, "--com 0,0,nan", "--com … nan"),
        (2, "--lag -1", "--lag"),
        (2, "--path nowhere.csv", "nowhere.csv … No such file"),
        (2, "--urdf arm.urdf", "arm.urdf … --tool-link"),
        (2, "--tool-link hand", "--tool-link … --urdf"),
        (2, "--urdf arm.urdf --tool-link hand", "arm.urdf … No such file"),
        (2, f"--urdf {JACO_URDF} --tool-link tool_mount --path circle", "circle … --path random"),
        (2, "--arm ur5e --path circle", "--path circle is of a Jaco with 7 joints"),
        (2, "--arm ur7e", "did you mean ur5e"),
        (2, "--arm ur5e --urdf a.urdf", "--arm ur5e does not go with --urdf"),
        (2, "--empty --mass 1", "--empty … --mass"),
        (2, "--preset paper --driver", "preset paper"),
        (2, "--preset paper --rate 60", "240 Hz … 60 Hz"),
        (2, "--restitution 0.5", "--restitution … --simulate payload"),
        (2, "--render", "--render … --simulate payload"),
        (2, "--size 320x240", "--size"),
        (2, "--fps 60", "--fps … --simulate payload"),
        (2, "--save-path a.csv -o a.mcap", "--save-path … -o"),
    ],
    _SHOT: [
        (2, "", "--ball"),
        (2, "--ball ' '", "--ball"),
    ],
    _BALLS_SHOT: [
        (2, "--rate 60", "--rate"),
        (2, "--overwrite", "--overwrite"),
        (2, "--height 1", "--height"),
        (2, "--miss far", "--miss"),
        (2, "--at noon", "--at"),
        (2, "--at '2050-01-01 10:00'", "beyond 2038"),
        (2, "--at 9999-12-31T23:59-05:00", "--at"),
        (2, "-o x.mcap", "x.mcap"),
        (2, "--drop-log x.mcap", "x.mcap"),
        (2, f"--drop-log {LONG}", "no such file"),
        (2, "--tuning x.json", "x.json"),
        (2, "--tuning list.json", "list.json: is no tuning"),
    ],
}  # fmt: skip
ROWS = [
    *((f"{name} --no-such-option", 2, name) for name in COMMANDS),
    *((f"{by} {words}", code, says) for by, rows in TABLE.items() for code, words, says in rows),
]


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of logs, tunings and what is none."""
    folder = tmp_path_factory.mktemp("here")
    for name, of in (("drop", "bouncy"), ("film", "filmed"), ("held", "payload")):
        shutil.copy(SAMPLES / f"{of}.mcap", folder / f"{name}.mcap")
    for name, text in TEXTS.items():
        (folder / name).write_text(text)
    (folder / "password").chmod(0o600)
    for name in ("folder.mcap", "empty"):
        (folder / name).mkdir()
    os.mkfifo(folder / "pipe")
    for suffix in ("json", "rrd", "html"):
        (folder / f"link.{suffix}").symlink_to("ball.json")
    record_two_things(folder / "both.mcap")
    film = cv2.VideoWriter(str(folder / "film.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 60, (64, 48))
    film.write(np.zeros((48, 64, 3), np.uint8))
    film.release()
    return folder


def record_two_things(path: Path) -> None:
    """A log in which an arm and a ball move."""
    arm = read_episode(SAMPLES / "payload.mcap").signals
    stamps = arm["/joint_states.effort"].stamps_ns
    ball = Signal("/ball/pose", stamps, np.ones((len(stamps), 3)), ("x", "y", "z"), "m")
    both = Episode(EpisodeInfo(), {**arm, ball.name: ball})
    record_episode(both, path, overwrite=False, progress=Progress(quiet=True))


@pytest.mark.parametrize(("line", "code", "says"), ROWS)
def test_is_one_line_that_says_why_and_writes_nothing(
    command: Command, here: Path, line: str, code: int, says: str
):
    before = seen(here)
    name, *words = shlex.split(line)
    done = command(name, *words, cwd=here)
    assert (done.returncode, done.stdout) == (code, ""), done.stderr
    assert done.stderr.startswith(f"{name}: ")
    assert done.stderr.count("\n") == done.stderr.endswith("\n") == 1, done.stderr
    rest = done.stderr
    for part in says.split(" … "):
        _, found, rest = rest.partition(part)
        assert found, f"no {part!r} in {done.stderr}"
    assert "secret" not in done.stderr
    assert seen(here) == before


@pytest.mark.parametrize(
    ("text", "says"), [("", "is empty"), ("hello", "is not an MCAP log")], ids=["empty", "text"]
)
def test_a_log_that_cannot_be_read_is_one_line_and_a_record(
    command: Command, tmp_path: Path, text: str, says: str
):
    (tmp_path / "a.mcap").write_text(text)
    done = command("tunenet-tune", "a.mcap", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith(f"tunenet-tune: a.mcap: {says}")
    assert done.stderr.count("\n") == 1
    assert json.loads((tmp_path / "a.json").read_text())["verdict"] == "rejected"


def seen(folder: Path) -> dict[Path, tuple[int, ...]]:
    """Every file and folder, with all that tells whether it was touched."""
    found = {path: path.lstat() for path in folder.rglob("*")}
    return {path: (one.st_ino, one.st_size, one.st_mtime_ns) for path, one in found.items()}


def test_all_commands_are_here():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert set(COMMANDS) == {line.split()[0] for line, _, _ in ROWS}
    assert {"tunenet", *COMMANDS} == set(project["scripts"])
