"""The sandbox: what comes back, and what comes of a child that crashes, loops or eats memory."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.tunenet_logs import sandbox_functions as functions
from tunenet_logs.formats import sandbox as module
from tunenet_logs.formats.sandbox import Sandbox, SandboxError

TOO_MUCH = "it is damaged, or takes more memory or time than any log"


def test_words_and_arrays_come_back_and_what_libraries_print_does_not(
    capfd: pytest.CaptureFixture[str],
):
    given = {"a": np.arange(6).reshape(2, 3), "b": np.array([1.5, np.nan], "f4")}
    with Sandbox("numpy") as sandbox:
        words, arrays = sandbox.ask(functions.doubled, 4, arrays=given)
        answers = list(sandbox.answers(functions.counted, 3))
        assert sandbox.ask(functions.prints) == ("quiet", {})
    assert words == 5
    for name, array in given.items():
        np.testing.assert_array_equal(arrays[name], array * 2)
    assert [words for words, _ in answers] == ["number 0", "number 1", "number 2"]
    assert answers[0][1]["empty"].shape == (0, 3)
    assert answers[0][1]["text"].tolist() == ["a", "bc"]
    assert "".join(capfd.readouterr()) == ""


def test_requests_share_a_child_until_it_fails():
    with Sandbox() as sandbox:
        assert sandbox.ask(functions.remembers, 1)[0] == [1]
        assert sandbox.ask(functions.remembers, 2)[0] == [1, 2]
        with pytest.raises(SandboxError):
            sandbox.ask(functions.refuses)
        assert sandbox.ask(functions.remembers, 3)[0] == [3]


@pytest.mark.parametrize(
    ("function", "arguments", "limits", "says"),
    [
        (functions.refuses, (), {}, {"kind": "refused", "remedy": "take one of steel"}),
        (functions.raises, (), {}, {"kind": "damaged", "raised": "KeyError"}),
        *((functions.killed, (number,), {}, {"kind": "crash", "code": -number})
          for number in (signal.SIGSEGV, signal.SIGBUS, signal.SIGABRT)),
        (functions.crashes, (), {}, {"kind": "crash"}),
        (functions.leaves, (), {}, {"kind": "crash"}),
        (functions.objects, (), {}, {"kind": "crash"}),  # nothing is unpickled
        (functions.eats, (), {"memory_bytes": 100 * 2**20}, {"kind": "memory"}),
        (functions.loops, (), {"cpu_s": 1}, {"kind": "time"}),
        (functions.sleeps, (), {"wall_s": 1}, {"kind": "time"}),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)  # fmt: skip
def test_a_child_that_fails_is_one_error(
    function: Callable[..., Any], arguments: tuple, limits: dict[str, Any], says: dict[str, Any]
):
    begun_s = time.monotonic()
    with Sandbox(**limits) as sandbox, pytest.raises(SandboxError) as caught:
        list(sandbox.answers(function, *arguments))
    assert not sandbox.is_running
    error, words = caught.value, str(caught.value)
    assert "\n" not in words
    assert {name: getattr(error, name) for name in says} == says
    assert time.monotonic() - begun_s < 20
    if function is functions.killed:
        assert words == TOO_MUCH
    if says["kind"] == "memory":
        assert words == "it claims more memory than any log needs"
    if says["kind"] == "damaged":
        assert words.startswith("it is damaged (")
    if says["kind"] == "refused":
        assert words == "it is of wood"


def test_sizes_of_answers_are_checked(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(module, "_OUTPUT_BYTES", 1000)
    with Sandbox() as sandbox:
        assert sandbox.ask(functions.much, 100)[1]["a"].nbytes == 800
        with pytest.raises(SandboxError) as caught:
            sandbox.ask(functions.much, 10_000_000)
    assert caught.value.kind == "crash"
