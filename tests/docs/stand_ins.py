"""Files under the names that the documents use, made small: what a reader would have recorded."""

from __future__ import annotations

import fnmatch
import shutil
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from tests.conftest import record
from tests.docs.parsing import run_in_process
from tests.export_writers import write_motive
from tests.export_writers_video import phyphox_xlsx
from tests.message_logs import START_NS, STEP_NS, header, in_steps, write_cdr
from tests.strangers import Stranger, write_poses_bag, write_poses_folder
from tests.wheel import ROOT

SAMPLES = ROOT / "sample_logs"
WEIGHTS = ROOT / "analysis" / "tunenet" / "weights"
# Options whose value is a file that the command itself writes.
_OUTPUTS = {"-o", "--json", "--rrd", "--csv", "--save-rig", "--save-arm-card", "--save-path", "-O"}
_DROP = Stranger(0.8, hold_s=0.5, seconds=3.0)


def stand_in(words: Sequence[str], folder: Path) -> None:
    """Make each file that a command names and that is not there, where it has a stand-in."""
    for before, word in pairwise(words):
        if before not in _OUTPUTS:
            make(folder / word)


def make(path: Path) -> None:
    """Make a file or a folder by its name; nothing where it is there or the name is none of ours.

    One is made in the folder where it is wanted: a JSON by tuning the log that it is of.
    """
    if path.exists() or any(path.parent.glob(path.name)):
        return
    for pattern, write in STAND_INS.items():
        if fnmatch.fnmatch(path.name, pattern):
            path.parent.mkdir(parents=True, exist_ok=True)
            write(path)
            return


def _sample(name: str) -> Callable[[Path], object]:
    return lambda path: shutil.copy(SAMPLES / name, path)


def _drop(path: Path) -> None:
    record(path, restitution=0.75, height_m=0.6, noise_m=0.001, seed=len(path.name))


def _tuning(path: Path) -> None:
    log = path.with_suffix(".mcap")
    make(log)
    tuned = run_in_process(("tunenet-tune", str(log), "--no-review", "--quiet"), path.parent)
    assert tuned.returncode == 0, tuned.stderr


def _payload(seed: int, *held: str) -> Callable[[Path], object]:
    words = ["tunenet-record", "--simulate", "payload", "--driver", "--path", "random"]
    words += ["--seconds", "5", "--seed", str(seed), *held]

    def write(path: Path) -> None:
        made = run_in_process((*words, "-o", str(path)), path.parent)
        assert made.returncode == 0, made.stderr

    return write


def _arm_bag(path: Path) -> None:
    """A payload's log as a ROS 1 bag: joint states as `rosbag record` writes them."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    from tunenet_logs.reader import read_episode

    kind, store = "sensor_msgs/msg/JointState", get_typestore(Stores.ROS1_NOETIC)
    signals = read_episode(SAMPLES / "payload.mcap").signals
    fields = [signals[f"/joint_states.{part}"] for part in ("position", "velocity", "effort")]
    with Writer(path) as writer:
        connection = writer.add_connection("/joint_states", kind, typestore=store)
        for count, stamp in enumerate(fields[0].stamps_ns):
            second, nanosecond = divmod(int(stamp), 1_000_000_000)
            at = store.types["builtin_interfaces/msg/Time"](second, nanosecond)
            header = store.types["std_msgs/msg/Header"](seq=count, stamp=at, frame_id="")
            parts = [field.values[count] for field in fields]
            message = store.types[kind](header, list(fields[0].columns), *parts)
            writer.write(connection, int(stamp), bytes(store.serialize_ros1(message, kind)))


def _pose_bag(path: Path) -> None:
    write_poses_bag(path, *_DROP.samples(), topic="/vrpn/ball/pose")


def _broken_bag(path: Path) -> None:
    _pose_bag(path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 3 // 4])


def _killed(path: Path) -> None:
    """What a recording leaves that was killed: a log without its end."""
    _drop(path)
    path.write_bytes(path.read_bytes()[:-700])


def _runs(path: Path) -> None:
    for number in range(3):
        (path / f"day{number % 2}").mkdir(parents=True, exist_ok=True)
        _drop(path / f"day{number % 2}" / f"drop_{number}.mcap")


def _seconds_and_metres() -> tuple[np.ndarray, np.ndarray]:
    stamps_ns, positions = _DROP.samples()
    return (stamps_ns - stamps_ns[0]) * 1e-9, positions


def _motive(path: Path) -> None:
    seconds, positions = _seconds_and_metres()
    write_motive(path, seconds, {"ball": positions}, rate_hz=_DROP.rate_hz)


def _table(path: Path, header: str, separator: str, first: str, scale: float) -> None:
    seconds, positions = _seconds_and_metres()
    lines = [header] if header else []
    for number, (second, height) in enumerate(zip(seconds, positions[:, 2], strict=True)):
        time = f"{number}" if first == "frame" else f"{second:.6f}"
        lines.append(f"{time}{separator}{scale * height:.6f}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _claps(path: Path) -> None:
    flights = 0.6 * 0.8 ** np.arange(9)
    phyphox_xlsx(path, np.cumsum([0.5, *flights]).tolist())


def _vicon(path: Path) -> None:
    """A log of a type of a lab's own, with the height in a field."""
    kind = "vicon_msgs/msg/Marker"
    _, positions = _seconds_and_metres()
    messages = [
        {"header": header(START_NS + at * STEP_NS), "z_trans": height}
        for at, height in enumerate(positions[:, 2].tolist())
    ]
    sent = in_steps("/vicon/ball", kind, messages)
    write_cdr(path, sent, {kind: "std_msgs/Header header\nfloat64 z_trans\n"})


def _clip(path: Path) -> None:
    """The sample film as a phone's file."""
    from tests.bench.lab import write_video
    from tunenet_logs.reader import read_episode

    pictures = [frame.decode() for frame in read_episode(SAMPLES / "filmed.mcap").frames()]
    write_video(path, pictures, "libx264", 60)


def _bounce(path: Path) -> None:
    """A ball's sound in a quiet room, as a phone's recorder would keep it."""
    from tunenet_logs.analysis.evaluation.worlds.audio import draw_sound, write_sound

    clip = draw_sound(-7, 7, background="quiet", snr_db=35.0)
    write_sound(clip.samples, int(clip.rate_hz), path)


def _weights(path: Path) -> None:
    shutil.copy(WEIGHTS / path.name, path)


# By a pattern of the name; the first that fits makes it.
STAND_INS: Mapping[str, Callable[[Path], object]] = {
    "held.mcap": _sample("payload.mcap"),
    "run.mcap": _sample("payload.mcap"),
    "empty.mcap": _sample("payload_empty.mcap"),
    "empty2.mcap": _payload(3, "--empty"),
    "payload*.mcap": lambda path: shutil.copy(SAMPLES / path.name, path),
    "next.mcap": _payload(11, "--mass", "0.7"),
    "third.mcap": _payload(12, "--mass", "0.7"),
    "lab.mcap": _vicon,
    "filmed.mcap": _sample("filmed.mcap"),
    "light.mcap": _sample("light.mcap"),
    "*.mcap": _drop,
    "*.mcap.active": _killed,
    "*.json": _tuning,
    "*.mp4": _clip,
    "lab.bag": _pose_bag,
    "broken.bag": _broken_bag,
    "held.bag": _arm_bag,
    "arm.bag": _arm_bag,
    "rosbag2_*": lambda path: write_poses_folder(path, *_DROP.samples(), topic="/ball"),
    "runs": _runs,
    "campaign": lambda path: shutil.copytree(SAMPLES / "campaign", path),
    "Take_*.csv": _motive,
    "ball.csv": lambda path: _table(path, "Zeit;Höhe (cm)", ";", "second", 100),
    "track.txt": lambda path: _table(path, "", " ", "second", 1),
    "spots.csv": lambda path: _table(path, "frame,z", ",", "frame", 1),
    "claps.xlsx": _claps,
    "*.wav": _bounce,
    "*.m4a": _bounce,
    "*.safetensors": _weights,
}
