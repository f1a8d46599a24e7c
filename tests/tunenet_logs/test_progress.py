"""How far work is: told where it is done, heard by whoever listens."""

from __future__ import annotations

import pytest

import tunenet_logs as tn
from tests.conftest import ROOT
from tunenet_logs import terminal
from tunenet_logs.terminal import Progress, _listener, about, heard_by, told


def test_nobody_hears_and_nothing_changes():
    assert list(told(range(5), "counting", 5)) == list(range(5))


def test_a_listener_hears_the_beginning_and_the_end_and_only_in_its_block():
    heard: list[tuple[str, float]] = []
    with heard_by(lambda what, fraction: heard.append((what, fraction))):
        list(told(range(5), "counting", 5))
    list(told(range(5), "counting on", 5))
    assert heard[0] == ("counting", 0.0)
    assert heard[-1] == ("counting", 1.0)


def test_a_film_tells_its_stages_to_a_function():
    heard: list[tuple[str, float]] = []
    tn.tune(
        ROOT / "sample_logs" / "filmed.mcap",
        progress=lambda what, fraction: heard.append((what, fraction)),
    )
    stages = list(dict.fromkeys(what for what, _ in heard))
    assert stages[:4] == [
        "reading",
        "decoding the pictures",
        "finding what moves",
        "following the ball",
    ]
    assert all(0 <= fraction <= 1 for _, fraction in heard)


def test_work_that_lasts_is_announced_now_and_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
):
    now_s = 0.0
    monkeypatch.setattr(terminal.time, "monotonic", lambda: now_s)  # a clock, not a machine's speed
    with Progress().stages("a.mp4"):
        hear = _listener.get()
        assert hear is not None
        for step in range(100):
            now_s = float(step)
            hear("following the ball", step / 100)
    said = capsys.readouterr().err.splitlines()
    assert said == [
        f"a.mp4: following the ball: about {left} more" for left in ("2 min", "70 s", "40 s")
    ]
    with Progress(quiet=True).stages("a.mp4"):
        assert _listener.get() is None


@pytest.mark.parametrize(
    ("seconds", "words"), [(12.0, "10 s"), (44.0, "40 s"), (200.0, "3 min"), (9000.0, "2.5 h")]
)
def test_times_in_round_words(seconds: float, words: str):
    assert about(seconds) == words
