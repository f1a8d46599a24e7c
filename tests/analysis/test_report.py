"""Pages as a browser opens them: whole, without a network, the JSON's figures, and safe."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tests.analysis.records import drop_record, rejected_record
from tests.conftest import ROOT, Command, real
from tunenet_logs.analysis.record import to_json
from tunenet_logs.analysis.report.figures import signals_drawing
from tunenet_logs.analysis.report.page import embedded
from tunenet_logs.analysis.review.drawing import MAX_SIGNALS, ReviewedSignal
from tunenet_logs.images import decode_image

LOGS = ("filmed", "light", "payload")
MAX_BYTES = 3_000_000
CHROMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
WIDTHS = {"desktop": (1280, 720), "phone": (390, 844)}  # of a window [px]: width and height


INJECTED = (
    "<script>alert(1)</script>",
    '"><img src=http://127.0.0.1:9/x onerror=alert(2)>',
    "{{ 7 * 7 }}{% raw %}",
    "</style></title><svg onload=alert(3)>",
    "javascript:alert(4)",
    "$\\frac{1}{$ _x^ \\input{/etc/passwd}",
    "]]>--><!--<iframe src='file:///etc/passwd'>",
    "\u202egnp.exe\u0000\x1b[31m\ud800",
    "&lt;b&gt;&#x3c;script&#x3e;",
    "W" * 5000,
)


@dataclass(frozen=True)
class Opened:
    """What a browser made of a page.

    Attributes:
        text: that is seen.
        height_px: of the whole page.
        picture: of the first window.
    """

    text: str
    height_px: int
    picture: bytes


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """A Chromium or Chrome that is installed, without a screen."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="needs playwright")
    place = next(filter(None, map(shutil.which, CHROMES)), None)
    if place is None:
        pytest.skip("needs Chromium or Chrome, which is not installed")
    with sync_api.sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=place, args=["--no-sandbox"])
        yield opened
        opened.close()


def opened(browser: Any, path: Path, width: str = "desktop", script: str = "") -> Opened:
    """Open a page from the disk; `script` must be true in it.

    Every page is small and as wide as the window, asks for nothing and says nothing.
    """
    assert path.stat().st_size < MAX_BYTES
    across, down = WIDTHS[width]
    page = browser.new_page(viewport={"width": across, "height": down})
    requests: list[str] = []
    messages: list[str] = []
    page.on("request", lambda one: requests.append(one.url))
    page.on("console", lambda one: messages.append(one.text))
    page.on("pageerror", lambda one: messages.append(str(one)))
    page.on("dialog", lambda one: (messages.append(f"dialog: {one.message}"), one.dismiss()))
    page.goto(path.as_uri())
    root = "document.documentElement"
    assert page.evaluate(f"{root}.scrollWidth - {root}.clientWidth") == 0
    height_px = page.evaluate(f"{root}.scrollHeight")
    found = Opened(page.inner_text("body"), height_px, page.screenshot())
    assert not script or page.evaluate(script), script
    page.close()
    assert [one for one in requests if not one.startswith("data:")] == [path.as_uri()]
    assert not messages
    return found


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
    pages = {f"{name}.html": tuned / f"{name}.json" for name in (*LOGS, "still")}
    for page, source in {**pages, "all.html": tuned}.items():
        done = command("tunenet-report", source, "-o", tuned / page)
        assert done.returncode == 0, done.stderr
    done = command("tunenet-compare", tuned, "--html", tuned / "compared.html")
    assert done.returncode == 0, done.stderr
    return tuned


PAGES = (*LOGS, "still", "all", "compared")


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("name", PAGES)
def test_a_page_opens_from_the_disk_and_needs_nothing_else(
    browser: Any, reports: Path, name: str, width: str
):
    path = reports / f"{name}.html"
    page = opened(browser, path, width, IMAGES_ARE_DRAWN if name != "still" else "")
    assert page.height_px > 700
    assert len(page.text) > 400
    assert decode_image(page.picture, "png").std() > 10, "the first window is empty"


@pytest.mark.parametrize("name", LOGS)
def test_the_figures_of_a_page_are_those_of_the_json(browser: Any, reports: Path, name: str):
    known = json.loads((reports / f"{name}.json").read_text())
    text = opened(browser, reports / f"{name}.html").text
    for parameter in known["parameters"].values():
        values, ends = np.ravel(parameter["value"]), np.reshape(parameter["interval95"], (-1, 2))
        for value, (low, high) in zip(values, ends, strict=True):
            assert f"{round(value, 4) + 0.0:.4f}" in text
            widths = [f"{low:.{digits}f} to {high:.{digits}f}" for digits in (4, 5, 6)]
            assert any(one in text for one in widths), widths
    for bounce in known["bounces"]:
        assert f"{bounce['time_s']:.4f}\t{bounce['restitution']:.4f}\t" in text
        assert f"{bounce['impact_speed']:.3f}" in text
    for check in known["checks"]:
        assert check["name"] in text
        assert check["detail"].split(" (")[0] in text
    for step in known["iterations"]:
        assert f"\t{round(list(step.values())[1], 4) + 0.0:.4f}" in text
    assert known["provenance"]["log_sha256"] in text
    assert known["provenance"]["date"] in text
    assert known["simulator"]["engine"] in text
    assert known["weights"]["sha256"] in text
    if fit := known["simulation_fit"]:
        assert f"{fit['rms_percent']:.2f} % of the drop height, rms" in text


def test_the_verdict_comes_first_and_says_what_to_do(browser: Any, reports: Path):
    ok = opened(browser, reports / "filmed.html").text
    assert ok.startswith("filmed.mcap\n")
    assert 0 < ok.index("✓ ok") < ok.index("tunenet-export filmed.json") < ok.index("restitution")
    rejected = opened(browser, reports / "still.html").text
    known = json.loads((reports / "still.json").read_text())
    assert 0 < rejected.index("✕ rejected") < rejected.index(known["reason"][:80])
    assert "Parameters" not in rejected


def test_several_tunings_have_an_overview_with_links_and_a_comparison(browser: Any, reports: Path):
    links = "[...document.querySelectorAll('nav a')]"
    script = f"{links}.length == 4 && {links}.every(one => document.querySelector(one.hash))"
    text = opened(browser, reports / "all.html", script=script).text
    assert "4 tunings · 3 ok · 1 rejected" in text
    assert "restitution: they differ" in text
    compared = opened(browser, reports / "compared.html").text
    assert "Holm" in compared
    assert re.search(r"Without a value\n.*still\.csv", compared, re.DOTALL)


def written(command: Command, *words: object) -> str:
    """The page that a report writes."""
    done = command("tunenet-report", *words, "--overwrite", "--quiet")
    assert done.returncode == 0, done.stderr
    return next(Path(str(one)).read_text() for one in words if str(one).endswith(".html"))


def test_a_film_shows_its_pictures_a_payload_its_torques_and_a_page_is_the_same_each_time(
    reports: Path, tmp_path: Path, command: Command
):
    film, payload = ((reports / f"{name}.html").read_text() for name in ("filmed", "payload"))
    assert film.count("data:image/jpeg;base64,") == 2
    assert "20 pictures from" in film
    assert "circles where the ball was found" in film
    assert "joint 7" in payload
    assert "Measured and simulated torques" in payload
    assert "data:image/jpeg" not in payload
    assert written(command, reports / "filmed.json", "-o", tmp_path / "again.html") == film
    assert re.match("<!doctype html>\n<!-- tunenet-logs page of [^ ]+@[0-9a-f]{32} -->", film)


@pytest.mark.parametrize(
    ("name", "words"), [("filmed", "No pictures of the film"), ("payload", "No torques")]
)
def test_without_the_review_the_page_says_what_is_missing(
    tuned: Path, tmp_path: Path, command: Command, name: str, words: str
):
    """The review of another log counts as none."""
    path = Path(shutil.copy(tuned / f"{name}.json", tmp_path))
    for why in ("is not beside the JSON", "the review of another log"):
        page = written(command, path, "-o", tmp_path / "a.html")
        assert words in page
        assert why in page
        assert "data:image/jpeg" not in page
        shutil.copy(tuned / "light.rrd", path.with_suffix(".rrd"))


MODELS = ROOT / "sample_logs" / "models"


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory, command: Command) -> Path:
    """The JSON of a tuned arm, beside its review."""
    folder = tmp_path_factory.mktemp("model")
    tuned = ("--model", MODELS / "arm.xml", "--tune", MODELS / "arm.yaml")
    done = command("tunenet-tune", MODELS / "arm.mcap", *tuned, "-o", folder, "--quiet")
    assert done.returncode == 0, done.stderr
    return folder / "arm.json"


@pytest.mark.parametrize("width", WIDTHS)
def test_a_model_shows_its_signals_beside_the_log(
    browser: Any, model: Path, command: Command, width: str
):
    page, table = model.with_suffix(".html"), model.with_suffix(".csv")
    written(command, model, "-o", page, "--csv", table)
    text = opened(browser, page, width, IMAGES_ARE_DRAWN).text
    assert "Observed and simulated" in text
    assert "No two values hang together" in text
    assert "are not drawn" not in text
    # They jump with each command: what is faster than the motion is no noise of a sensor.
    jumpy = re.search(r"as fast as noise: (.*)\.", text)
    assert jumpy is not None
    assert {"effort shoulder", "effort elbow"} <= set(jumpy[1].split(", "))
    assert "position" not in jumpy[1]
    curves, known = pd.read_csv(table, comment="#"), json.loads(model.read_text())
    for gap in known["gaps"]:
        name = gap["signal"].partition(".")[2].replace(" ", "_")
        unit = {"rad": "rad", "rad/s": "rad_per_s", "N·m": "nm"}[gap["unit"]]
        off = [
            curves[f"{name}_{of}_{unit}"] - curves[f"{name}_observed_{unit}"]
            for of in ("given", "tuned")
        ]
        assert gap["rms"] == pytest.approx([np.sqrt(np.mean(one**2)) for one in off], rel=1e-6)


def test_a_model_without_its_review_says_so(model: Path, tmp_path: Path, command: Command):
    alone = Path(shutil.copy(model, tmp_path))
    page = written(command, alone, "-o", tmp_path / "page.html")
    assert "No curves of signals: the JSON holds none, and arm.rrd is not beside" in page


def test_a_tuning_in_place_of_a_log_is_known(model: Path, command: Command):
    for code, place in ((2, ()), (1, ("-o", model.parent / "other"))):
        done = command("tunenet-tune", model, "--model", MODELS / "arm.xml", *place)
        assert done.returncode == code
        assert "arm.json: is a tuning that tunenet-tune wrote; name the log it is" in done.stderr
        assert "or give it to tunenet-export or tunenet-report" in done.stderr


def made_signal(number: int, **changed: Any) -> ReviewedSignal:
    """Ten seconds of a sine; as given it runs off."""
    seconds = np.arange(0.0, 10.0, 0.01)
    observed = np.sin((1 + number) * seconds)
    curves = {"given": np.exp(5 * seconds), "tuned": observed + 0.01, "predicted": observed - 0.02}
    made = ReviewedSignal(f"position j{number}", "rad", seconds, observed, curves, 0.01, 6.0)
    return replace(made, **changed)


def test_many_signals_stay_readable_and_those_left_out_are_counted():
    drawing = signals_drawing([made_signal(number) for number in range(MAX_SIGNALS)], 7)
    assert drawing is not None
    assert "7 more, of which less is left, are not drawn." in drawing.caption
    charts = [axes for axes in drawing.figure.axes if axes.axison]
    assert len(charts) == 2 * MAX_SIGNALS
    _, height_in = drawing.figure.get_size_inches()
    assert height_in > 0.8 * MAX_SIGNALS
    overlay, residual = charts[0], charts[2]
    assert np.abs(overlay.get_ylim()).max() < 2.5, "what is given runs off"
    assert np.abs(residual.get_ylim()) == pytest.approx([0.026, 0.026])
    (band,) = [one for one in residual.patches if one.get_alpha() is None]
    assert band.get_extents().transformed(residual.transData.inverted()).intervaly == pytest.approx(
        [-0.02, 0.02]
    )


@pytest.mark.parametrize(
    "changed",
    [
        {"noise": np.nan, "held_out_s": np.nan},
        {"curves": {}},
        {"curves": {"given": np.full(1000, np.nan), "closest": np.full(1000, np.nan)}},
        {"curves": {"strange": np.zeros(1000)}, "name": INJECTED[5], "unit": INJECTED[0]},
        {"observed": np.full(1000, 1e300)},
    ],
)
def test_signals_that_no_review_of_ours_has(changed: dict[str, Any]):
    drawing = signals_drawing([made_signal(0, **changed)], 0)
    assert drawing is not None
    assert embedded(drawing).startswith("data:image/svg+xml")


SPOILT: dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda _: b"",
    "noise": lambda _: bytes(range(256)) * 40,
    "half": lambda whole: whole[: len(whole) // 2],
    "changed": lambda whole: (
        whole[: len(whole) // 3] + bytes(5000) + whole[len(whole) // 3 + 5000 :]
    ),
}


@pytest.mark.parametrize("spoil", SPOILT)
def test_a_review_that_is_spoilt_leaves_a_page_without_pictures(
    tmp_path: Path, tuned: Path, command: Command, spoil: str
):
    path = Path(shutil.copy(tuned / "filmed.json", tmp_path))
    path.with_suffix(".rrd").write_bytes(SPOILT[spoil]((tuned / "filmed.rrd").read_bytes()))
    page = written(command, path, "-o", tmp_path / "page.html")
    assert "Observed and simulated" in page
    if spoil != "changed":  # damage within a picture may leave the others
        assert "No pictures of the film: filmed.rrd" in page


def test_a_campaign_has_its_rates_balls_and_attempts(
    tmp_path: Path, browser: Any, command: Command
):
    for log in (ROOT / "sample_logs" / "campaign").glob("*.mcap"):
        shutil.copy(log, tmp_path)
    command("tunenet-tune", *sorted(tmp_path.glob("drop_*.mcap")), "--quiet")
    out = tmp_path / "campaign.html"
    written(command, tmp_path, "-o", out, "--jobs", 1)
    reviewed = command("tunenet-review", tmp_path, "-o", tmp_path / "c.rrd", "--quiet", "--jobs", 1)
    page = opened(browser, out, "phone", IMAGES_ARE_DRAWN)
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
    tmp_path: Path, browser: Any, command: Command, name: str
):
    log, out = real(name), tmp_path / "page.html"
    command("tunenet-tune", log, "-o", tmp_path, "--quiet")
    written(command, tmp_path / f"{log.stem}.json", "-o", out)
    for width in WIDTHS:
        assert opened(browser, out, width).text.startswith(log.name)


# ---- What a stranger wrote into a tuning


NOTHING_FOREIGN = (
    "!document.querySelector('script, iframe, object, embed, svg, form, base, [onerror], [onload]')"
    " && [...document.querySelectorAll('img, link')]"
    ".every(one => (one.src || one.href).startsWith('data:'))"
    " && [...document.querySelectorAll('a')].every(one => one.getAttribute('href')[0] == '#')"
)


def fields() -> dict[str, Any]:
    """The JSON of a drop."""
    return json.loads(to_json(drop_record(0.7, slope=(0.05, 0.01), slowest_m_s=2.0)))


def hostile(word: str) -> dict[str, Any]:
    """A tuning whose every text is somebody else's word."""
    check = {"name": word, "passed": False, "detail": word, "advice": word}
    known = {"value": 1.0, "interval95": [0.5, 1.5], "unit": word}
    told = dict.fromkeys(("version", "log_sha256", "date", "engine"), word)
    heights = {"observed_m": [1.0, 0.0, 0.5], "simulated_m": [1.0, None, 0.5]}
    return {
        **fields(),
        **dict.fromkeys(("log", "reason", "ball", "topic", "method"), word),
        "verdict": "suspect",
        "warnings": [word, word],
        "unidentifiable": [word],
        "parameters": {**fields()["parameters"], word: known},
        "iterations": [{"k": 0, word: 0.0}, {"k": 1, word: 1.0}],
        "checks": [check, check],
        "cross_check": {"method": word, "value": 0.7, "agrees": False},
        "simulator": {"engine": word, "preset": word, word: word},
        "weights": {word: word},
        "window": {"impact_s": 0.5, word: 1.0},
        "seconds": {word: 1.0},
        "provenance": {**told, "options": {word: word}, "tare": {word: word}},
        "curves": {"start_ns": 0, "seconds": [0.0, 0.5, 1.0], **heights},
    }


def write(path: Path, fields: dict[str, Any]) -> Path:
    path.write_text(json.dumps(fields))
    return path


@pytest.mark.parametrize("number", [1, 7])  # all of them: the next test
def test_words_of_others_are_words(tmp_path: Path, browser: Any, command: Command, number: int):
    word, out = INJECTED[number], tmp_path / "page.html"
    path = write(tmp_path / "hostile.json", hostile(word))
    written(command, path, "-o", out, "--pdf", tmp_path / "figures")
    for width in WIDTHS:
        page = opened(browser, out, width, NOTHING_FOREIGN)
        if word.isprintable() and len(word) < 100:
            assert word in page.text
        assert "49" not in page.text.split("Parameters")[0]


def test_hostile_tunings_beside_each_other(tmp_path: Path, browser: Any, command: Command):
    """Twins with one name, and all of the names in one comparison."""
    for number, word in enumerate([*INJECTED, INJECTED[0]]):
        write(tmp_path / f"{number}.json", hostile(word))
    out, compared = tmp_path / "page.html", tmp_path / "compared.html"
    written(command, tmp_path, "-o", out)
    done = command("tunenet-compare", tmp_path, "--html", compared, "--png", tmp_path / "c.png")
    assert done.returncode == 0, done.stderr
    assert not {"\x1b", "\u202e"} & set(done.stdout)
    for path in (out, compared):
        opened(browser, path, "phone", NOTHING_FOREIGN)


@pytest.mark.parametrize("value", [1e308, -1e308, 5e-324])
def test_numbers_that_no_tuning_has(tmp_path: Path, command: Command, value: float):
    known = fields()
    known["parameters"]["restitution"] = {"value": value, "interval95": [-abs(value), abs(value)]}
    known["parameters"]["drag"] = {"value": value, "interval95": None, "unit": "1/m"}
    known["iterations"] = [{"k": 0, "restitution": -value}, {"k": 1, "restitution": value}]
    bounce = {"restitution": value, "interval95": None, "impact_speed": abs(value)}
    known["bounces"] = [bounce | {"time_s": value}] * 3
    first = write(tmp_path / "a.json", known)
    second = write(tmp_path / "b.json", {**known, "log": "other"})
    out = tmp_path / "page.html"
    for words in (("tunenet-report", first, "-o", out), ("tunenet-compare", first, second)):
        done = command(*words)
        assert done.returncode in (0, 1)
        assert "Traceback" not in done.stderr
    assert out.stat().st_size < MAX_BYTES


def test_very_many_rows_are_counted(tmp_path: Path, command: Command):
    check = {"name": "c" * 900, "passed": False, "detail": "(" * 900, "advice": "a" * 900}
    told = {"checks": [check] * 1200, "warnings": [f"w{number}" for number in range(5000)]}
    known = json.loads(to_json(rejected_record(log="many.mcap"))) | told
    page = written(command, write(tmp_path / "many.json", known), "-o", tmp_path / "page.html")
    assert "1100 more checks, 4900 more warnings" in page
    assert len(page) < MAX_BYTES
