"""The whole road of a filmed drop: recorded, read back, tracked, tuned, checked, reviewed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.analysis.films import short_film
from tests.conftest import ROOT, Command, Made, film
from tests.engines import needs_pybullet
from tests.recorders.live_wait import LAST_RESORT_S
from tests.recorders.mjpeg_camera import check_times, playing
from tests.strangers import Stranger, write_poses
from tunenet_logs import messages
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.episode import EpisodeInfo, Frame
from tunenet_logs.errors import UsageError
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.session import record_episode
from tunenet_logs.recorders.simulated import DropOrder, FilmOrder, film_drop
from tunenet_logs.terminal import Progress
from tunenet_logs.writing.writer import EpisodeWriter

SAMPLE = ROOT / "sample_logs" / "filmed.mcap"


def value(tuning: Tuning) -> float:
    assert tuning.estimate is not None, tuning.reason
    return float(tuning.estimate[0])


@pytest.fixture(scope="module")
def short(made: Made) -> Path:
    return short_film(made, rate_hz=30)


@pytest.fixture(scope="module")
def tuned(short: Path) -> Tuning:
    return tune_log(short, TuneOptions())


@pytest.mark.slow
def test_fresh_films_of_random_cameras(tmp_path: Path):
    """The figure to hold: mean absolute error .015. `tests.bench.video` has more drops."""
    rng = np.random.default_rng(40_001)
    off = []
    for index in range(4):
        truth = float(rng.uniform(0.1, 0.95))
        picture = FilmOrder(exposure_s=float(rng.choice([0, 0.004])), noise=2)
        path = film(
            tmp_path / f"{index}.mcap",
            picture,
            restitution=truth,
            hold_s=0.3,
            seconds=2.2,
            seed=40_000 + index,
        )
        tuning = tune_log(path, TuneOptions())
        assert tuning.task == "drop"
        off.append(abs(value(tuning) - truth))
    assert np.mean(off) < 0.01


def test_truth_in_the_log_changes_nothing(short: Path, tuned: Tuning, tmp_path: Path):
    episode = read_episode(short)
    info = replace(episode.info, truth={"restitution": 0.1})
    for name, one in {"wrong": info, "none": EpisodeInfo()}.items():
        with EpisodeWriter(tmp_path / f"{name}.mcap", one, live=False) as writer:
            for frame in episode.frames():
                writer.write_frame("/any/camera", frame)
    assert tuned.trace is not None
    for path in tmp_path.glob("*.mcap"):
        other = tune_log(path, TuneOptions())
        assert other.trace is not None
        for mine, theirs in zip(tuned.trace.steps, other.trace.steps, strict=True):
            assert np.array_equal(mine.values, theirs.values)


@pytest.mark.live
def test_a_network_camera_plays_a_drop(command: Command, tmp_path: Path):
    """The figure to hold: restitution within .02 of the truth, over real sockets.

    On a busy machine pictures are sent late. So their stamps are compared with the moments of
    sending and receipt, and what is tuned has those at which a camera of 60 fps takes them.
    """
    sent = [frame.data for frame in read_episode(SAMPLE).frames()]
    with playing(log=str(SAMPLE), frames=len(sent), rate_hz=240.0) as address:
        words = ("--camera", f"http://{address}", "--stall", LAST_RESORT_S, "-o", "a.mcap")
        words += ("--stamps", "arrival")
        recorded = command("tunenet-record", *words, cwd=tmp_path)
        check_times(tmp_path / "a.mcap", address)
    assert recorded.returncode == 0, recorded.stderr
    assert f"{len(sent)} frames captured, {len(sent)} written, 0 dropped" in recorded.stdout
    episode = read_episode(tmp_path / "a.mcap")
    assert [frame.data for frame in episode.frames()] == sent
    with EpisodeWriter(tmp_path / "b.mcap", episode.info, live=False) as writer:
        for number, frame in enumerate(episode.frames()):
            stamp_ns = round(number * 1e9 / 60)
            writer.write_frame(messages.CAMERA_TOPIC, replace(frame, stamp_ns=stamp_ns))
    assert value(tune_log(tmp_path / "b.mcap", TuneOptions())) == pytest.approx(0.74, abs=0.02)


def test_positions_come_before_pictures_unless_a_topic_says_so(short: Path, tmp_path: Path):
    stamps, positions = Stranger(restitution=0.4, gap_m=1.0).samples()
    path = tmp_path / "both.mcap"
    with EpisodeWriter(path, EpisodeInfo(kind="drop"), live=False) as writer:
        for stamp_ns, position_m in zip(stamps, positions, strict=True):
            writer.write_pose("/mocap/ball", int(stamp_ns), position_m)
        for frame in read_episode(short).frames():
            writer.write_frame("/webcam", frame)
    assert value(tune_log(path, TuneOptions())) == pytest.approx(0.4, abs=0.01)
    camera = tune_log(path, TuneOptions(topic="/webcam"))
    assert value(camera) == pytest.approx(0.7, abs=0.01)
    assert camera.detection.topic == "/webcam"
    hinted = TuneOptions(roi=(0, 0, 300, 200), ball_at=(1, 2, 0))
    (told,) = tune_log(path, hinted).warnings
    assert "--roi, --ball-at not used" in told
    assert "--topic /webcam" in told


def test_hints_for_pictures_are_not_used_in_silence(command: Command, drop_log: Path):
    for words, code in (((), 0), (("--end", "0.1"), 1)):  # a drop, and none
        result = command("tunenet-tune", drop_log, "--roi", "0,0,5,5", *words)
        assert result.returncode == code
        assert "--roi not used" in result.stdout + result.stderr


@pytest.mark.parametrize(("kind", "length_s"), [("drop_log", "6.65"), ("short", "1.77")])
def test_a_part_past_the_end_is_one_line_with_the_length(
    command: Command, kind: str, length_s: str, request: pytest.FixtureRequest, tmp_path: Path
):
    log = request.getfixturevalue(kind)
    result = command("tunenet-tune", log, "--start", "90", "-o", tmp_path)
    assert result.returncode == 1
    said = f"--start 90 is past the end: the recording is {length_s} s long"
    assert sum(said in line for line in result.stdout.splitlines()) == 1
    assert not result.stderr


def test_the_camera_that_sees_the_drop_is_found(short: Path, tmp_path: Path):
    frames = list(read_episode(short).frames())
    path = tmp_path / "two.mcap"
    with EpisodeWriter(path, EpisodeInfo(kind="drop"), live=False) as writer:
        for frame in frames:
            writer.write_frame("/a_still", replace(frames[0], stamp_ns=frame.stamp_ns))
            writer.write_frame("/b_drop", frame)
    tuning = tune_log(path, TuneOptions())
    assert value(tuning) == pytest.approx(0.7, abs=0.01)
    assert tuning.detection.topic == "/b_drop"


def test_part_of_a_film(short: Path, tuned: Tuning):
    part = tune_log(short, TuneOptions(start_s=0.4, end_s=1.7))
    assert value(part) == pytest.approx(0.7, abs=0.015)
    assert part.detection.drop.impact_s == pytest.approx(tuned.detection.drop.impact_s, abs=0.005)


def test_the_ball_marked_while_it_was_recorded(short: Path, tuned: Tuning, tmp_path: Path):
    episode = read_episode(short)
    track = tuned.detection.film.track
    above, flying = ("{:.1f},{:.1f}".format(*track.places_px[index]) for index in (0, 20))
    notes = {"ball_at_px": flying, "ball_at_stamp_ns": str(track.stamps_ns[20])}
    wrong = {
        "far": {"ball_at_px": "9999,1"},
        "aimed": {"ball_at_stamp_ns": str(track.stamps_ns[0] - 10**10)},
        "later": {"ball_at_px": above, "ball_at_stamp_ns": "9" * 400},
        "corner": {"ball_at_px": "2,2"},
    }
    for name, marked in {"good": notes, **{k: {**notes, **v} for k, v in wrong.items()}}.items():
        path = tmp_path / f"{name}.mcap"
        info = replace(episode.info, notes=marked)
        with EpisodeWriter(path, info, live=False) as writer:
            for frame in episode.frames():
                writer.write_frame("/camera", frame)
        tuning = tune_log(path, TuneOptions())
        assert value(tuning) == pytest.approx(0.7, abs=0.01)
        said = any("without it" in one for one in tuning.warnings)
        assert said == (name in ("aimed", "later", "corner")), name


def test_a_wrong_frame_rate_is_told_by_a_known_height(short: Path, tmp_path: Path):
    episode = read_episode(short)
    with EpisodeWriter(tmp_path / "slow.mcap", episode.info, live=False) as writer:
        for frame in episode.frames():
            writer.write_frame("/camera", replace(frame, stamp_ns=4 * frame.stamp_ns))
    tuning = tune_log(tmp_path / "slow.mcap", TuneOptions())
    assert value(tuning) == pytest.approx(0.7, abs=0.01)
    assert tuning.verdict == "suspect"
    assert "frame rate" in (tuning.reason or "")


@needs_pybullet
def test_the_papers_network_on_its_own_kind_of_film(tmp_path: Path):
    """Its network was trained on .3 to .7 from 4 to 5 m, a ball of 0.5 m radius, 100 x 100 px."""
    order = DropOrder(preset="paper", restitution=0.5, height_m=4.0, seed=3)
    path = tmp_path / "paper.mcap"
    episode = film_drop(order, FilmOrder(size_px=(100, 100)))
    record_episode(episode, path, overwrite=False, progress=Progress(quiet=True))
    tuning = tune_log(path, TuneOptions(preset="paper", initial=(0.5,)))
    assert not tuning.physical
    assert tuning.cross_check is None
    assert value(tuning) == pytest.approx(0.5, abs=0.3)
    with pytest.raises(UsageError, match="no preset 'paper-code'"):
        tune_log(path, TuneOptions(preset="paper-code"))


def with_frames(path: Path, frames: list[Frame]) -> Path:
    with EpisodeWriter(path, EpisodeInfo(kind="drop"), live=False) as writer:
        for frame in frames:
            writer.write_frame("/camera", frame)
    return path


def test_pictures_that_are_none(tmp_path: Path, short: Path):
    frames = list(read_episode(short).frames())
    for name, wrong, reason in (
        ("garbage", [replace(one, data=b"no picture") for one in frames], "no picture"),
        ("one", frames[:1], "too few"),
        ("still", [replace(frames[0], stamp_ns=one.stamp_ns) for one in frames], "fly"),
    ):
        tuning = tune_log(with_frames(tmp_path / f"{name}.mcap", wrong), TuneOptions())
        assert tuning.verdict == "rejected", name
        assert reason in (tuning.reason or ""), name


def test_damaged_pictures_among_good_ones_are_counted(tmp_path: Path, short: Path):
    frames = list(read_episode(short).frames())
    frames[10] = replace(frames[10], data=frames[10].data[:100])
    tuning = tune_log(with_frames(tmp_path / "a.mcap", frames), TuneOptions())
    assert value(tuning) == pytest.approx(0.7, abs=0.01)
    assert "1 damaged pictures were left out" in tuning.warnings


@pytest.mark.parametrize("stamps", ["none", "constant", "backwards"])
def test_header_stamps_that_do_not_tell_the_time(tmp_path: Path, short: Path, stamps: str):
    """As drivers write them that do not know when; the log's own times are used."""
    frames = list(read_episode(short).frames())
    told = {"none": lambda _: 0, "constant": lambda _: 7, "backwards": lambda ns: 10**12 - ns}
    path = tmp_path / "a.mcap"
    with EpisodeWriter(path, EpisodeInfo(kind="drop"), live=False) as writer:
        for frame in frames:
            stamp_ns = told[stamps](frame.stamp_ns)
            kind, cdr = messages.frame(replace(frame, stamp_ns=stamp_ns))
            writer.write_message("/cam", kind, frame.stamp_ns, cdr)
    assert value(tune_log(path, TuneOptions())) == pytest.approx(0.7, abs=0.01)


def test_pictures_of_another_size_are_left_out(tmp_path: Path, short: Path):
    import cv2

    frames = list(read_episode(short).frames())
    small = cv2.imencode(".jpg", np.zeros((60, 80, 3), np.uint8))[1].tobytes()
    frames[0] = replace(frames[0], data=small)
    frames[9] = replace(frames[9], data=small)
    tuning = tune_log(with_frames(tmp_path / "a.mcap", frames), TuneOptions())
    assert value(tuning) == pytest.approx(0.7, abs=0.01)
    assert "2 pictures of another size were left out" in tuning.warnings


def test_a_box_outside_the_picture_is_wrong_usage(command: Command, short: Path, tmp_path: Path):
    with pytest.raises(UsageError, match="--roi"):
        tune_log(short, TuneOptions(roi=(400, 0, 20, 20)))
    result = command("tunenet-tune", short, "--roi", "400,0,20,20", "-o", tmp_path)
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert "320 x 240" in result.stderr


def test_a_colour_does_not_go_with_a_mark(command: Command):
    words = ("--hsv", "5,120,80:20,255,255", "--ball-at", "1,2,3")
    result = command("tunenet-tune", "any.mcap", *words)
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert "--hsv does not go with --ball-at" in result.stderr


@pytest.mark.parametrize(
    "words",
    [
        ("--roi", "1,2,3"),
        ("--roi", "0,0,0,5"),
        ("--roi", "a,b,c,d"),
        ("--hsv", "1,2,3"),
        ("--hsv", "200,0,0:10,255,255"),
        ("--ball-at", "1,2"),
        ("--ball-at", "nan,2,3"),
    ],
)
def test_a_bad_mark_is_one_line_that_names_it(command: Command, words: tuple[str, str]):
    result = command("tunenet-tune", "any.mcap", f"{words[0]}={words[1]}")
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert words[0] in result.stderr


def test_a_strangers_poses_still_need_no_pictures(tmp_path: Path):
    stamps, positions = Stranger(restitution=0.55, gap_m=0.8).samples()
    write_poses(tmp_path / "a.mcap", stamps, positions)
    assert tune_log(tmp_path / "a.mcap", TuneOptions()).detection.film is None
