"""Drop detected in an episode, and the estimation problem that it poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from tunenet_logs.analysis.drop.audio import FusedEstimate, SoundBeside
from tunenet_logs.analysis.drop.bounce_fit import (
    MIN_SAMPLES,
    BounceFit,
    fit_bounce,
    fit_positions,
    fitted_drop,
    samples_of,
)
from tunenet_logs.analysis.drop.bounce_model import BounceSamples
from tunenet_logs.analysis.drop.bounce_posterior import (
    BallPosterior,
    drop_posterior,
    first_rebound,
    fitted_rebounds,
)
from tunenet_logs.analysis.drop.film import (
    FilmedDrop,
    canonical_film,
    drop_by,
    find_filmed_drop,
    image_rows,
)
from tunenet_logs.analysis.drop.free_flight import Drop
from tunenet_logs.analysis.drop.presets import canonical, paper_heights, paper_start_s
from tunenet_logs.analysis.estimators.base import Observation
from tunenet_logs.analysis.record import Rebound, Units
from tunenet_logs.analysis.tracking.track import Track
from tunenet_logs.episode import Array, LeftOut
from tunenet_logs.errors import NotFoundError
from tunenet_logs.recorders.simulators.known import Ball

# What to do where a cross-check of a drop disagrees.
DISAGREEMENT = "let go without spin, over a hard and level surface, and compare"


@dataclass(frozen=True, eq=False)
class DropDetection:
    """Drop detected in recorded positions, as one preset sees it."""

    physical: bool  # whether the preset simulates the ball itself, or the paper's engine
    topic: str  # where the ball's position came from
    start_ns: int  # where the drop's clock is 0: the first sample of the log's signal
    found: Drop  # the drop by the parabolas of its fall and first flight, with heights along `up`
    outliers: int  # samples that were left out: no ball can have been there
    sideways_m: Array  # horizontal positions in the drop's window [m], shape (T, any)
    ball: Ball  # what was dropped, as far as it is known
    warnings: tuple[str, ...]  # for the user
    units: Units  # of the log
    # Bounces of the recording that do not follow freely, for a ball that was thrown.
    others: tuple[Drop, ...] = ()
    sunk_m: float = 0.0  # how far below where it bounced a thrown ball ever is in the recording [m]
    sound: SoundBeside | None = None  # beside the positions; None where there is none
    film: None = None
    left_out: tuple[LeftOut, ...] = ()  # what the log's signal lacks

    @property
    def uses_ball(self) -> bool:
        """Whether the ball's size and mass have an effect: on the air's drag."""
        return self.ball.drag_1_m is not None

    @property
    def tells_speed(self) -> bool:
        """Whether metres and seconds are known."""
        return self.units.tell_speed

    @cached_property
    def posterior(self) -> BallPosterior | None:
        """Posterior of the ball; None where its samples are too few for a fit."""
        if self.ear is not None:
            return self.ear.posterior
        return drop_posterior(self.found, self.ball.drag_1_m)

    @cached_property
    def ear(self) -> FusedEstimate | None:
        """Joint fit with the sound; None where there is none, or no fit to join."""
        if self.sound is None or not self.physical:
            return None
        known = drop_posterior(self.found, self.ball.drag_1_m)
        why_not = "" if self.units.rate_by == "clock" else "the log's samples have no times"
        why_not = "the ball was thrown" if self.found.launched else why_not
        return None if known is None else self.sound.with_pictures(known, why_not)

    @cached_property
    def drop(self) -> Drop:
        """Drop with the fall of the fitted ball: air makes it longer than a parabola does."""
        if not self.physical or self.posterior is None:
            return self.found
        return fitted_drop(self.found, self.posterior.fit)

    @cached_property
    def target(self) -> Observation:
        """Target observation o_T, of the network that the preset has."""
        return canonical(self.drop) if self.physical else _whole(paper_heights(self.drop))

    @cached_property
    def rebounds(self) -> tuple[Rebound, ...]:
        """Each impact's own restitution, those of other bounces in the recording too, in order."""
        assert self.posterior is not None
        found = [*fitted_rebounds(self.posterior)]
        if self.found.launched:
            found = [*(found or [first_rebound(self.posterior)])]
            for drop in self.others:
                told = drop_posterior(drop, self.ball.drag_1_m)
                found += () if told is None else fitted_rebounds(told) or [first_rebound(told)]
        if not self.tells_speed:
            found = [replace(one, impact_speed_m_s=None) for one in found]
        return tuple(sorted(found, key=lambda one: one.impact_s))

    @property
    def observed(self) -> BounceSamples:
        """All samples of the drop [m]."""
        return samples_of(self.found, self.ball.drag_1_m)

    def begun(self, until_s: float) -> BounceFit | None:
        """Fit the samples until `until_s` alone; None where they are too few."""
        drop = self.found
        count = int(np.searchsorted(drop.seconds, until_s, side="right"))
        if count < MIN_SAMPLES or until_s < drop.impact_s:
            return None
        part = replace(drop, seconds=drop.seconds[:count], heights_m=drop.heights_m[:count])
        return fit_positions(part, self.ball.drag_1_m)

    @property
    def window(self) -> Mapping[str, float]:
        """First sample, first impact and last sample [s]."""
        return _window(self.drop)

    @property
    def extent(self) -> tuple[str, str]:
        """Drop height or, of a thrown ball, impact speed, as label and text."""
        if not self.tells_speed:
            return "drop", "height unknown"
        if self.found.launched:
            return "impact", f"{self.drop.impact_speed_m_s:.2f} m/s"
        return "drop", f"{self.drop.drop_height_m:.3f} m"


def _window(drop: Drop) -> Mapping[str, float]:
    first_s, last_s = drop.seconds[[0, -1]]
    return {"start_s": first_s, "impact_s": drop.impact_s, "end_s": last_s}


def _whole(target: Observation) -> Observation:
    if np.isnan(target.values).any():
        raise NotFoundError(
            "the paper's network needs 400 samples at 60 Hz: record 6.7 s from the release on, or "
            "use --preset default"
        )
    return target


@dataclass(frozen=True, eq=False)
class FilmDetection:
    """Drop detected in pictures; it is reconstructed when first needed."""

    physical: bool  # whether the preset simulates the ball itself, or the paper's engine
    topic: str  # where the pictures came from
    start_ns: int  # where the drop's clock is 0: the first picture
    track: Track  # the ball in every picture
    ball: Ball  # what was dropped, as far as it is known
    height_m: float | None = None  # of the drop, as the log says; None where it does not
    unread: str = ""  # what could not be read of the pictures, in words; "" if nothing
    # When a picture was taken, by its stamp, for those that are stamped later.
    taken_ns: Mapping[int, int] = field(default_factory=dict)
    track_warnings: tuple[str, ...] = ()  # of pictures and track, for the user
    outliers: int = 0  # none: what is not the ball was not tracked
    # Whether the stamps are times; where they count pictures there is no scale at all.
    is_timed: bool = True
    is_rate_known: bool = False  # whether the frame rate is stated, by a tag or by who recorded it
    sound: SoundBeside | None = None  # beside the pictures; None where there is none
    left_out: tuple[LeftOut, ...] = ()  # pictures of the topic that are not looked at

    @property
    def uses_ball(self) -> bool:
        """Whether the ball's size and mass have an effect: on drag, or on the film's scale."""
        return self.ball.drag_1_m is not None or (
            self.is_timed and self.height_m is None and self.ball.diameter_m is not None
        )

    @property
    def units(self) -> Units:
        """Units of a film: no length; its clock is the scale, where it has one."""
        if not self.is_timed:
            return Units(None, None, None, None)
        steps = np.diff(self.track.stamps_ns)
        rate_hz = 1e9 / float(np.median(steps)) if len(steps) and np.median(steps) > 0 else None
        return Units(None, None, rate_hz, "clock")

    @property
    def tells_speed(self) -> bool:
        """Whether metres and seconds are known: there is a clock, and nothing contradicts it."""
        return self.is_timed and not (self.contradicted_scale or self.is_slow_motion)

    @property
    def _diameter(self) -> float:
        """The ball's diameter in the pictures [drop heights]; NaN where it is not known."""
        radii_px = self.film.track.radius_px[self.film.used]
        known = radii_px[np.isfinite(radii_px)]
        return 2 * float(np.median(known)) / self.film.projection.span if len(known) else np.nan

    @property
    def known_height(self) -> tuple[float, float] | None:
        """Drop height by a known length [m], and its tolerance as a factor; None without one.

        A height that nothing has (0, say, where somebody did not measure) counts as unknown.
        """
        if self.height_m is not None and 0 < self.height_m < np.inf:
            return self.height_m, 1.3
        if self.ball.diameter_m is not None:
            return self.ball.diameter_m / self._diameter, 1.8  # blur widens a ball
        return None

    @cached_property
    def contradicted_scale(self) -> bool:
        """Whether a known length contradicts the clock: the film plays at another rate."""
        if not self.is_timed or self.known_height is None:
            return False
        known_m, within = self.known_height
        return not known_m / within < self.film.drop.drop_height_m < known_m * within

    @cached_property
    def is_slow_motion(self) -> bool:
        """Whether fall and ball are so large by the clock that this is most likely slow motion."""
        if not self.is_timed or self.is_rate_known or self.known_height is not None:
            return False
        height_m = self.film.drop.drop_height_m
        return height_m > 4.0 or self._diameter * height_m > 0.4  # [m] by the clock

    @cached_property
    def film(self) -> FilmedDrop:
        """Drop with the camera that explains the track; raises `NotFoundError` without one."""
        ball = self.ball if self.is_timed else None  # its drag is one per metre
        return find_filmed_drop(self.track, self.start_ns, ball)

    @property
    def rebounds(self) -> tuple[Rebound, ...]:
        """Each impact's own restitution."""
        found = fitted_rebounds(self.posterior)
        if not self.tells_speed:
            found = tuple(replace(one, impact_speed_m_s=None) for one in found)
        return found

    @cached_property
    def drop(self) -> Drop:
        """Drop with its heights by the film's own scale, which is time."""
        film = self.film
        if self.physical and self.posterior is film.posterior:
            return film.drop
        return drop_by(film, self.posterior, from_rest=not self.physical)  # the paper's are

    @property
    def posterior(self) -> BallPosterior:
        """Posterior of the ball, with its sound where that is used."""
        return self.film.posterior if self.ear is None else self.ear.posterior

    @cached_property
    def ear(self) -> FusedEstimate | None:
        """Joint fit with the sound; None where there is none."""
        if self.sound is None or not self.physical:
            return None
        why_not = "" if self.is_timed else "the pictures have no times"
        return self.sound.with_pictures(self.film.posterior, why_not)

    @property
    def window(self) -> Mapping[str, float]:
        """First sample, first impact and last sample [s]."""
        return _window(self.drop)

    @cached_property
    def observed(self) -> BounceSamples:
        """Positions of the ball in all pictures from the drop's first one on [px]."""
        film = self.film
        track = film.track
        found = np.flatnonzero(np.isfinite(track.places_px).all(axis=1))
        stamps_ns, first = np.unique(track.stamps_ns[found], return_index=True)
        along = -(track.places_px[found[first]] @ film.down_px)
        seconds = (stamps_ns - self.start_ns).astype(np.float64) * 1e-9
        inside = (seconds >= self.drop.seconds[0]) & (seconds <= film.end_s)
        across = track.places_px[found[first]] @ np.array([film.down_px[1], -film.down_px[0]])
        return replace(
            film.posterior.fit.samples,
            seconds=seconds[inside],
            positions=along[inside],
            across=(across - film.across_px)[inside],
            radii=None,
        )

    def begun(self, until_s: float) -> BounceFit | None:
        """Fit the samples until `until_s` alone; None where they are too few."""
        fit = self.film.posterior.fit
        samples = fit.samples.only(fit.samples.seconds <= until_s)
        moves = sum(at < until_s for at in samples.moves_s)
        samples = samples.moving_until(moves)
        if len(samples.seconds) < MIN_SAMPLES:
            return None
        return fit_bounce(samples, fit.unknowns, samples.unknowns)

    @property
    def extent(self) -> tuple[str, str]:
        """Drop height, as label and text."""
        known = f"{self.drop.drop_height_m:.3f} m"
        return "drop", known if self.tells_speed else "height unknown"

    @property
    def sideways_m(self) -> Array:
        """Distance from the image's vertical [m], shape (T, 1)."""
        return self.film.sideways[:, None] * self.film.drop.drop_height_m

    @cached_property
    def target(self) -> Observation:
        """Target observation o_T, of the network that the preset has."""
        if self.physical:
            return canonical_film(self.film)
        return _whole(image_rows(self.film, paper_start_s(self.drop)))

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings for the user."""
        found = list(self.track_warnings)
        height_m = self.drop.drop_height_m
        if not self.physical:
            found.append(
                f"a fall of {height_m:.2f} m by this camera; the paper's network was "
                "trained on a ball of 0.5 m radius falling from 4 to 5 m, before the paper's "
                "cameras"
            )
            if self.ball.drag_1_m is not None:
                found.append(
                    "the ball's size and mass (--ball, --ball-diameter, --ball-mass) not used: the "
                    "paper's network has no air"
                )
            return tuple(found)
        film = self.film
        if film.converted is not None and film.converted.is_sure:
            found.append(
                f"the film was converted {film.converted.how.words}: its pictures are placed where "
                "the ball's flight wants them; the camera's own file tells more"
            )
        if film.passes > 1:
            found.append(f"the film shows the same {film.passes:.1f} times: the first pass is used")
        if film.later_s:
            at = ", ".join(f"{later:.2f} s" for later in film.later_s[:5])
            found.append(
                f"more drops seem to follow, at {at}; the first is used (see --start, --end)"
            )
        if self.is_slow_motion:
            found.append(
                f"falls {height_m:.1f} m by the clock, a ball of {self._diameter * height_m:.2f} "
                "m: slow motion? the restitution is the same, but height, speeds and drag are left "
                "open; name the ball (--ball-diameter), or record it with tunenet-record --camera "
                "FILE --fps RATE"
            )
        return tuple(found)


AnyDetection = DropDetection | FilmDetection
