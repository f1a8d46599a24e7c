"""Open video sent as plain bytes by TCP, UDP, a FIFO or standard input."""

from __future__ import annotations

from recorders.camera.address import camera_address
from recorders.camera.base import Source
from recorders.camera.byte_stream import stream_of
from recorders.camera.connection import OPENING_S, answering
from recorders.camera.pipe_feed import PipeFeed, opened_pipe
from recorders.camera.tcp_feed import TcpFeed
from recorders.camera.timed_feed import ByteFeed, TimedFeed
from recorders.camera.udp_feed import UdpFeed
from recorders.deadline import Deadline


def open_tcp(text: str, timeout_s: float) -> Source:
    """Open a camera that streams to whoever connects to tcp://HOST:PORT.

    Raises:
        UsageError, CameraError: see `TcpFeed` and `stream_of`.
    """
    address, deadline = camera_address(text), _opening(timeout_s)
    with answering(address.shown, deadline):
        feed = TcpFeed(address, deadline)
    return _stream(feed, address.shown, deadline, timeout_s)


def open_udp(text: str, timeout_s: float) -> Source:
    """Open a stream sent to a UDP port of this machine.

    Raises:
        UsageError, CameraError: see `UdpFeed` and `stream_of`.
    """
    deadline = _opening(timeout_s)
    return _stream(UdpFeed(text, deadline), text, deadline, timeout_s)


def open_pipe(text: str, timeout_s: float) -> Source:
    """Open what a program writes to standard input or a FIFO, or a file redirected there.

    Raises:
        UsageError, CameraError: see `opened_pipe` and `stream_of`.
    """
    deadline = _opening(timeout_s)
    pipe = opened_pipe(text)
    feed = PipeFeed(pipe.descriptor, deadline)
    return _stream(feed, pipe.shown, deadline, timeout_s, live=pipe.is_written_to)


def _opening(timeout_s: float) -> Deadline:
    """Make the first picture's deadline: the program that sends it may have to start."""
    longest_s = max(OPENING_S, timeout_s)
    return Deadline(longest_s, longest_s)


def _stream(
    feed: ByteFeed, shown: str, deadline: Deadline, timeout_s: float, *, live: bool = True
) -> Source:
    source = stream_of(TimedFeed(feed, deadline, timeout_s), shown, live=live)
    deadline.silence_s = timeout_s
    return source
