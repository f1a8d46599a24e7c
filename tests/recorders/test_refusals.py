"""What `tunenet-record` refuses: words that make no sense, in one line that names them."""

from __future__ import annotations

import json
import os
import random
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from tests.engines import needs_pybullet
from tests.recorders.conftest import Refuses
from tests.recorders.films import film, write_video
from tunenet_logs.recorders.simulators.arm.description import JACO_URDF

OTHER = "0" * 64
_PAYLOAD, _DROP, _BALL = "--simulate payload", "--simulate drop", "--outcome success --ball b"

# By what is recorded: the words, and what the one line must hold.
WORDS: list[tuple[str, str | tuple[str, ...]]] = [
    # what does not go together
    ("", "--camera"),
    ("--camera a.mp4 --simulate drop", "--simulate"),
    ("--camera a.mp4 --restitution 0.5", "--restitution"),
    ("--camera a.mp4 --seed 0", "--seed"),
    ("--camera --hold 0", "--hold"),
    ("--camera a.mp4 --exposure 4", "--exposure"),
    ("--camera http://127.0.0.1/ --size 640x480", "--size"),
    ("--camera a.mp4 --rate 60", "--rate"),
    ("--camera 0 --fps 60", "--fps"),
    ("--camera http://127.0.0.1/ --fps 60", "--fps"),
    ("--camera a.mp4 --loopback", "--loopback"),
    ("--camera a.mp4 --preview", "--preview"),
    ("--camera a.mp4 --wait 1", "--wait is for a camera in a network"),
    ("--camera a.mp4 --microphone", "live camera"),
    ("--simulate drop --microphone", "--microphone"),
    ("--simulate drop --fps 60", "--fps"),
    ("--simulate drop --ball red", "--ball does not go with --simulate drop"),
    ("--simulate drop --reason rim", "--reason does not go with --simulate drop"),
    ("--simulate drop --drop-height 1", "--drop-height"),
    ("--simulate drop --domain 3", "--domain"),
    ("--simulate drop --rig x.yaml", "--rig does not go with --simulate drop"),
    *(
        (f"{source} {option}", option.partition(" ")[0])
        for source in (_DROP, "--camera a.mp4")
        for option in ("--mass 1", "--driver", "--save-path a.csv")
    ),
    # values
    ("--camera a.mp4 --size 0x9", "'0x9'"),
    ("--camera a.mp4 --size big", "'big'"),
    ("--camera a.mp4 --ball-diameter -1", "'-1'"),
    ("--camera a.mp4 --ball-mass nan", "'nan'"),
    ("--camera a.mp4 --ball basketball --ball-mass 0.001", "lighter than"),
    ("--camera a.mp4 --stall 0", "'0'"),
    ("--camera a.mp4 --seconds inf", "'inf'"),
    ("--camera a.mp4 --ball 'a\nb'", "--ball"),
    ("--camera a.mp4 --fps 1e9", "--fps"),
    *(
        (f"{_DROP} --{option}", tuple(f"--{option}".split("=")))
        for option in (
            "restitution=-0.1", "restitution=1.01", "restitution=nan", "height=0", "height=inf",
            "rate=x", "seed=-1",
        )
    ),
    # names of logs
    *(
        (f"{source} -o {name}", (name, f"name it {Path(name).with_suffix('.mcap')}"))
        for source in (_DROP, "--camera a.mp4")
        for name in ("x.mp4", "x", "x.mcap.active", "x.MCAP")
    ),
    # cameras: addresses, encryption, passwords
    ("--camera http://", "http"),
    ("--camera http://me:secret@host:port/", "http"),
    ("--camera 'http://host/a path'", "http"),
    ("--camera ftp://me:secret@host/video", "ftp"),
    ("--camera http://me%0d%0aX:%20y@127.0.0.1:1/", ""),
    ("--camera rtsp://me%0d%0aX:%20y@127.0.0.1:1/", ""),
    ("--camera http://127.0.0.1/ --insecure", "--insecure"),
    (f"--camera rtsp://127.0.0.1/ --fingerprint {OTHER}", "--fingerprint"),
    ("--camera https://127.0.0.1/ --fingerprint 12:34", "64 hex digits"),
    (f"--camera https://127.0.0.1/ --fingerprint {OTHER} --insecure", "--insecure"),
    ("--camera a.mp4 --insecure", "--insecure"),
    ("--camera http://127.0.0.1/ --rtsp-transport udp", "--rtsp-transport"),
    ("--camera rtsps://127.0.0.1/ --rtsp-transport udp", "--rtsp-transport"),
    ("--camera http://127.0.0.1:1/ --password-file password", "Write USER@ before the host"),
    ("--camera http://me:x@127.0.0.1:1/ --password-file password", "leave one out"),
    ("--camera a.mp4 --password-file password", "leave it out"),
    ("--camera tcp://127.0.0.1:1 --password-file password", "leave it out"),
    ("--camera http://me@127.0.0.1:1/ --password-file pipe", "no regular file"),
    ("--camera http://me@127.0.0.1:1/ --password-file gone", "No such file"),
    ("--camera http://me@127.0.0.1:1/ --password-file .", "directory"),
    # joint states of ROS 2
    ("--joint-states 'joint states'", "'joint states'"),
    ("--joint-states ,", "0 topics"),
    ("--joint-states a --domain 233", "'233'"),
    ("--joint-states a --timeout 0", "'0'"),
    ("--joint-states a --joint-names a,,b", "--joint-names"),
    ("--joint-states a --joint-names a,a", "twice"),
    ("--joint-states a --rate 50", "--rate"),
    ("--joint-states a --ball red", "--ball"),
    ("--joint-states a --height 1", "--height"),
    ("--joint-states a --simulate drop", "--simulate"),
    # an arm
    (f"{_PAYLOAD} --mass -1", ("--mass", "'-1'")),
    (f"{_PAYLOAD} --mass nan", ("--mass", "'nan'")),
    (f"{_PAYLOAD} --com 0,0", ("--com", "'0,0'")),
    (f"{_PAYLOAD} --com 0,0,nan", ("--com", "nan")),
    (f"{_PAYLOAD} --lag -1", "--lag"),
    (f"{_PAYLOAD} --path nowhere.csv", ("nowhere.csv", "No such file")),
    (f"{_PAYLOAD} --urdf arm.urdf", ("arm.urdf", "--tool-link")),
    (f"{_PAYLOAD} --tool-link hand", ("--tool-link", "--urdf")),
    (f"{_PAYLOAD} --urdf arm.urdf --tool-link hand", ("arm.urdf", "No such file")),
    (
        f"{_PAYLOAD} --urdf {JACO_URDF} --tool-link tool_mount --path circle",
        ("--path circle", "--path random"),
    ),
    (f"{_PAYLOAD} --arm ur5e --path circle", "--path circle is of a Jaco with 7 joints"),
    (f"{_PAYLOAD} --arm ur7e", "did you mean ur5e"),
    (f"{_PAYLOAD} --arm ur5e --urdf a.urdf", "--arm ur5e does not go with --urdf"),
    (f"{_PAYLOAD} --empty --mass 1", ("--empty", "--mass")),
    (f"{_PAYLOAD} --preset paper --driver", "preset paper"),
    (f"{_PAYLOAD} --preset paper --rate 60", ("240 Hz", "60 Hz")),
    (f"{_PAYLOAD} --restitution 0.5", ("--restitution", "--simulate payload")),
    (f"{_PAYLOAD} --render", ("--render", "--simulate payload")),
    (f"{_PAYLOAD} --size 320x240", "--size"),
    (f"{_PAYLOAD} --fps 60", ("--fps", "--simulate payload")),
    (f"{_PAYLOAD} --save-path a.csv -o a.mcap", ("--save-path", "-o")),
    # a film of a drop
    (f"{_DROP} --blur 4", "--blur"),
    (f"{_DROP} --size 320x240", "--size"),
    (f"{_DROP} --render --look-at 0,0,1", "--look-at"),
    (f"{_DROP} --render --camera-at 0,0,5 --height 1", "camera"),
    (f"{_DROP} --render --camera-at 1,2", "--camera-at"),
    (f"{_DROP} --render --lost 1", "--lost"),
    (f"{_DROP} --render --size 5", "--size"),
    (f"{_DROP} --render --fov 2", "--fov"),
    # an outcome
    ("--outcome success", "--ball"),
    (f"{_BALL} --rate 60", "--rate"),
    (f"{_BALL} --overwrite", "--overwrite"),
    (f"{_BALL} --height 1", "--height"),
    (f"{_BALL} --miss far", "--miss"),
    (f"{_BALL} --at noon", "--at"),
    (f"{_BALL} --at '2050-01-01 10:00'", "beyond 2038"),
    (f"{_BALL} --at 9999-12-31T23:59-05:00", "--at"),
    ("--outcome success --ball ' '", "--ball"),
    (f"{_BALL} -o x.mcap", "x.mcap"),
    (f"{_BALL} --drop-log x.mcap", "x.mcap"),
    (f"{_BALL} --drop-log {'x' * 300}", "no such file"),
    (f"{_BALL} --tuning x.json", "x.json"),
    (f"{_BALL} --tuning bad.json", "bad.json"),
]  # fmt: skip


@pytest.mark.parametrize(("words", "says"), WORDS)
def test_words_that_make_no_sense(refuses: Refuses, tmp_path: Path, words, says):
    (tmp_path / "bad.json").write_text(json.dumps([1]))
    (tmp_path / "password").write_text("x")
    (tmp_path / "password").chmod(0o600)
    (tmp_path / "a.mp4").write_bytes(film("mp4"))
    os.mkfifo(tmp_path / "pipe")
    said = refuses(2, *shlex.split(words), says=says)
    assert "secret" not in said


@needs_pybullet
def test_the_papers_camera_has_no_blur(refuses: Refuses):
    refuses(2, *f"{_DROP} --render --preset paper --blur 4".split(), says="--blur")


@pytest.mark.parametrize("source", ["97", "/dev/video97", "/dev/null"])
def test_a_device_that_is_none_is_told_with_those_there_are(refuses: Refuses, source: str):
    refuses(1, "--camera", source, says=("/dev/video", source))


@pytest.mark.parametrize("place", [".", "/"])
def test_a_folder_is_no_log(refuses: Refuses, place: str):
    refuses(1, "--simulate", "drop", "-o", place, says="is a folder")


def test_a_log_that_is_there_stays(refuses: Refuses, drop_log: Path):
    before = drop_log.read_bytes()
    refuses(1, "--simulate", "drop", "-o", drop_log, says="--overwrite")
    assert drop_log.read_bytes() == before


def test_a_domain_of_the_environment_is_checked(refuses: Refuses, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "many")
    refuses(2, "--joint-states", "/joint_states", says="ROS_DOMAIN_ID: 'many'")


def test_without_cyclonedds_the_extra_is_named(tmp_path: Path):
    code = (
        "import sys; sys.modules['cyclonedds'] = None; "
        "from tunenet_logs.recorders.cli import main; "
        "sys.exit(main(['--joint-states', '/joint_states']))"
    )
    words = [sys.executable, "-c", code]
    result = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True)
    assert (result.returncode, result.stderr.count("\n")) == (2, 1)
    assert "pip install 'tunenet-logs[ros2]'" in result.stderr
    assert not list(tmp_path.iterdir())


# ---- Files that are no video

BAD = {
    "missing.mp4": None,
    "empty.mp4": b"",
    "text.mp4": b"ball\n" * 1000,
    "page.html": b"<html><body>hello</body></html>",
    "noise.mp4": random.Random(0).randbytes(50_000),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_video_is_named(refuses: Refuses, tmp_path: Path, name: str):
    if (data := BAD[name]) is not None:
        (tmp_path / name).write_bytes(data)
    refuses(1, "--camera", tmp_path / name, says=str(tmp_path / name))


def test_a_folder_and_half_a_video_are_none(refuses: Refuses, tmp_path: Path):
    (tmp_path / "folder.mp4").mkdir()
    refuses(1, "--camera", tmp_path / "folder.mp4", says="folder.mp4")
    half = write_video(tmp_path / "cut.mp4", range(0, 600, 10))
    half.write_bytes(half.read_bytes()[: half.stat().st_size // 2])
    refuses(1, "--camera", half, says=str(half))


def test_the_first_camera_is_meant_when_none_is_named():
    from tunenet_logs.recorders.cli import build_parser

    parser = build_parser()
    assert parser.parse_args(["--camera"]).camera == "0"
    assert parser.parse_args(["--camera", "-o", "a.mcap"]).camera == "0"
