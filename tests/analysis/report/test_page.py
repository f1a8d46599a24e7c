"""Pages as a browser opens them: whole, without a network, with the figures of the JSON."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from tests.browser import WIDTHS, opened
from tests.conftest import ROOT, Command, real
from tunenet_logs.images import decode_image

LOGS = ("filmed", "light", "payload")
MAX_BYTES = 3_000_000

IMAGES_ARE_DRAWN = (
    "[...document.images].length > 0 && "
    "[...document.images].every(one => one.naturalWidth > 50 && one.alt.length > 20)"
)


@pytest.fixture(scope="module")
def tuned(tmp_path_factory: pytest.TempPathFactory, command: Command) -> Path:
    """A folder with tunings and reviews of sample logs, and of one without a drop in it."""
    folder = tmp_path_factory.mktemp("tuned")
    still = folder / "still.csv"
    still.write_text("t,z\n" + "".join(f"{k / 100},1.0\n" for k in range(200)))
    logs = [*(ROOT / "sample_logs" / f"{name}.mcap" for name in LOGS), still]
    command("tunenet-tune", *logs, "-o", folder, "--quiet")
    assert {path.stem for path in folder.glob("*.json")} == {*LOGS, "still"}
    return folder


@pytest.fixture(scope="module")
def reports(tuned: Path, command: Command) -> Path:
    """A page of each, one of all, and a comparison's."""
    for name in (*LOGS, "still"):
        done = command("tunenet-report", tuned / f"{name}.json", "-o", tuned / f"{name}.html")
        assert done.returncode == 0, done.stderr
    done = command("tunenet-report", tuned, "-o", tuned / "all.html")
    assert done.returncode == 0, done.stderr
    done = command("tunenet-compare", tuned, "--html", tuned / "compared.html")
    assert done.returncode == 0, done.stderr
    return tuned


PAGES = (*LOGS, "still", "all", "compared")


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("name", PAGES)
def test_a_page_opens_from_the_disk_and_needs_nothing_else(
    reports: Path,
    browser: Any,
    name: str,
    width: str,
):
    path = reports / f"{name}.html"
    assert path.stat().st_size < MAX_BYTES
    has_figures = name != "still"
    page = opened(browser, path, width, IMAGES_ARE_DRAWN if has_figures else "")
    assert page.requests == [path.as_uri()]
    assert not page.messages
    assert page.overflow_px == 0
    assert page.height_px > 700
    assert len(page.text) > 400
    assert decode_image(page.picture, "png").std() > 10, "the first window is empty"


@pytest.mark.parametrize("name", LOGS)
def test_the_figures_of_a_page_are_those_of_the_json(reports: Path, browser: Any, name: str):
    known = json.loads((reports / f"{name}.json").read_text())
    text = opened(browser, reports / f"{name}.html").text
    for parameter in known["parameters"].values():
        values, ends = parameter["value"], parameter["interval95"]
        if not isinstance(values, list):
            values, ends = [values], [ends]
        for value, (low, high) in zip(values, ends, strict=True):
            assert f"{round(value, 4) + 0.0:.4f}" in text
            assert any(f"{low:.{digits}f} to {high:.{digits}f}" in text for digits in (4, 5, 6)), (
                low,
                high,
            )
    for bounce in known["bounces"]:
        row = f"{bounce['time_s']:.4f}\t{bounce['restitution']:.4f}\t"
        assert row in text
        assert f"{bounce['impact_speed']:.3f}" in text
    for check in known["checks"]:
        assert check["name"] in text
        assert check["detail"].split(" (")[0] in text
    for step in known["iterations"]:
        assert f"\t{round(next(iter(list(step.values())[1:])), 4) + 0.0:.4f}" in text
    assert known["provenance"]["log_sha256"] in text
    assert known["provenance"]["date"] in text
    assert known["simulator"]["engine"] in text
    assert known["weights"]["sha256"] in text
    fit = known["simulation_fit"]
    if fit is not None:
        assert f"{fit['rms_percent']:.2f} % of the drop height, rms" in text


def test_the_verdict_comes_first_and_says_what_to_do(reports: Path, browser: Any):
    ok = opened(browser, reports / "filmed.html").text
    assert ok.startswith("filmed.mcap\n")
    assert 0 < ok.index("✓ ok") < ok.index("tunenet-export filmed.json") < ok.index("restitution")
    rejected = opened(browser, reports / "still.html").text
    known = json.loads((reports / "still.json").read_text())
    assert 0 < rejected.index("✕ rejected") < rejected.index(known["reason"][:80])
    assert "Parameters" not in rejected


def test_a_film_shows_its_pictures_with_the_track_and_a_payload_its_torques(reports: Path):
    film, payload = ((reports / f"{name}.html").read_text() for name in ("filmed", "payload"))
    assert film.count("data:image/jpeg;base64,") == 2
    assert "20 pictures from" in film
    assert "circles where the ball was found" in film
    assert "joint 7" in payload
    assert "Measured and simulated torques" in payload
    assert "data:image/jpeg" not in payload


def test_without_the_review_the_page_says_what_is_missing(
    tuned: Path, tmp_path: Path, command: Command
):
    """The review of another log counts as none."""
    other = tuned / "light.rrd"
    for name, words in (("filmed", "No pictures of the film"), ("payload", "No torques")):
        path = tmp_path / f"{name}.json"
        path.write_bytes((tuned / f"{name}.json").read_bytes())
        for beside, why in ((None, "is not beside the JSON"), (other, "the review of another log")):
            if beside is not None:
                path.with_suffix(".rrd").write_bytes(beside.read_bytes())
            out = tmp_path / f"{name}.html"
            done = command("tunenet-report", path, "-o", out, "--overwrite")
            assert done.returncode == 0, done.stderr
            page = out.read_text()
            assert words in page
            assert why in page
            assert "data:image/jpeg" not in page


def test_several_tunings_have_an_overview_with_links_and_a_comparison(
    reports: Path,
    browser: Any,
):
    script = "[...document.querySelectorAll('nav a')].length == 4 && "
    script += (
        "[...document.querySelectorAll('nav a')].every(one => document.querySelector(one.hash))"
    )
    text = opened(browser, reports / "all.html", script=script).text
    assert "4 tunings · 3 ok · 1 rejected" in text
    assert "restitution: they differ" in text
    compared = opened(browser, reports / "compared.html").text
    assert "Holm" in compared
    assert re.search(r"Without a value\n.*still\.csv", compared, re.DOTALL)


def test_a_page_is_marked_and_the_same_each_time(reports: Path, tmp_path: Path, command: Command):
    again = tmp_path / "again.html"
    assert command("tunenet-report", reports / "filmed.json", "-o", again).returncode == 0
    assert again.read_bytes() == (reports / "filmed.html").read_bytes()
    assert re.match(
        "<!doctype html>\n<!-- tunenet-logs page of [^ ]+@[0-9a-f]{32} -->", again.read_text()
    )


def test_a_campaign_has_its_rates_balls_and_attempts(
    tmp_path: Path, browser: Any, command: Command
):
    folder = ROOT / "sample_logs" / "campaign"
    for log in folder.glob("*.mcap"):
        (tmp_path / log.name).write_bytes(log.read_bytes())
    command("tunenet-tune", *sorted(tmp_path.glob("drop_*.mcap")), "--quiet")
    out = tmp_path / "campaign.html"
    done = command("tunenet-report", tmp_path, "-o", out, "--quiet", "--jobs", 1)
    assert done.returncode == 0, done.stderr
    reviewed = command("tunenet-review", tmp_path, "-o", tmp_path / "c.rrd", "--quiet", "--jobs", 1)
    assert out.stat().st_size < MAX_BYTES
    page = opened(browser, out, "phone", IMAGES_ARE_DRAWN)
    assert page.requests == [out.as_uri()]
    assert page.overflow_px == 0
    for line in reviewed.stdout.splitlines():
        if counted := re.search(r"^(.{30})  (\d+)/(\d+) = ", line):
            name, successes, count = (one.strip() for one in counted.groups())
            assert f"{name}\t{successes} of {count}\t" in page.text
        if ball := re.search(r"^(.{30})  restitution ([\d.]+)", line):
            assert f"{ball[1].strip()}\t{ball[2]}\t" in page.text


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("videos/red_ball_drop_120fps.mp4", marks=pytest.mark.slow),
        "labs/motive_basketball_10.csv",
        "ros1/jaco2_no_effort.bag",
    ],
)
def test_logs_that_others_made_have_a_page(
    tmp_path: Path,
    browser: Any,
    command: Command,
    name: str,
):
    log = real(name)
    command("tunenet-tune", log, "-o", tmp_path, "--quiet")
    out = tmp_path / "page.html"
    done = command("tunenet-report", tmp_path / f"{log.stem}.json", "-o", out)
    assert done.returncode == 0, done.stderr
    assert out.stat().st_size < MAX_BYTES
    for width in WIDTHS:
        page = opened(browser, out, width)
        assert page.requests == [out.as_uri()]
        assert not page.messages
        assert page.overflow_px == 0
        assert page.text.startswith(log.name)
