"""Files and logs of sound that a stranger made to hurt."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import av
import numpy as np
from mcap.writer import Writer

from tunenet_logs import messages

_FLOAT, _WHOLE = 3, 1


def wav(
    data: bytes,
    *,
    form: int = _WHOLE,
    bits: int = 16,
    channels: int = 1,
    rate_hz: int = 48_000,
    stated: int | None = None,
) -> bytes:
    """A file of uncompressed sound that states the given number of bytes, or what it has."""
    width = bits // 8 * channels
    about = struct.pack(
        "<HHIIHH", form, channels, rate_hz, rate_hz * width & 0xFFFFFFFF, width, bits
    )
    size = len(data) if stated is None else stated
    body = b"WAVEfmt " + struct.pack("<I", len(about)) + about + b"data" + struct.pack("<I", size)
    return b"RIFF" + struct.pack("<I", min(size + 36, 2**32 - 1)) + body + data


def tones(seconds: float, rate_hz: int = 48_000, channels: int = 1) -> bytes:
    """Of 440 Hz and 16 bits."""
    times_s = np.arange(round(seconds * rate_hz)) / rate_hz
    whole = np.round(3000 * np.sin(2 * np.pi * 440 * times_s)).astype("<i2")
    return np.repeat(whole, channels).tobytes()


def hours_claimed(folder: Path) -> Path:
    """A second of sound that states 12 hours."""
    path = folder / "claims.wav"
    path.write_bytes(wav(tones(1.0), stated=2**32 - 1))
    return path


def hours_of_holes(folder: Path) -> Path:
    """Ten hours of 8 kHz and 8 bits, which the disk need not hold."""
    path = folder / "long.wav"
    with path.open("wb") as file:
        file.write(wav(b"", bits=8, rate_hz=8000, stated=288_000_000))
        file.truncate(288_000_044)
    return path


def hour_of_flac(folder: Path) -> Path:
    """An hour of silence: a packet of some bytes, many times."""
    path, rate_hz = folder / "silence.flac", 48_000
    with av.open(str(path), "w") as file:
        stream: Any = file.add_stream("flac", rate=rate_hz)
        stream.layout = "mono"
        frame = av.AudioFrame(format="s16", layout="mono", samples=rate_hz)
        frame.planes[0].update(bytes(2 * rate_hz))
        frame.sample_rate, frame.pts = rate_hz, 0
        silence, step = bytes(stream.encode(frame)[1]), stream.codec_context.frame_size
        for number in range(3600 * rate_hz // step):
            packet = av.Packet(silence)
            packet.stream, packet.pts, packet.duration = stream, number * step, step
            packet.dts, packet.time_base = packet.pts, stream.codec_context.time_base
            file.mux(packet)
    return path


def many_channels(folder: Path) -> Path:
    """Of 64 channels."""
    path = folder / "channels.wav"
    path.write_bytes(wav(tones(2.0, channels=64), channels=64))
    return path


def most_channels(folder: Path) -> Path:
    """Of as many channels as a file can state."""
    path = folder / "most.wav"
    path.write_bytes(wav(bytes(2 * 65_535), bits=8, channels=65_535))
    return path


def high_rate(folder: Path) -> Path:
    """192,000 samples a second."""
    path = folder / "high.wav"
    path.write_bytes(wav(tones(2.0, 192_000), rate_hz=192_000))
    return path


def no_numbers(folder: Path) -> Path:
    """Floats, a few of them NaN, infinite or huge."""
    path = folder / "nan.wav"
    samples = np.frombuffer(tones(1.0), "<i2").astype("<f4") / 32768
    samples[1000:4000:1000] = np.nan, np.inf, -3e38
    path.write_bytes(wav(samples.tobytes(), form=_FLOAT, bits=32))
    return path


def no_rate(folder: Path) -> Path:
    """No samples a second."""
    path = folder / "rate0.wav"
    path.write_bytes(wav(tones(1.0), rate_hz=0))
    return path


def impossible_rate(folder: Path) -> Path:
    """Two billion samples a second."""
    path = folder / "rate.wav"
    path.write_bytes(wav(tones(1.0), rate_hz=2**31 - 1))
    return path


class Block(NamedTuple):
    """One message of sound in a log."""

    stamp_ns: int
    pcm: bytes
    rate_hz: int = 48_000
    channels: int = 1


def write_blocks(path: Path, topics: dict[str, list[Block]]) -> Path:
    """A log of blocks as our recorders write them, whatever they state."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        definition = messages.definition(messages.RAW_AUDIO).encode()
        schema = writer.register_schema(messages.RAW_AUDIO, "ros2msg", definition)
        for topic, blocks in topics.items():
            channel = writer.register_channel(topic, "cdr", schema)
            for block in blocks:
                pcm = np.frombuffer(block.pcm, np.uint8)
                message = messages.raw_audio(block.stamp_ns, np.zeros((0, 1), np.int16), 0)
                message.data, message.sample_rate = pcm, block.rate_hz
                message.number_of_channels = block.channels
                data = messages.encode(message, messages.RAW_AUDIO)
                writer.add_message(channel, block.stamp_ns, data, block.stamp_ns)
        writer.finish()
    return path


def far_apart(folder: Path) -> Path:
    """20 microphones, each of which hears two moments that are ten hours apart."""
    pcm = tones(0.1, 2_000_000)
    blocks = [Block(n * 36_000 * 10**9 + 10**9, pcm, 2_000_000) for n in (0, 1)]
    return write_blocks(folder / "apart.mcap", {f"/mic{n}": blocks for n in range(20)})


def many_moments(folder: Path) -> Path:
    """20,000 messages of one sample, each an hour behind the last."""
    moments = [Block(n * 3600 * 10**9, b"\1\0") for n in range(20_000)]
    return write_blocks(folder / "moments.mcap", {"/mic": moments})


BOMBS: tuple[Callable[[Path], Path], ...] = (
    hours_claimed, hours_of_holes, hour_of_flac, many_channels, most_channels,
    high_rate, no_numbers, no_rate, impossible_rate, far_apart, many_moments,
)  # fmt: skip
