"""Many logs: one bad one never stops the rest, and results go where they should."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from tests.analysis.batch.test_ledger import write_drop
from tests.conftest import record, tune_all
from tunenet_logs.analysis.batch.logs import FoundLog, find_logs, result_names
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.errors import UsageError, WeightsError
from tunenet_logs.terminal import Progress

QUIET = Progress(quiet=True)
PLAIN = TuneOptions()


def test_a_log_that_is_tuned_again_replaces_its_own_results(drop_log: Path):
    """And those of a run that was killed between the two; one that is gone has its kept."""
    written = drop_log.with_suffix(".json")
    tune_all([drop_log], PLAIN, None, 1, QUIET)
    (result,) = tune_all([drop_log], TuneOptions(method="fit"), None, 1, QUIET)
    assert result.trouble is None
    report = json.loads(written.read_text())
    assert report["method"] == "fit"
    assert report["provenance"]["options"] == {"method": "fit"}
    written.unlink()
    (result,) = tune_all([drop_log], PLAIN, None, 1, QUIET)
    assert result.trouble is None
    before = written.read_bytes()
    drop_log.unlink()
    (result,) = tune_all([drop_log], PLAIN, None, 1, QUIET)
    assert "no such file" in (result.row.record.reason or "")
    assert written.read_bytes() == before
    assert not list(drop_log.parent.glob("*.partial"))


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("other/a.mcap", "of another a.mcap, or of this one before it changed, not of"),
        ("other.mcap", "is the tuning of a.mcap, not of"),
    ],
)
def test_results_of_another_log_are_never_replaced_silently(tmp_path: Path, name: str, said: str):
    (tmp_path / "other").mkdir()
    path = record(tmp_path / "a.mcap", restitution=0.6, height_m=1.0)
    other = record(tmp_path / name, restitution=0.8, height_m=1.0)
    out = tmp_path / "out"
    tune_all([path], PLAIN, out, 1, QUIET)
    if other.stem != "a":
        for suffix in (".json", ".rrd"):
            (out / f"a{suffix}").rename(out / f"other{suffix}")
    before = {file.name: file.read_bytes() for file in out.iterdir()}
    (result,) = tune_all([other], PLAIN, out, 1, QUIET)
    assert all(one in (result.trouble or "") for one in (said, str(other), "--overwrite"))
    assert {file.name: file.read_bytes() for file in out.iterdir()} == before
    (result,) = tune_all([other], PLAIN, out, 1, QUIET, overwrite=True)
    assert result.trouble is None
    assert json.loads((out / f"{other.stem}.json").read_text())["log"] == other.name


@pytest.mark.parametrize(
    ("logs", "names"),
    [
        ("a.mcap b.mcap b.mp4", "a b.mcap b.mp4"),
        ("left/drop.mcap right/drop.mcap", "left_drop right_drop"),
        ("drop.1.mcap drop.2.mcap", "drop.1 drop.2"),
        ("drop.mcap.active", "drop"),
    ],
)
def test_results_are_called_by_their_log_and_never_alike(tmp_path: Path, logs: str, names: str):
    found = [FoundLog(tmp_path / one) for one in logs.split()]
    assert [one.name for one in result_names(found, tmp_path / "out")] == names.split()


def test_a_log_by_two_names_is_tuned_once(drop_log: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(drop_log.parent)
    assert len(tune_all([Path(drop_log.name), drop_log, drop_log], PLAIN, None, 2, QUIET)) == 1


def test_a_name_that_is_not_utf8_is_no_obstacle(drop_log: Path):
    path = drop_log.rename(drop_log.with_name(os.fsdecode(b"bad\xff.mcap")))
    (result,) = tune_all([path], PLAIN, None, 1, QUIET)
    assert result.row.record.verdict == "ok"
    assert result.trouble is None
    assert result.review is not None
    assert result.review.exists()


def test_what_fits_no_log_stops_at_once_in_a_process_of_its_own_too(drop_log: Path, tmp_path: Path):
    logs = [drop_log, record(tmp_path / "b.mcap", restitution=0.6, height_m=1.0)]
    with pytest.raises(WeightsError):
        tune_all(logs, TuneOptions(weights=drop_log), None, 2, QUIET)


@pytest.mark.parametrize("name", ["drop.json", "drop.rrd"])
def test_a_log_is_never_replaced_by_its_own_results(drop_log: Path, name: str):
    path = drop_log.rename(drop_log.with_name(name))
    before = path.read_bytes()
    with pytest.raises(UsageError, match="is a log"):
        tune_all([path], PLAIN, None, 1, QUIET)
    assert path.read_bytes() == before


def test_links_in_circles_and_to_nowhere_are_left_out_and_patterns_are_what_they_say(
    tmp_path: Path,
):
    drop = write_drop(tmp_path / "my runs [1]" / "a drop.mcap", 0)
    (drop.parent / "again").symlink_to(drop.parent)
    (drop.parent / "self.mcap").symlink_to(drop.parent / "self.mcap")
    (drop.parent / "gone.mcap").symlink_to(tmp_path / "gone.mcap")
    found = find_logs([drop.parent])
    assert ([one.log for one in found.logs], found.left_out) == ([drop], 3)
    for named in (tmp_path / "my runs*" / "a*.mcap", drop):
        assert [one.log for one in find_logs([str(named)]).logs] == [drop]
