"""Tunings that strangers made up: no word of them runs, loads, hides or breaks a page."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.analysis.records import drop_record, rejected_record
from tests.browser import WIDTHS, opened
from tests.conftest import Command
from tunenet_logs.analysis.record import to_json

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

NOTHING_FOREIGN = (
    "!document.querySelector('script, iframe, object, embed, svg, form, base, [onerror], [onload]')"
    " && [...document.querySelectorAll('img, link')]"
    ".every(one => (one.src || one.href).startsWith('data:'))"
    " && [...document.querySelectorAll('a')].every(one => one.getAttribute('href')[0] == '#')"
)


def hostile(word: str) -> dict[str, Any]:
    """A tuning whose every text is somebody else's word."""
    fields = json.loads(to_json(drop_record(0.7, slope=(0.05, 0.01), slowest_m_s=2.0)))
    check = {"name": word, "passed": False, "detail": word, "advice": word}
    return {
        **fields,
        "log": word,
        "verdict": "suspect",
        "reason": word,
        "ball": word,
        "topic": word,
        "method": word,
        "warnings": [word, word],
        "unidentifiable": [word],
        "parameters": {
            **fields["parameters"],
            word: {"value": 1.0, "interval95": [0.5, 1.5], "unit": word},
        },
        "iterations": [{"k": 0, word: 0.0}, {"k": 1, word: 1.0}],
        "checks": [check, check],
        "cross_check": {"method": word, "value": 0.7, "agrees": False},
        "simulator": {"engine": word, "preset": word, word: word},
        "weights": {word: word},
        "window": {"impact_s": 0.5, word: 1.0},
        "seconds": {word: 1.0},
        "provenance": {
            "version": word,
            "log_sha256": word,
            "options": {word: word},
            "tare": {word: word},
            "date": word,
            "engine": word,
        },
        "curves": {
            "start_ns": 0,
            "seconds": [0.0, 0.5, 1.0],
            "observed_m": [1.0, 0.0, 0.5],
            "simulated_m": [1.0, None, 0.5],
        },
    }


def write(path: Path, fields: dict[str, Any]) -> Path:
    path.write_text(json.dumps(fields))
    return path


@pytest.mark.parametrize("number", [1, 7])  # all of them: the next test
def test_words_of_others_are_words(
    tmp_path: Path,
    browser: Any,
    command: Command,
    number: int,
):
    word = INJECTED[number]
    path = write(tmp_path / "hostile.json", hostile(word))
    out = tmp_path / "page.html"
    done = command("tunenet-report", path, "-o", out, "--pdf", tmp_path / "figures")
    assert done.returncode == 0, done.stderr
    for width in WIDTHS:
        page = opened(browser, out, width, NOTHING_FOREIGN)
        assert page.requests == [out.as_uri()]
        assert not page.messages
        assert page.overflow_px == 0
        if word.isprintable() and len(word) < 100:
            assert word in page.text
        assert "49" not in page.text.split("Parameters")[0]


def test_hostile_tunings_beside_each_other(tmp_path: Path, browser: Any, command: Command):
    """Twins with one name, and all of the names in one comparison."""
    for number, word in enumerate([*INJECTED, INJECTED[0]]):
        write(tmp_path / f"{number}.json", hostile(word))
    out, compared = tmp_path / "page.html", tmp_path / "compared.html"
    assert command("tunenet-report", tmp_path, "-o", out).returncode == 0
    done = command("tunenet-compare", tmp_path, "--html", compared, "--png", tmp_path / "c.png")
    assert done.returncode == 0, done.stderr
    assert "\x1b" not in done.stdout
    assert "\u202e" not in done.stdout
    for path in (out, compared):
        assert path.stat().st_size < 3_000_000
        page = opened(browser, path, "phone", NOTHING_FOREIGN)
        assert page.requests == [path.as_uri()]
        assert not page.messages
        assert page.overflow_px == 0


@pytest.mark.parametrize("value", [1e308, -1e308, 5e-324])
def test_numbers_that_no_tuning_has(tmp_path: Path, command: Command, value: float):
    fields = json.loads(to_json(drop_record(0.7, slope=(0.05, 0.01), slowest_m_s=2.0)))
    fields["parameters"]["restitution"] = {"value": value, "interval95": [-abs(value), abs(value)]}
    fields["parameters"]["drag"] = {"value": value, "interval95": None, "unit": "1/m"}
    fields["iterations"] = [{"k": 0, "restitution": -value}, {"k": 1, "restitution": value}]
    fields["bounces"] = [
        {"restitution": value, "interval95": None, "impact_speed": abs(value), "time_s": value}
    ] * 3
    first = write(tmp_path / "a.json", fields)
    second = write(tmp_path / "b.json", {**fields, "log": "other"})
    out = tmp_path / "page.html"
    for words in (("tunenet-report", first, "-o", out), ("tunenet-compare", first, second)):
        done = command(*words)
        assert done.returncode in (0, 1)
        assert "Traceback" not in done.stderr
    assert out.stat().st_size < 3_000_000


def test_very_many_rows_are_counted(tmp_path: Path, browser: Any, command: Command):
    record = rejected_record(log="many.mcap")
    fields = json.loads(to_json(record))
    check = {"name": "c" * 900, "passed": False, "detail": "(" * 900, "advice": "a" * 900}
    fields["checks"] = [check] * 1200
    fields["warnings"] = [f"w{number}" for number in range(5000)]
    out = tmp_path / "page.html"
    path = write(tmp_path / "many.json", fields)
    assert command("tunenet-report", path, "-o", out).returncode == 0
    assert out.stat().st_size < 3_000_000
    page = opened(browser, out, "phone")
    assert page.overflow_px == 0
    assert "1100 more checks, 4900 more warnings" in page.text


@pytest.fixture(scope="module")
def tuned_film(
    filmed_log: Path, tmp_path_factory: pytest.TempPathFactory, command: Command
) -> Path:
    folder = tmp_path_factory.mktemp("film")
    command("tunenet-tune", filmed_log, "-o", folder, "--quiet")
    return folder / "filmed.json"


@pytest.mark.parametrize(
    "spoil", ["empty", "noise", "half", "changed"], ids=lambda name: f"review-{name}"
)
def test_a_review_that_is_spoilt_leaves_a_page_without_pictures(
    tmp_path: Path, tuned_film: Path, command: Command, spoil: str
):
    tuning, review = tmp_path / "filmed.json", tmp_path / "filmed.rrd"
    tuning.write_bytes(tuned_film.read_bytes())
    whole = tuned_film.with_suffix(".rrd").read_bytes()
    middle = len(whole) // 3
    review.write_bytes(
        {
            "empty": b"",
            "noise": bytes(range(256)) * 40,
            "half": whole[: len(whole) // 2],
            "changed": whole[:middle] + bytes(5000) + whole[middle + 5000 :],
        }[spoil]
    )
    out = tmp_path / "page.html"
    done = command("tunenet-report", tuning, "-o", out)
    assert done.returncode == 0, done.stderr
    page = out.read_text()
    assert "Observed and simulated" in page
    if spoil != "changed":  # damage within a picture may leave the others
        assert "No pictures of the film: filmed.rrd" in page
