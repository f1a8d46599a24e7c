"""What ARCHITECTURE.md says to edit, edited: a toy of each kind joins by one entry of one table."""

from __future__ import annotations

import json
import lzma
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from mcap.writer import Writer

import tunenet_logs as tn
from docs import make_api
from tests.recorders.films import film
from tunenet_logs.analysis import options, registry
from tunenet_logs.analysis.batch.ledger import options_digest
from tunenet_logs.analysis.checks import Check, CheckSpec, CrossCheck, at_most, table
from tunenet_logs.analysis.cli.tune import build_parser
from tunenet_logs.analysis.drop.experiments import DropFromPositions
from tunenet_logs.analysis.estimators.base import (
    Estimator,
    FitResult,
    Observation,
    Problem,
    Step,
    Trace,
)
from tunenet_logs.analysis.experiment import Claim, Preset
from tunenet_logs.analysis.options import Subject, TuneOptions
from tunenet_logs.analysis.presentation import result_words
from tunenet_logs.analysis.record import Motion, Rebound
from tunenet_logs.console import given, option
from tunenet_logs.episode import Array, Episode, EpisodeInfo, Signal
from tunenet_logs.errors import NotFoundError
from tunenet_logs.formats import decoders
from tunenet_logs.formats import registry as formats
from tunenet_logs.formats.base import AnyType, Plain, RawChannel, RawMessage, Record, Structure
from tunenet_logs.formats.compressed import COMPRESSIONS, Compression
from tunenet_logs.formats.kinds import Start
from tunenet_logs.formats.message_types import TYPES, MessageType
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.recorders import cli as recording
from tunenet_logs.recorders.camera import sources
from tunenet_logs.recorders.camera.base import CapturedFrame, Source
from tunenet_logs.recorders.camera.device import VideoFile
from tunenet_logs.recorders.camera.network import NetworkOptions
from tunenet_logs.recorders.camera.options import CameraOptions
from tunenet_logs.recorders.orders import DropOrder, FilmOrder
from tunenet_logs.recorders.simulators.base import Parameter

SAMPLES = Path(__file__).parents[1] / "sample_logs"
RESTITUTION, GRAVITY_M_S2 = 0.8, 9.81


def drop(topic: str = "/ball/pose", *, sign: float = 1.0) -> tn.Episode:
    """An ideal ball let go from 1 m, 240 samples a second."""
    fall_s = math.sqrt(2 / GRAVITY_M_S2)
    begins_s, speeds_m_s = [-fall_s], [GRAVITY_M_S2 * fall_s]  # as if thrown to where it is let go
    while len(begins_s) < 30:
        begins_s.append(begins_s[-1] + 2 * speeds_m_s[-1] / GRAVITY_M_S2)
        speeds_m_s.append(RESTITUTION * speeds_m_s[-1])
    seconds = np.arange(480) / 240
    flight = np.searchsorted(begins_s, seconds, side="right") - 1
    since_s = seconds - np.array(begins_s)[flight]
    heights_m = np.array(speeds_m_s)[flight] * since_s - GRAVITY_M_S2 / 2 * since_s**2
    return tn.episode_of_positions(seconds, sign * heights_m, topic=topic)


def estimated(tuning: tn.Tuning, name: str = "restitution") -> float:
    found = tuning.record.estimate(name)
    assert found is not None
    return float(np.ravel(found.value)[0])


def is_toy(start: Start) -> bool:
    return start.data.startswith(b"TOY1")


def read_toy(path: Path, _options: ReadOptions) -> tn.Episode:
    seconds, heights = np.frombuffer(path.read_bytes()[4:], "<f8").reshape(-1, 2).T
    return tn.episode_of_positions(seconds, heights)


def test_a_format(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A recogniser of the first bytes and a reader: one row of `formats.registry.EXPORTS`."""
    (signal,) = drop().signals.values()
    rows = np.column_stack((signal.seconds, signal.values[:, 2]))
    (tmp_path / "drop.toy").write_bytes(b"TOY1" + rows.tobytes())
    with pytest.raises(tn.LogError, match="is not an MCAP log"):
        tn.read_episode(tmp_path / "drop.toy")
    monkeypatch.setattr(formats, "EXPORTS", ((is_toy, read_toy), *formats.EXPORTS))
    tuning = tn.tune(tmp_path / "drop.toy")
    assert estimated(tuning) == pytest.approx(RESTITUTION, abs=0.002)


TOY_TYPE = "lab_msgs/msg/Height"


def write_toys(path: Path, encoding: str, heights: np.ndarray) -> None:
    """Heights as JSON, or as texts of the encoding."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema(TOY_TYPE, "", b"")
        channel = writer.register_channel("/ball", encoding, schema)
        for stamp_ns, height in enumerate(heights.tolist()):
            data = json.dumps({"up": height}) if encoding == "json" else str(height)
            writer.add_message(channel, stamp_ns, data.encode(), stamp_ns)
        writer.finish()


def read_height(message) -> list[tuple]:
    return [(0, "", "", 0.0, 0.0, message.up)]


@pytest.fixture
def toy_type(monkeypatch: pytest.MonkeyPatch) -> None:
    wanted = Structure("", {"up": Plain.NUMBER})
    monkeypatch.setitem(TYPES, TOY_TYPE, MessageType("positions", read_height, wanted))


@pytest.mark.usefixtures("toy_type")
def test_a_type_of_messages(tmp_path: Path):
    """What reads it and the fields that it must have: one row of `formats.message_types.TYPES`."""
    heights = np.linspace(1, 2, 50)
    write_toys(tmp_path / "a.mcap", "json", heights)
    (signal,) = tn.read_episode(tmp_path / "a.mcap").signals.values()
    assert np.array_equal(signal.values[:, 2], heights)


def text_type(_channel: RawChannel, _listed: object) -> AnyType:
    return AnyType(None, lambda data: SimpleNamespace(up=float(bytes(data).decode())))


@pytest.mark.usefixtures("toy_type")
def test_an_encoding_of_messages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A function from a channel to an `AnyType`: one row of `formats.decoders.ENCODINGS`."""
    heights = np.linspace(1, 2, 50)
    write_toys(tmp_path / "a.mcap", "text", heights)
    assert "'text' is not read" in str(tn.read_episode(tmp_path / "a.mcap").channels[0].skipped)
    monkeypatch.setitem(decoders.ENCODINGS, "text", text_type)
    (signal,) = tn.read_episode(tmp_path / "a.mcap").signals.values()
    assert np.array_equal(signal.values[:, 2], heights)


def test_a_compression(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """How it begins and what unpacks it: one row of `formats.compressed.COMPRESSIONS`."""
    path = tmp_path / "noisy.mcap.xz"
    path.write_bytes(lzma.compress((SAMPLES / "noisy.mcap").read_bytes()))
    with pytest.raises(tn.LogError, match="xz"):
        tn.read_episode(path)
    xz = Compression(b"\xfd7zXZ\x00", (".xz",), "xz -d", lzma.LZMADecompressor)
    monkeypatch.setitem(COMPRESSIONS, "xz", xz)
    usual, found = tn.read_episode(SAMPLES / "noisy.mcap"), tn.read_episode(path)
    assert list(found.signals) == list(usual.signals)
    for one, other in zip(found.signals.values(), usual.signals.values(), strict=True):
        assert np.array_equal(one.values, other.values, equal_nan=True)


def read_toy_messages(path: Path, losses: list, topics=None, budget=None) -> Iterator[Record]:
    del losses, topics, budget  # it is whole, small, and of one topic
    channel = RawChannel("/ball", TOY_TYPE, "json")
    yield channel
    for stamp_ns, line in enumerate(path.read_bytes().splitlines()[1:]):
        yield RawMessage(channel, stamp_ns, line)


@pytest.mark.usefixtures("toy_type")
def test_a_container_of_messages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A `Container`: one row of `formats.registry.MESSAGES`."""
    heights = np.linspace(1, 2, 50)
    lines = [json.dumps({"up": height}) for height in heights.tolist()]
    (tmp_path / "a.toys").write_text("\n".join(["TOYS", *lines]))
    toys = formats.Messages(b"TOYS\n", ".toys", read_toy_messages)
    monkeypatch.setattr(formats, "MESSAGES", (*formats.MESSAGES, toys))
    (signal,) = tn.read_episode(tmp_path / "a.toys").signals.values()
    assert np.array_equal(signal.values[:, 2], heights)


class Guess(Estimator):
    """The first guess, unchanged."""

    name = "guess"
    takes_steps = False

    def estimate(self, problem: Problem, rollouts: int) -> Trace:
        return Trace((Step(problem.initial, problem.rollouts),))


def test_an_estimator(monkeypatch: pytest.MonkeyPatch):
    """A subclass of `Estimator`: one row of `analysis.registry.METHODS`."""
    monkeypatch.setitem(registry.METHODS, "guess", f"{__name__}:Guess")
    tuning = tn.tune(drop(), method="guess")
    assert tuning.verdict != "ok"
    with pytest.raises(tn.UsageError, match="guess"):
        tn.tune(drop(), method="no such method")


RATE = Parameter("decay_rate", "1/s", (0.0, 10.0), (0.0, 10.0), 5.0)
SECONDS = np.arange(50) / 25


class DecaySimulator:
    """A cup of tea that cools: exp(-rate t)."""

    parameters = (RATE,)
    engine = "closed form"
    step_hz = 25.0

    def rollout(self, values: Mapping[str, float]) -> Episode:
        return tea(RATE.checked(values[RATE.name]))


def tea(rate: float) -> Episode:
    stamps_ns = np.round(SECONDS * 1e9).astype(np.int64)
    values = np.exp(-rate * SECONDS)[:, None]
    return Episode(
        EpisodeInfo(kind="tea"), {"/tea": Signal("/tea", stamps_ns, values, ("x",), "K")}
    )


class TeaDetection:
    """The whole signal."""

    topic, warnings, left_out = "/tea", (), ()
    window: Mapping[str, float] = {"start_s": 0.0, "end_s": 1.96}
    extent = ("cooling", "2 s")

    def __init__(self, values: Array) -> None:
        self.values = values


class TeaExperiment:
    """An experiment without a network: no weights are needed for it."""

    name = kind = "tea"
    occasion = "cup"
    observed = "temperatures of a cup"
    accepted_options: frozenset[Subject] = frozenset()
    presets: Mapping[str, Preset] = {"default": Preset(True, (RATE,), method="brent")}

    def claim(self, episode: Episode, topic: str | None) -> Claim:
        return Claim.CERTAIN if "/tea" in episode.signals else Claim.NONE

    def detect(self, episode: Episode, selection: TuneOptions, preset: str) -> TeaDetection:
        if "/tea" not in episode.signals:
            raise NotFoundError("no tea in it")
        return TeaDetection(episode.signals["/tea"].values)

    def problem(self, detection: TeaDetection, initial: Array) -> Problem:
        """See `Experiment.problem`."""

        def observe(episode: Episode) -> Observation:
            return Observation(episode.signals["/tea"].values.copy(), SECONDS, "t [s]", ("T",))

        target = Observation(detection.values.copy(), SECONDS, "t [s]", ("T",))
        return Problem(target, DecaySimulator(), observe, initial)

    def checks(
        self, detection: TeaDetection, last: Step, fit: FitResult | None
    ) -> tuple[Check, ...]:
        return (Check("cools", bool(last.values[0] > 0), f"{last.values[0]:.2f} 1/s"),)

    def cross_check(self, detection: TeaDetection, estimate: Array) -> CrossCheck | None:
        """See `Experiment.cross_check`."""

    def motion(self, detection: TeaDetection, trace: Trace) -> Motion | None:
        """See `Experiment.motion`."""

    def rebounds(self, detection: TeaDetection, trace: Trace) -> tuple[Rebound, ...]:
        return ()

    def review(self, stream, tuning):
        import rerun.blueprint as rrb

        return rrb.Horizontal(rrb.TextDocumentView(origin="/result"))


def test_an_experiment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """A class with the members of `Experiment`: one row of `analysis.registry.EXPERIMENTS`.

    Tuned by the methods that fit it, kept, read back and reviewed.
    """
    monkeypatch.setitem(registry.EXPERIMENTS, "tea", f"{__name__}:TeaExperiment")
    tuning = tn.tune(tea(3.0), iterations=40)
    assert tuning.verdict == "ok"
    assert estimated(tuning, "decay_rate") == pytest.approx(3.0, abs=1e-3)
    again = tn.read_tuning(tn.save_tuning(tuning, tmp_path / "tea.json"))
    assert again.task == "tea"
    assert again.estimates == tuning.record.estimates
    assert tn.review(tuning, tmp_path / "tea.rrd").stat().st_size > 1000
    for method in ("line", "brent", "least-squares"):
        found = tn.tune(tea(3.0), method=method, iterations=40)
        assert estimated(found, "decay_rate") == pytest.approx(3.0, abs=0.01)
    assert "it is for drops" in (tn.tune(tea(3.0), method="secant").reason or "")
    with pytest.raises(tn.UsageError, match="needs a network"):
        tn.tune(tea(2.0), method="tunenet+line")


DAYS = table(
    CheckSpec(
        "it is nearly Friday",
        at_most(1, "days"),
        seen="{value} days to go",
        measures="the days until Friday",
        advice="wait a few days",
    )
)


class CheckedDrop(DropFromPositions):
    """Drops with a check more."""

    def checks(self, detection, last: Step, fit: FitResult | None) -> tuple[Check, ...]:
        wanted = DAYS["it is nearly Friday"].measured(4)
        return (*super().checks(detection, last, fit), wanted)


def test_a_check(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """One spec and one measured number: verdict, review, JSON, page and glossary follow."""
    assert tn.tune(drop()).verdict == "ok"
    monkeypatch.setitem(registry.EXPERIMENTS, "drop", f"{__name__}:CheckedDrop")
    tuning = tn.tune(drop())
    assert tuning.verdict == "suspect"
    sentence = "it is nearly Friday: 4 days to go (at most 1)"
    assert tuning.reason == f"{sentence}; at the next drop: wait a few days"
    assert f"- failed: {sentence}" in result_words(tuning.record, tuning.preset, "drop")
    tn.save_tuning(tuning, tmp_path / "drop.json")
    assert json.loads((tmp_path / "drop.json").read_text())["checks"][-1] == {
        "name": "it is nearly Friday",
        "passed": False,
        "detail": "4 days to go (at most 1)",
        "wanted": "at most 1",
        "value": 4.0,
        "limit": 1.0,
        "unit": "days",
        "advice": "wait a few days",
    }
    monkeypatch.setattr(make_api, "SECTIONS", {"Any log": DAYS})
    line = "- **it is nearly Friday**: the days until Friday, **at most 1 days**. Wait a few"
    assert line in make_api.checks_page(make_api.CHECKS.read_text("utf-8"))
    pytest.importorskip("matplotlib")
    pytest.importorskip("jinja2")
    tn.report(tmp_path / "drop.json", tmp_path / "drop.html")
    assert (
        '4 days to go</td><td class="number">at most 1</td>' in (tmp_path / "drop.html").read_text()
    )


@dataclass(frozen=True, kw_only=True)
class MoreOptions(options.TuneOptions):
    """Options of a tuning, and one more."""

    spin_1_s: float | None = option(
        "spin of the ball when it is let go [1/s]",
        flag="--spin",
        group="drop",
        subject="ball",
        metavar="HZ",
        limits=(0, 100, "1/s"),
    )


def test_an_option_of_tuning(monkeypatch: pytest.MonkeyPatch):
    """A field of `analysis.options.TuneOptions`: help, API, digest, provenance, "not used"."""
    monkeypatch.setattr(options, "TuneOptions", MoreOptions)
    parser = build_parser()
    for topic in ("drop", "all"):
        assert "--spin HZ" in parser.help_on(topic)
        assert "spin of the ball when it is let go [1/s]" in " ".join(parser.help_on(topic).split())
    assert "--spin" not in parser.help_on(None)
    said = given(parser.parse_args(["a.mcap", "--spin", "3"]), MoreOptions)
    assert said == {"spin_1_s": 3.0}
    with pytest.raises(tn.UsageError, match="argument --spin: '300' is not a number from 0 to 100"):
        parser.parse_args(["a.mcap", "--spin", "300"])
    with pytest.raises(tn.UsageError, match="spin_1_s 300 is not a number from 0 to 100 1/s"):
        tn.tune(drop(), spin_1_s=300)
    assert options_digest(MoreOptions(spin_1_s=3.0)) != options_digest(MoreOptions())
    held = tn.simulate(tn.PayloadOrder(seconds=1.0))
    tuning = tn.tune(held, spin_1_s=3.0)
    assert "--spin not used: this is a payload" in tuning.warnings
    assert tuning.record.provenance is not None
    assert tuning.record.provenance.options == {"spin_1_s": 3.0}


@dataclass(frozen=True, kw_only=True)
class SpunDrop(DropOrder):
    """A drop to simulate that has one option more."""

    spin_1_s: float = option("its spin [1/s]", 0.0, group="simulate", limits=(0, 9, "1/s"))


def test_an_option_of_recording(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    """A field of a source's dataclass: help, arguments, and refused of all other sources."""
    spun = replace(recording._SOURCES["drop"], kinds=(SpunDrop, FilmOrder))
    monkeypatch.setitem(recording._SOURCES, "drop", spun)
    parser = recording.build_parser()
    assert "--spin 1/S" in parser.help_on("simulate")
    asked = given(parser.parse_args(["--simulate", "drop", "--spin", "3"]), SpunDrop)
    assert SpunDrop(**asked).spin_1_s == 3.0
    assert recording.main(["--simulate", "payload", "--spin", "3"]) == 2
    assert "--spin does not go with --simulate payload" in capsys.readouterr().err


class Looped(VideoFile):
    """A camera that shows a video's first frames."""

    def frames(self) -> Iterator[CapturedFrame]:
        yield from list(super().frames())[:5]


def open_loop(text: str, asked: CameraOptions, _network: NetworkOptions) -> Source:
    return Looped(Path(text.removeprefix("loop:/")), asked.fps)


def test_a_cameras_scheme(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A function that opens a `Source`: one row of `recorders.camera.sources.OPENERS`."""
    (tmp_path / "a.mp4").write_bytes(film("mp4"))
    monkeypatch.setattr(sources, "OPENERS", {**sources.OPENERS, "loop": open_loop})
    source = sources.open_source(f"loop:/{tmp_path / 'a.mp4'}")
    assert len(list(source.frames())) == 5
