"""Run bounces that are heard, alone and beside pictures, and sounds that are no bounce."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from analysis.evaluation.sound.alone import (
    SNRS_DB,
    AloneOutcome,
    AloneTrial,
    NegativeOutcome,
    alone_outcome,
    negative_outcome,
)
from analysis.evaluation.sound.beside import (
    UNRELATED,
    BesideOutcome,
    BesideTrial,
    beside_outcome,
)
from analysis.processes import Piece, parallel_map
from tunenet_logs.terminal import Progress

# Ratio from which on a sound is a good one; an uneven ball's, see `BounceOrder`.
GOOD_DB, UNEVEN = 20.0, 0.003

SoundOutcome = AloneOutcome | NegativeOutcome | BesideOutcome


@dataclass(frozen=True)
class SoundOrder:
    """Settings of the experiment.

    Attributes:
        seeds: each with its own sounds.
        count: for each seed: clips at a ratio, sounds that are no bounce, films, tracks.
        sections: of `choices.SOUND_SECTIONS`.
        jobs: processes; None for all cores.
    """

    seeds: Sequence[int]
    count: int
    sections: Sequence[str]
    jobs: int | None = None


def sound_sections(
    order: SoundOrder, progress: Progress
) -> Iterator[tuple[str, Sequence[SoundOutcome]]]:
    """Yield all results section by section; "alone" and "phyphox" share their clips."""
    clips: list[AloneOutcome] = []
    for section in order.sections:
        pairs = [(seed, number) for seed in order.seeds for number in range(order.count)]
        if section in ("alone", "phyphox"):
            if not clips:
                trials = [Piece(AloneTrial(*pair, snr)) for snr in SNRS_DB for pair in pairs]
                clips = parallel_map(alone_outcome, trials, order.jobs, progress, (section, "clip"))
            yield section, clips
        elif section == "uneven":
            trials = [Piece(AloneTrial(*pair, GOOD_DB, UNEVEN)) for pair in pairs]
            yield (
                section,
                parallel_map(alone_outcome, trials, order.jobs, progress, (section, "clip")),
            )
        elif section == "negatives":
            pieces = [Piece(pair) for pair in pairs]
            yield (
                section,
                parallel_map(negative_outcome, pieces, order.jobs, progress, (section, "sound")),
            )
        else:
            asked = [Piece(_beside(section, *pair)) for pair in pairs]
            what = asked[0].item.kind if asked else section
            yield (
                section,
                parallel_map(beside_outcome, asked, order.jobs, progress, (section, what)),
            )


def _beside(section: str, seed: int, number: int) -> BesideTrial:
    """Pair a video with one unrelated sound beside its own, or none; a track with all."""
    if section == "uneven-films":
        return BesideTrial("film", seed, number, uneven=UNEVEN)
    if section == "films":
        return BesideTrial("film", seed, number, (UNRELATED[number % len(UNRELATED)],))
    return BesideTrial("track", seed, number, UNRELATED)
