"""Parse a camera's session description (SDP, RFC 8866): only what its video needs."""

from __future__ import annotations

import re
from dataclasses import dataclass

from tunenet_logs.errors import CameraError
from tunenet_logs.terminal import short_name

_VIDEO = re.compile(r"m=video \S+ (\S+) (\d{1,3})\b")
# Attributes that say how pictures are coded: none of them names a place.
_KEPT = re.compile(r"a=(rtpmap|fmtp|framerate|framesize):[\x20-\x7e]{1,4000}")

_CODEC = re.compile(r"a=rtpmap:\d{1,3}\s+([\w-]+)/")

_CONTROL = re.compile(r"a=control:([\x21-\x7e]{1,1000})\s*")

_PROTOCOLS = ("RTP/AVP", "RTP/AVPF", "RTP/AVP/TCP", "RTP/AVP/UDP")

_MAX_LINES = 20


@dataclass(frozen=True)
class Description:
    """A camera's first video.

    Attributes:
        whole: control URL of the session; "" if there is none.
        control: control URL of this video; "" if there is none.
        coding: the lines that describe its coding.
    """

    whole: str
    control: str
    coding: tuple[str, ...]

    @classmethod
    def of(cls, text: str) -> Description:
        """Parse a description.

        Raises:
            CameraError: it holds no video, or one sent by an unknown protocol.
        """
        session, *media = re.split(r"^(?=m=)", text, flags=re.MULTILINE)
        for section in media:
            if not (found := _VIDEO.match(section)):
                continue
            protocol, kind = found.groups()
            if protocol not in _PROTOCOLS:
                known = short_name(protocol)
                raise CameraError(f"sends its video by {known}; switch it to RTP/AVP")
            kept = [one[0] for one in map(_KEPT.fullmatch, section.splitlines()) if one]
            coding = (f"m=video 0 RTP/AVP {kind}", *kept[:_MAX_LINES])
            return cls(_control(session), _control(section), coding)
        raise CameraError("holds no video; give the address of its video")

    @property
    def codec(self) -> str:
        """RTP encoding name, such as "H264"; "" where the payload type implies it."""
        found = (_CODEC.match(line) for line in self.coding)
        return next((one[1].upper() for one in found if one), "")

    def text(self, control: str) -> str:
        """Format a description of this video alone, under the control name `control`.

        Args:
            control: what names it here.
        """
        head = ("v=0", "o=- 0 0 IN IP4 127.0.0.1", "s=-", "c=IN IP4 127.0.0.1", "t=0 0")
        media, *attributes = self.coding
        return "\r\n".join((*head, media, f"a=control:{control}", *attributes, ""))


def _control(section: str) -> str:
    found = (_CONTROL.fullmatch(line) for line in section.splitlines())
    return next((one[1] for one in found if one), "")
