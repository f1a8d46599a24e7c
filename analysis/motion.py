"""How a tuned simulator's motion is told: beside the observed one, and in whose units."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from tunenet_logs.arrays import Array

if TYPE_CHECKING:
    import pandas as pd

MOST_SAMPLES = 20_000
"""Of one curve: a minute of what the fastest motion capture sees."""


@dataclass(frozen=True, eq=False)
class Curves:
    """A recorded height and the tuned simulator's, at the observation's own stamps.

    Attributes:
        start_ns: the stamp that the seconds count from [ns].
        seconds: shape (T,), rising.
        observed_m: heights above the table [m], shape (T,).
        simulated_m: those of the tuned simulator [m], shape (T,); NaN where it was not simulated.
    """

    start_ns: int
    seconds: Array
    observed_m: Array
    simulated_m: Array

    def to_frame(self) -> pd.DataFrame:
        """As a table: index `seconds`, columns `observed_m` and `simulated_m`."""
        import pandas as pd

        curves = {"observed_m": self.observed_m, "simulated_m": self.simulated_m}
        return pd.DataFrame(curves, index=pd.Index(self.seconds, name="seconds"))


@dataclass(frozen=True)
class SimulationFit:
    """How far the tuned rollout is from what was observed, from the release to the last bounce.

    Attributes:
        rms_percent: root mean square of the distances [% of the drop height].
        worst_percent: the largest of them.
        noise_percent: what the observation's own noise makes of the first.
        held_out_percent: like `excess_percent`, for the last 40 % of the time, by a fit to the
            first 60 %; None where that shows too little.
        samples: compared.
        left_out: samples that are something else than the ball.
        noise: of a sample, in `unit`.
        unit: "m", "px" of a film, "1" for drop heights where nothing tells metres.
    """

    rms_percent: float
    worst_percent: float
    noise_percent: float
    held_out_percent: float | None
    samples: int
    left_out: int
    noise: float
    unit: str

    @property
    def excess_percent(self) -> float:
        """What is left of the rms without the noise."""
        return excess(self.rms_percent, self.noise_percent)


def excess(rms: float, noise: float) -> float:
    """What is left of a root mean square without the noise in it."""
    return max(rms**2 - noise**2, 0.0) ** 0.5


@dataclass(frozen=True)
class Equivalent:
    """The ball in a simulator without air, dropped from the same height at the same moment.

    Attributes:
        restitution: there, the same at every impact.
        rms_percent: how far that is from the observation [% of the drop height].
        speeds_m_s: of its impacts, as far as bounces are in view.
    """

    restitution: float
    rms_percent: float
    speeds_m_s: tuple[float, ...]


@dataclass(frozen=True)
class Equivalents:
    """For simulators without air.

    Attributes:
        first: with which the first rebound is as high.
        all: which is the best over all bounces in view.
    """

    first: Equivalent
    all: Equivalent


@dataclass(frozen=True)
class Units:
    """Of a log's positions and stamps.

    Attributes:
        length_m: metres in the log's unit of length; None where nothing tells.
        length_by: "named", "gravity", or None where nothing tells.
        rate_hz: samples a second; None where nothing tells.
        rate_by: "clock", "gravity", or None.
        doubt: how gravity contradicts what the log says, and what would fit; "" where it does not.
        remedy: what to do about the doubt.
    """

    length_m: float | None
    length_by: str | None
    rate_hz: float | None
    rate_by: str | None
    doubt: str = ""
    remedy: str = ""

    @property
    def tell_speed(self) -> bool:
        """Whether metres and seconds are known, and with them speeds and a drag per metre."""
        return self.length_m is not None and self.rate_hz is not None and not self.doubt


@dataclass(frozen=True)
class SoundShare:
    """What sound adds to pictures, or to positions, of a ball.

    Attributes:
        impacts: of the ball up to the last that is seen or heard; 0 where its sound was not
            compared with what is seen.
        heard: of these, those in the fit; 0 where the sound is not used.
        offset_s: by how much it is later than what is seen [s]; None where it is not used.
        reason: why it is not used; "" where it is.
        restitution: without it.
        interval95: of that.
    """

    impacts: int
    heard: int
    offset_s: float | None
    reason: str
    restitution: float
    interval95: tuple[float, float]

    @property
    def used(self) -> bool:
        """Whether the values are by sound, too."""
        return not self.reason


@dataclass(frozen=True, eq=False)
class Motion:
    """The tuned simulator's motion beside the observed one.

    Attributes:
        curves: both.
        fit: how far they are apart.
        equivalents: for simulators without air.
        untold: what the log does not tell of the parameters, in words.
        unknown: parameters that need units which the log does not tell, by name.
        units: of the log; None where an experiment's log names them always.
        sound: what was heard of it, too; None where there is no sound beside it.
    """

    curves: Curves | None = None
    fit: SimulationFit | None = None
    equivalents: Equivalents | None = None
    untold: tuple[str, ...] = ()
    unknown: tuple[str, ...] = ()
    units: Units | None = None
    sound: SoundShare | None = None
