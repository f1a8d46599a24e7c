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


def fails(function: Callable[..., Any], *arguments: Any, **limits: Any) -> SandboxError:
    with Sandbox(**limits) as sandbox, pytest.raises(SandboxError) as caught:
        list(sandbox.answers(function, *arguments))
    assert not sandbox.is_running
    assert "\n" not in str(caught.value)
    return caught.value


def test_words_and_arrays_come_back():
    given = {"a": np.arange(6).reshape(2, 3), "b": np.array([1.5, np.nan], "f4")}
    with Sandbox("numpy") as sandbox:
        words, arrays = sandbox.ask(functions.doubled, 4, arrays=given)
        answers = list(sandbox.answers(functions.counted, 3))
    assert words == 5
    np.testing.assert_array_equal(arrays["a"], given["a"] * 2)
    np.testing.assert_array_equal(arrays["b"], given["b"] * 2)
    assert [words for words, _ in answers] == ["number 0", "number 1", "number 2"]
    assert answers[0][1]["empty"].shape == (0, 3)
    assert answers[0][1]["text"].tolist() == ["a", "bc"]


def test_requests_share_a_child_until_it_fails():
    with Sandbox() as sandbox:
        assert sandbox.ask(functions.remembers, 1)[0] == [1]
        assert sandbox.ask(functions.remembers, 2)[0] == [1, 2]
        with pytest.raises(SandboxError):
            sandbox.ask(functions.refuses)
        assert sandbox.ask(functions.remembers, 3)[0] == [3]


def test_what_is_raised_is_said():
    refusal = fails(functions.refuses)
    assert (refusal.kind, str(refusal)) == ("refused", "it is of wood")
    assert refusal.remedy == "take one of steel"
    damage = fails(functions.raises)
    assert (damage.kind, damage.raised) == ("damaged", "KeyError")
    assert str(damage).startswith("it is damaged (")


def test_what_libraries_print_goes_nowhere(capfd: pytest.CaptureFixture[str]):
    with Sandbox() as sandbox:
        assert sandbox.ask(functions.prints) == ("quiet", {})
    said = capfd.readouterr()
    assert said.out + said.err == ""


@pytest.mark.parametrize("number", [signal.SIGSEGV, signal.SIGBUS, signal.SIGABRT])
def test_a_killed_child_is_one_error(number: int):
    error = fails(functions.killed, number)
    assert (error.kind, error.code, str(error)) == ("crash", -number, TOO_MUCH)


def test_a_crash_is_one_error():
    assert fails(functions.crashes).kind == "crash"
    assert fails(functions.leaves).kind == "crash"


def test_memory_is_limited():
    error = fails(functions.eats, memory_bytes=100 * 2**20)
    assert (error.kind, str(error)) == ("memory", "it claims more memory than any log needs")


def test_time_is_limited():
    begun_s = time.monotonic()
    assert fails(functions.loops, cpu_s=1).kind == "time"
    assert fails(functions.sleeps, wall_s=1).kind == "time"
    assert time.monotonic() - begun_s < 20


def test_nothing_is_unpickled_and_sizes_are_checked(monkeypatch: pytest.MonkeyPatch):
    assert fails(functions.objects).kind == "crash"
    monkeypatch.setattr(module, "_OUTPUT_BYTES", 1000)
    assert fails(functions.much, 10_000_000).kind == "crash"
    with Sandbox() as sandbox:
        assert sandbox.ask(functions.much, 100)[1]["a"].nbytes == 800
