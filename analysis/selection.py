"""Choices of a user: how to tune, which part of a log, prior knowledge of ball or arm."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tunenet_logs.formats.options import AS_IT_SAYS, ReadOptions
from tunenet_logs.recorders.simulators.known import UNKNOWN_BALL, Ball

if TYPE_CHECKING:
    from tunenet_logs.analysis.payload.arm_card import ArmCard
    from tunenet_logs.analysis.sysid.source import SimulatorSource
    from tunenet_logs.episode import Episode


# What options are about; an experiment says which of them have an effect on it.
Subject = Literal["pictures", "ball", "height", "lengths", "arm"]

_BALL = "the ball's size and mass (--ball, --ball-diameter, --ball-mass)"


@dataclass(frozen=True)
class Hints:
    """Hints on the ball in images; none is needed.

    Attributes:
        roi: Left, top, width, height [px] of the region of interest.
        hsv: Lowest and highest hue (0 to 179), saturation and value (0 to 255) of the ball.
        ball_at: x, y [px] of the ball, and when [s since the first image, selected or not].
    """

    roi: tuple[int, int, int, int] | None = None
    hsv: tuple[tuple[int, int, int], tuple[int, int, int]] | None = None
    ball_at: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class Selection:
    """Part of a log to use, and what is known beforehand.

    Attributes:
        topic: Channel; None for the best.
        start_s: Start of the part [s since the log's first sample].
        end_s: End of the part [s since the log's first sample].
        hints: On the ball in an image.
        ball: What was dropped: its drag is then known.
        tares: Logs of the same arm with an empty gripper, or their episodes.
        arm: A known arm's name, or a URDF and the link that holds the payload; None to go by the
            log.
        height_m: Of the drop, for a log of impact times alone [m].
        gravity: "included" or "compensated": whether the arm's own weight is in the torques. None
            to go by the log, here and below.
        effort_sign: Whose the torques are, "joint" (what it exerts) or "load" (the opposite).
        effort_unit: Of the torques, "N·m" or "A".
        torque_constants: For efforts that are currents [N·m/A at the joint]: one per joint from
            base to tool, or one for all.
        arm_card: What other runs identified of the arm; None for nothing.
        reading: Options for files, the log's and the tares', that do not state them.
    """

    topic: str | None = None
    start_s: float | None = None
    end_s: float | None = None
    hints: Hints = field(default_factory=Hints)
    ball: Ball = UNKNOWN_BALL
    tares: tuple[Path | Episode, ...] = ()
    arm: str | tuple[Path, str] | None = None
    height_m: float | None = None
    gravity: str | None = None
    effort_sign: str | None = None
    effort_unit: str | None = None
    torque_constants: tuple[float, ...] = ()
    arm_card: ArmCard | None = None
    reading: ReadOptions = AS_IT_SAYS

    @property
    def of_currents(self) -> bool:
        """Whether the torques are converted motor currents."""
        return bool(self.torque_constants or self.reading.torque_constants)

    @property
    def given(self) -> Mapping[Subject, tuple[str, ...]]:
        """Options given, by the user's names, by what they are about."""
        said: Mapping[Subject, Mapping[str, bool]] = {
            "pictures": {
                "--roi": self.hints.roi is not None,
                "--hsv": self.hints.hsv is not None,
                "--ball-at": self.hints.ball_at is not None,
            },
            "ball": {_BALL: self.ball != UNKNOWN_BALL},
            "height": {"--height": self.height_m is not None},
            "lengths": {"--length-unit": bool(self.reading.length_unit)},
            "arm": {
                "--tare": bool(self.tares),
                "--arm": isinstance(self.arm, str),
                "--urdf": isinstance(self.arm, tuple),
                "--gravity": self.gravity is not None,
                "--effort-sign": self.effort_sign is not None,
                "--effort-unit": self.effort_unit is not None,
                "--torque-constants": self.of_currents,
                "--arm-card": self.arm_card is not None,
            },
        }
        named: dict[Subject, tuple[str, ...]] = {
            about: tuple(filter(options.get, options)) for about, options in said.items()
        }
        return {about: names for about, names in named.items() if names}


@dataclass(frozen=True)
class Options:
    """Options of a tuning; see `tunenet-tune --help`.

    Attributes:
        task: Kind of experiment; None to go by the log.
        iterations: Maximum rollouts of the method, before the last one, which checks its answer.
        initial: One value per parameter; None for the method's own.
        method: One of `registry.METHODS`; None for the preset's.
        weights: None for those that the package ships.
        source: Of the user's own simulator; None for those of the experiments.
    """

    task: str | None = None
    preset: str = "default"
    iterations: int = 5
    initial: tuple[float, ...] | None = None
    method: str | None = None
    weights: Path | None = None
    selection: Selection = field(default_factory=Selection)
    source: SimulatorSource | None = None
