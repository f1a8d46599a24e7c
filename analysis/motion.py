"""The tuned simulator's motion beside the observed one, and the units of a log."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from tunenet_logs.arrays import Array

if TYPE_CHECKING:
    import pandas as pd

MAX_SAMPLES = 20_000  # of one curve: a minute of what the fastest motion capture sees


@dataclass(frozen=True, eq=False)
class Curves:
    """Observed height and the tuned simulator's, at the observation's own stamps.

    Attributes:
        start_ns: Stamp that the seconds count from [ns].
        seconds: Shape (T,), increasing.
        observed_m: Heights above the table [m], shape (T,).
        simulated_m: Those of the tuned simulator [m], shape (T,); NaN where not simulated.
    """

    start_ns: int
    seconds: Array
    observed_m: Array
    simulated_m: Array

    def to_frame(self) -> pd.DataFrame:
        """Return a table with index `seconds`, columns `observed_m` and `simulated_m`."""
        import pandas as pd

        curves = {"observed_m": self.observed_m, "simulated_m": self.simulated_m}
        return pd.DataFrame(curves, index=pd.Index(self.seconds, name="seconds"))


@dataclass(frozen=True)
class SimulationFit:
    """Residual of the tuned rollout, from the release to the last bounce.

    Attributes:
        rms_percent: Root mean square of the residual [% of the drop height].
        worst_percent: Largest absolute residual.
        noise_percent: RMS that the observation's noise alone would give.
        held_out_percent: Like `excess_percent`, for the last 40 % of the time, by a fit to the
            first 60 % (hold-out); None if that shows too little.
        samples: Number compared.
        left_out: Samples that are something else than the ball.
        noise: Standard deviation of a sample, in `unit`.
        unit: "m", "px" of a video, "1" for drop heights if metres cannot be determined.
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
        """RMS residual without the noise."""
        return excess(self.rms_percent, self.noise_percent)


def excess(rms: float, noise: float) -> float:
    """Subtract the noise in quadrature from a root mean square."""
    return max(rms**2 - noise**2, 0.0) ** 0.5


@dataclass(frozen=True)
class Equivalent:
    """The ball in a simulator without air, dropped from the same height at the same moment.

    Attributes:
        restitution: Its coefficient, the same at every impact.
        rms_percent: RMS difference from the observation [% of the drop height].
        speeds_m_s: Of its impacts, as far as bounces are in view.
    """

    restitution: float
    rms_percent: float
    speeds_m_s: tuple[float, ...]


@dataclass(frozen=True)
class Equivalents:
    """Restitutions for simulators without air.

    Attributes:
        first: With the height of the first rebound.
        all: With the least error over all bounces in view.
    """

    first: Equivalent
    all: Equivalent


@dataclass(frozen=True)
class Units:
    """Units of a log's positions and stamps.

    Attributes:
        length_m: Metres in the log's unit of length; None if it cannot be determined.
        length_by: "named", "gravity", or None if it cannot be determined.
        rate_hz: Samples per second; None if it cannot be determined.
        rate_by: "clock", "gravity", or None.
        doubt: How gravity contradicts what the log says, and what would fit; "" if it does not.
        remedy: What to do about the doubt.
    """

    length_m: float | None
    length_by: str | None
    rate_hz: float | None
    rate_by: str | None
    doubt: str = ""
    remedy: str = ""

    @property
    def tell_speed(self) -> bool:
        """Whether metres and seconds are known, and so speeds and a drag per metre."""
        return self.length_m is not None and self.rate_hz is not None and not self.doubt


@dataclass(frozen=True)
class SoundShare:
    """Contribution of sound to a ball's images or positions.

    Attributes:
        impacts: Of the ball up to the last that is seen or heard; 0 if its sound was not
            compared with what is seen.
        heard: Number of these in the fit; 0 if the sound is not used.
        offset_s: Delay of the sound relative to what is seen [s]; None if it is not used.
        reason: Why it is not used; "" if it is.
        restitution: Estimate without it.
        interval95: Of that.
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
        curves: Both.
        fit: Residual between them.
        equivalents: For simulators without air.
        untold: What the log cannot determine of the parameters, in words.
        unknown: Names of parameters whose units cannot be determined.
        units: Of the log; None for an experiment whose logs always name them.
        sound: Contribution of sound; None if there is no sound.
    """

    curves: Curves | None = None
    fit: SimulationFit | None = None
    equivalents: Equivalents | None = None
    untold: tuple[str, ...] = ()
    unknown: tuple[str, ...] = ()
    units: Units | None = None
    sound: SoundShare | None = None
