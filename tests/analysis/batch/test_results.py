"""Many logs: one bad one never stops the rest, and results go where they should."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import record, tune_all
from tunenet_logs.analysis.batch.logs import FoundLog, result_names
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.errors import LogError, UsageError, WeightsError
from tunenet_logs.terminal import Progress

QUIET = Progress(quiet=True)


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_bad_log_never_stops_the_rest(tmp_path: Path, jobs: int):
    good = [record(tmp_path / f"{name}.mcap", restitution=0.6, height_m=1.0) for name in ("a", "c")]
    (tmp_path / "b.mcap").write_text("not a log")
    logs = [good[0], tmp_path / "b.mcap", tmp_path / "missing.mcap", good[1]]
    results = tune_all(logs, TuneOptions(), tmp_path / "out", jobs, QUIET)
    assert [result.row.record.verdict for result in results] == ["ok", "rejected", "rejected", "ok"]
    assert [result.row.log for result in results] == logs
    names = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert names == ["a.json", "a.rrd", "b.json", "c.json", "c.rrd"]
    report = json.loads((tmp_path / "out" / "b.json").read_text())
    assert report["verdict"] == "rejected"
    assert report["parameters"] is None
    assert report["reason"]


def test_a_log_that_is_tuned_again_replaces_its_own_results(tmp_path: Path):
    path = record(tmp_path / "a.mcap", restitution=0.6, height_m=1.0)
    tune_all([path], TuneOptions(), None, 1, QUIET)
    (result,) = tune_all([path], TuneOptions(method="fit"), None, 1, QUIET)
    assert result.trouble is None
    written = json.loads((tmp_path / "a.json").read_text())
    assert written["method"] == "fit"
    assert written["provenance"]["options"] == {"method": "fit"}
    assert not list(tmp_path.glob("*.partial"))


@pytest.mark.parametrize(
    ("name", "said"),
    [
        (
            "other/a.mcap",
            "is the tuning of another a.mcap, or of this one before it changed, not of",
        ),
        ("other.mcap", "is the tuning of a.mcap, not of"),
    ],
)
def test_results_of_another_log_are_never_replaced_silently(tmp_path: Path, name: str, said: str):
    (tmp_path / "other").mkdir()
    path = record(tmp_path / "a.mcap", restitution=0.6, height_m=1.0)
    other = record(tmp_path / name, restitution=0.8, height_m=1.0)
    out = tmp_path / "out"
    tune_all([path], TuneOptions(), out, 1, QUIET)
    if other.stem != "a":
        for suffix in (".json", ".rrd"):
            (out / f"a{suffix}").rename(out / f"other{suffix}")
    before = {file.name: file.read_bytes() for file in out.iterdir()}
    (result,) = tune_all([other], TuneOptions(), out, 1, QUIET)
    assert said in (result.trouble or "")
    assert str(other) in (result.trouble or "")
    assert "--overwrite" in (result.trouble or "")
    assert {file.name: file.read_bytes() for file in out.iterdir()} == before
    (result,) = tune_all([other], TuneOptions(), out, 1, QUIET, overwrite=True)
    assert result.trouble is None
    assert json.loads((out / f"{other.stem}.json").read_text())["log"] == other.name


def test_what_is_no_result_is_never_replaced_silently(tmp_path: Path):
    path = record(tmp_path / "a.mcap", restitution=0.6, height_m=1.0)
    (tmp_path / "a.json").write_text("mine")
    (result,) = tune_all([path], TuneOptions(), None, 1, QUIET)
    assert "a.json: exists, and is no tuning that tunenet-logs wrote" in (result.trouble or "")
    assert (tmp_path / "a.json").read_text() == "mine"
    (tmp_path / "a.json").unlink()
    (tmp_path / "a.rrd").write_bytes(b"RRF2 of something else")
    (result,) = tune_all([path], TuneOptions(), None, 1, QUIET)
    assert "a.rrd: exists, and is no review that tunenet-logs wrote" in (result.trouble or "")


def test_a_log_that_is_gone_is_missing_and_its_results_stay(tmp_path: Path):
    path = record(tmp_path / "a.mcap", restitution=0.6, height_m=1.0)
    tune_all([path], TuneOptions(), None, 1, QUIET)
    before = (tmp_path / "a.json").read_bytes()
    path.unlink()
    (result,) = tune_all([path], TuneOptions(), None, 1, QUIET)
    assert "no such file" in (result.row.record.reason or "")
    assert (tmp_path / "a.json").read_bytes() == before


def test_a_review_without_its_json_is_known_by_its_log(tmp_path: Path):
    """A run that was killed between the two is no obstacle to the next."""
    path = record(tmp_path / "a.mcap", restitution=0.6, height_m=1.0)
    tune_all([path], TuneOptions(), None, 1, QUIET)
    (tmp_path / "a.json").unlink()
    (result,) = tune_all([path], TuneOptions(), None, 1, QUIET)
    assert result.trouble is None


def test_logs_of_one_stem_get_their_folders_names(tmp_path: Path):
    logs = []
    for folder in ("left", "right"):
        (tmp_path / folder).mkdir()
        logs.append(record(tmp_path / folder / "drop.mcap", restitution=0.6, height_m=1.0))
    tune_all(logs, TuneOptions(), tmp_path / "out", 1, QUIET)
    names = sorted(path.name for path in (tmp_path / "out").glob("*.json"))
    assert names == ["left_drop.json", "right_drop.json"]


def test_a_log_and_a_film_of_one_name_keep_their_suffixes(tmp_path: Path):
    logs = [FoundLog(tmp_path / name) for name in ("a.mcap", "b.mcap", "b.mp4")]
    names = result_names(logs, tmp_path / "out")
    assert [name.name for name in names] == ["a", "b.mcap", "b.mp4"]


def test_the_same_log_twice_is_tuned_once(tmp_path: Path):
    path = record(tmp_path / "a.mcap", restitution=0.6, height_m=1.0)
    assert len(tune_all([path, path], TuneOptions(), None, 1, QUIET)) == 1


def test_an_output_that_is_a_file_is_refused_before_any_work(drop_log: Path):
    with pytest.raises(LogError, match="not a folder"):
        tune_all([drop_log], TuneOptions(), drop_log, 1, QUIET)


def test_an_output_that_cannot_be_written_is_told_with_the_result(drop_log: Path):
    (result,) = tune_all([drop_log], TuneOptions(), Path("/proc/nowhere"), 1, QUIET)
    assert result.row.record.verdict == "ok"
    assert "cannot be written" in (result.trouble or "")


def test_a_full_disk_is_one_line_and_leaves_no_half_file(drop_log: Path, tmp_path: Path):
    code = f"""
import resource, signal, sys
from tunenet_logs.analysis.cli.tune import main
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000))
sys.exit(main([{str(drop_log)!r}, "-o", {str(tmp_path / "out")!r}]))
"""
    words = [sys.executable, "-c", code]
    result = subprocess.run(words, capture_output=True, text=True, timeout=60)
    assert result.returncode == 1
    assert "0.7000" in result.stdout
    assert result.stderr.count("\n") == 1
    assert "cannot be written (File too large)" in result.stderr
    assert not list((tmp_path / "out").glob("*.rrd*"))


@pytest.mark.parametrize("jobs", [1, 2])
def test_weights_that_are_none_stop_at_once(drop_log: Path, tmp_path: Path, jobs: int):
    other = record(tmp_path / "b.mcap", restitution=0.6, height_m=1.0)
    with pytest.raises(WeightsError):
        tune_all([drop_log, other], TuneOptions(weights=drop_log), None, jobs, QUIET)


@pytest.mark.parametrize("jobs", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_options_that_fit_no_log_stop_at_once(drop_log: Path, tmp_path: Path, jobs: int):
    other = record(tmp_path / "b.mcap", restitution=0.6, height_m=1.0)
    with pytest.raises(UsageError):
        tune_all([drop_log, other], TuneOptions(initial=(2.0,)), None, jobs, QUIET)


@pytest.mark.parametrize("name", ["drop.json", "drop.rrd"])
def test_a_log_is_never_replaced_by_its_own_results(drop_log: Path, name: str):
    path = drop_log.rename(drop_log.with_name(name))
    before = path.read_bytes()
    with pytest.raises(UsageError, match="is a log"):
        tune_all([path], TuneOptions(), None, 1, QUIET)
    assert path.read_bytes() == before


def test_one_file_by_two_paths_is_tuned_once(drop_log: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(drop_log.parent)
    assert len(tune_all([Path(drop_log.name), drop_log], TuneOptions(), None, 2, QUIET)) == 1


def test_a_name_that_is_not_utf8_is_no_obstacle(drop_log: Path):
    import os

    path = drop_log.rename(drop_log.with_name(os.fsdecode(b"bad\xff.mcap")))
    (result,) = tune_all([path], TuneOptions(), None, 1, QUIET)
    assert result.row.record.verdict == "ok"
    assert result.trouble is None
    assert result.review is not None
    assert result.review.exists()


def test_what_follows_a_dot_in_a_name_stays_in_it(tmp_path: Path):
    logs = [record(tmp_path / f"drop.{one}.mcap", restitution=0.6, height_m=1.0) for one in "12"]
    tune_all(logs, TuneOptions(), tmp_path / "out", 1, QUIET)
    names = sorted(one.name for one in (tmp_path / "out").glob("*.json"))
    assert names == ["drop.1.json", "drop.2.json"]
