"""Parse H.264 and H.265 byte streams (Annex B) for random access points and parameter sets.

Rec. ITU-T H.264 and H.265, annex B: each unit follows a start code, its type is in its first byte.
"""

from __future__ import annotations

from typing import NamedTuple

_START = b"\0\0\1"

# Of a picture before its first slice: parameter sets and remarks; encoders write a handful.
_MAX_UNITS = 64

# Types of parameter sets: sequence and picture; for H.265 video before them.
_SETS = {"h264": (7, 8), "h265": (32, 33, 34)}

_SLICES = {"h264": range(1, 6), "h265": range(32)}  # types that hold a picture's pixels
# Of those, the ones from which a decoder can begin.
_STANDS_ALONE = {"h264": range(5, 6), "h265": range(16, 24)}

# A unit of remarks (SEI), and the remark by which H.264 says that a decoder can begin here.
_H264_REMARK, _RECOVERY_POINT = 6, 6


class PictureHead(NamedTuple):
    """What precedes a picture's first slice.

    Attributes:
        stands_alone: whether it is a random access point, where a decoder can begin.
        parameter_sets: those that it carries (VPS, SPS, PPS), with their start codes.
    """

    stands_alone: bool
    parameter_sets: bytes


def head_of(data: bytes, codec: str) -> PictureHead:
    """Parse one picture's NAL units up to its first slice; `codec` is "h264" or "h265"."""
    recovers = False
    sets: list[bytes] = []
    at = data.find(_START)
    for _ in range(_MAX_UNITS):
        if not 0 <= at < len(data) - 4:
            break
        at += 3
        kind = data[at] & 31 if codec == "h264" else data[at] >> 1 & 63
        if kind in _SLICES[codec]:
            return PictureHead(recovers or kind in _STANDS_ALONE[codec], b"".join(sets))
        if codec == "h264" and kind == _H264_REMARK and data[at + 1] == _RECOVERY_POINT:
            recovers = True
        following = data.find(_START, at)
        if kind in _SETS[codec]:
            unit = data[at : following if following >= 0 else len(data)]
            sets += [b"\0", _START, unit.rstrip(b"\0")]
        at = following
    return PictureHead(stands_alone=False, parameter_sets=b"".join(sets))
