"""Bouncing-ball experiments, and what to do at the next drop where one is no good."""

from __future__ import annotations

_NEXT = "at the next drop:"

# How a good drop looks: for recordings in which there is nothing like one.
GOOD_DROP = (
    f"{_NEXT} let the ball fall from rest, from 0.3 to 2 m, onto a hard floor, in view until it "
    "lies still (tunenet docs camera)"
)

LONGER = f"{_NEXT} record until the ball lies still, all bounces in view"

FILM_MORE = (
    f"{_NEXT} film fall and bounces at 60 pictures a second or more, all in view, until the ball "
    "lies still (tunenet docs camera)"
)

LET_GO = f"{_NEXT} let go of the ball at rest, and touch it no more"

DENSER = (
    f"{_NEXT} record at a higher rate, 60 samples a second or more, from before it falls until it "
    "lies still"
)

RIGHT_LENGTHS = "name the unit with --length-unit m, cm, mm, in or ft"
RIGHT_TIMES = "give the times of impacts in seconds, those of one ball alone (--start, --end)"

RIGHT_SOUND = (
    f"{_NEXT} record one ball that bounces five times or more, the microphone near it, in a quiet "
    "room (--start, --end choose a part)"
)
