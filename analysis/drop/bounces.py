"""The bounces of a tuning as they are reported: each with its restitution, and how sure that is."""

from __future__ import annotations

from dataclasses import dataclass

from analysis.drop.detection import DropDetection
from analysis.tuning import Tuning


@dataclass(frozen=True)
class ReportedBounce:
    """One impact.

    Attributes:
        impact_s: when, on the drop's clock [s].
        interval95: of the restitution; None where the tuning has none.
        impact_speed_m_s: None where nothing fixes the scale.
    """

    impact_s: float
    restitution: float
    interval95: tuple[float, float] | None
    impact_speed_m_s: float | None


def bounces_of(tuning: Tuning) -> tuple[ReportedBounce, ...]:
    """Each impact that says something of its own, in order; none where no value is reported.

    Where nothing tells them apart there is the first, whose restitution is the tuning's.
    """
    found = tuning.found
    if tuning.estimate is None or not tuning.physical or not isinstance(found, DropDetection):
        return ()
    doubted = tuning.interval95 is None
    if tuning.refined is not None and tuning.refined.rebounds:
        return tuple(
            ReportedBounce(
                one.impact_s,
                one.restitution,
                None if doubted else one.interval95,
                one.impact_speed_m_s,
            )
            for one in tuning.refined.rebounds
        )
    ends = None
    if tuning.interval95 is not None:
        low, high = (float(end) for end in tuning.interval95[0])
        ends = low, high
    drop = found.drop
    return (ReportedBounce(drop.impact_s, float(tuning.estimate[0]), ends, drop.impact_speed_m_s),)
