"""A publisher as a ROS 2 driver is one, and a recorder of it, in processes of their own.

`python -m tests.recorders.ros2_publisher DOMAIN '{"messages": 3000, ...}'` waits until every topic
is received, publishes so many messages on each at a rate, and stays until it is ended. It says
"matched" and "sent". Before the messages named in "pauses" it says "at" and waits for a line. With
"eager" it waits for nobody and has no last message. A topic has a publisher for each kind of
message that is named, in that order. What a message holds follows from its number. The types are
written down here again, not imported: the recorder's could be wrong.
"""

import itertools
import json
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import float32, float64, int32, sequence, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from tests.recorders.live_wait import ending

ROOT = Path(__file__).resolve().parents[2]
# Messages that are sent again to who missed them; with the usual 10 a busy machine misses some.
_KEPT = 1000
NAMES = tuple(f"j2s7s300_joint_{number}" for number in range(1, 8))
TORQUES = "/arm/out/joint_torques"
STATES = "/joint_states"
_numbers = itertools.cycle(range(1, 101))
_MAX_S = 240  # a publisher that nobody hears ends then, so that its test fails and does not hang
_LOOPBACK = """<CycloneDDS><Domain><General>{multicast}<Interfaces>
<NetworkInterface address="127.0.0.1"/></Interfaces></General><Discovery>
<ParticipantIndex>auto</ParticipantIndex><Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"""


@final
@dataclass
class Stamp(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@final
@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Stamp
    frame_id: str


@final
@dataclass
class JointState(IdlStruct, typename="sensor_msgs::msg::dds_::JointState_"):
    header: Header
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


@final
@dataclass
class JointAngles(IdlStruct, typename="kinova_msgs::msg::dds_::JointAngles_"):
    joint1: float32
    joint2: float32
    joint3: float32
    joint4: float32
    joint5: float32
    joint6: float32
    joint7: float32


@final
@dataclass
class Text(IdlStruct, typename="std_msgs::msg::dds_::String_"):
    data: str


TYPES: dict[str, type[IdlStruct]] = {
    "states": JointState,
    "nameless": JointState,
    "angles": JointAngles,
    "gripper": JointState,
    "text": Text,
    "xcdr2": JointState,
}


def values_of(number: int) -> list[list[float]]:
    """Position, velocity and effort of the number-th message, of seven joints."""
    return [[part + joint + number / 1024 for joint in range(7)] for part in (0.0, 10.0, 20.0)]


def message_of(kind: str, number: int, stamp_ns: int) -> Any:
    if kind == "angles":
        return JointAngles(*values_of(number)[2])
    if kind == "text":
        return Text("nothing about joints")
    if kind == "gripper":
        finger: list[Any] = [["finger"], [number / 1024], [], []]
        return JointState(Header(Stamp(*divmod(stamp_ns, 1_000_000_000)), "hand"), *finger)
    names = [] if kind == "nameless" else list(NAMES)
    parts: list[Any] = [names, *values_of(number)]
    return JointState(Header(Stamp(*divmod(stamp_ns, 1_000_000_000)), "base"), *parts)


def writer_of(participant: DomainParticipant, topic: str, kind: str, plan: dict) -> DataWriter:
    """A publisher; unless the plan says else with ROS 2's usual settings, but for `_KEPT`."""
    reliability = (
        Policy.Reliability.Reliable(max_blocking_time=duration(milliseconds=100))
        if plan.get("reliable", True)
        else Policy.Reliability.BestEffort
    )
    is_new = kind == "xcdr2"
    qos = Qos(
        reliability,
        Policy.Durability.Volatile,
        Policy.History.KeepLast(plan.get("kept", _KEPT)),
        Policy.DataRepresentation(
            use_cdrv0_representation=not is_new, use_xcdrv2_representation=is_new
        ),
    )
    made = Topic(participant, f"rt{topic}", TYPES[kind])
    return DataWriter(participant, made, qos=qos)


def main() -> None:
    domain, plan = int(sys.argv[1]), json.loads(sys.argv[2])
    signal.alarm(round(plan.get("longest_s", _MAX_S)))
    multicast = "" if plan.get("multicast", True) else "<AllowMulticast>false</AllowMulticast>"
    kept = [Domain(domain, _LOOPBACK.format(multicast=multicast))]
    participant = DomainParticipant(domain)
    writers = [
        (kind, writer_of(participant, topic, kind, plan))
        for topic, kinds in plan["topics"].items()
        for kind in kinds.split()
    ]
    print("ready", flush=True)
    listeners = 0 if plan.get("eager") else plan.get("listeners", 1)
    while any(one.get_publication_matched_status().current_count < listeners for _, one in writers):
        time.sleep(0.005)
    print("matched", flush=True)
    start, period_s = time.monotonic(), 1 / plan.get("rate_hz", 1000.0)
    first_ns = time.time_ns()
    for number in itertools.count() if plan.get("eager") else range(plan["messages"]):
        if number in plan.get("pauses", ()):
            print(f"at {number}", flush=True)
            sys.stdin.readline()
        time.sleep(max(0.0, start + number * period_s - time.monotonic()))
        stamp_ns = first_ns + round(number * period_s * 1e9)
        for kind, writer in writers:
            writer.write(message_of(kind, number, stamp_ns))
    for _, writer in writers:
        if plan.get("reliable", True):
            writer.wait_for_acks(duration(seconds=30))
    print(f"sent {first_ns} {time.process_time():.2f}", flush=True)
    while kept:
        signal.pause()


@contextmanager
def publishing(domain: int, **plan: Any) -> Iterator[subprocess.Popen[str]]:
    """A publisher that is there, though not heard yet."""
    words = [sys.executable, "-m", "tests.recorders.ros2_publisher", str(domain), json.dumps(plan)]
    pipe = subprocess.PIPE
    with ending(subprocess.Popen(words, cwd=ROOT, stdin=pipe, stdout=pipe, text=True)) as process:
        expect(process, "ready")
        yield process


def go_on(process: subprocess.Popen[str]) -> None:
    assert process.stdin is not None
    process.stdin.write("\n")
    process.stdin.flush()


def expect(process: subprocess.Popen[str], word: str) -> list[str]:
    """Wait until a process says a line that begins so; what else is in it."""
    assert process.stdout is not None
    line = process.stdout.readline().split()
    assert line[:1] == [word], line
    return line[1:]


@contextmanager
def free_domain() -> Iterator[int]:
    """A domain that nobody else on this machine has who asks here.

    Beside its UDP ports, TCP has the same numbers: whoever holds the first has the domain. Those of
    domains over 100 are given to anybody who connects.
    """
    for number in itertools.islice(_numbers, 100):
        with socket.socket() as claim, suppress(OSError):
            claim.bind(("127.0.0.1", 7400 + 250 * number))
            yield number
            return
    raise AssertionError("every domain is taken")


if __name__ == "__main__":
    main()
