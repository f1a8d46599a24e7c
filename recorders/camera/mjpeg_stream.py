"""A network camera that sends JPEGs over HTTP (multipart/x-mixed-replace)."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from http.client import HTTPException, HTTPResponse
from typing import IO, Any
from urllib import request
from urllib.error import HTTPError, URLError
from urllib.parse import urlsplit

from recorders.camera.address import Address
from recorders.camera.http_handler import DeadlineHandler
from recorders.camera.multipart import MultipartParser
from recorders.deadline import Deadline
from tunenet_logs.clock import wall_ns
from tunenet_logs.episode import Frame
from tunenet_logs.errors import CameraError
from tunenet_logs.jpeg import is_whole
from tunenet_logs.terminal import short_name

_BOUNDARY = re.compile(r'boundary\s*=\s*(?:"([^"]*)"|([^;\s]*))', re.IGNORECASE)
"""In a Content-Type: what separates the parts, with quotes or without."""

_LONGEST_KIND = 1000
"""Characters of a Content-Type that are looked at."""

OPENING_S = 10.0
"""For redirections, passwords and headers together, where no longer silence is allowed."""


class MjpegStream:
    """An MJPEG stream over HTTP; its JPEGs stay untouched.

    A frame's stamp is when its first byte arrived. User and password in the address are sent when
    the camera asks for them (basic or digest), and go nowhere else.

    Args:
        address: where.
        timeout_s: the longest silence, and the longest without a whole picture. Opening may take
            10 s, or so long where that is longer.

    Raises:
        CameraError: nothing answers there, or not with such a stream.
    """

    live = True

    def __init__(self, address: Address, timeout_s: float) -> None:
        self.name = f"camera {address.shown}"
        self.ended = ""
        self.damaged = 0
        self._shown = address.shown
        self._closed = False
        self._reading = False
        self._timeout_s = timeout_s
        self._deadline = Deadline(timeout_s, max(OPENING_S, timeout_s))
        self._response = _answer(address, self._deadline)
        kind = self._response.headers.get_content_type()
        if not kind.startswith("multipart/"):
            self._response.close()
            raise CameraError(
                f"{self._shown}: answers with {short_name(kind)}, not with an MJPEG stream "
                "(multipart/x-mixed-replace); give the address of the camera's video stream"
            )
        found = _BOUNDARY.search(self._response.headers.get("Content-Type", "")[:_LONGEST_KIND])
        self._boundary = (found.group(1) or found.group(2) or "") if found else ""

    def notes(self) -> dict[str, str]:
        """How its frames are stamped."""
        return {"stamps": "arrival"}

    def frames(self) -> Iterator[Frame]:
        """The whole JPEGs as they come, until the camera ends the stream or falls silent.

        Raises:
            CameraError: what comes is no multipart stream.
        """
        self._reading = True
        self._deadline.renew(self._timeout_s)
        parser = MultipartParser(self._response.read1, self._boundary, time.monotonic_ns)
        try:
            for part in parser.parts():
                if self._closed:
                    return
                if is_whole(part.data):
                    yield Frame(wall_ns(part.arrived_ns), "jpeg", part.data)
                    self._deadline.renew(self._timeout_s)
                else:
                    self.damaged += 1
            self.ended = "the stream was closed by the camera"
        except TimeoutError:
            what = "no whole picture" if self._deadline.is_over else "no data"
            self.ended = f"{what} for {self._timeout_s:.1f} s"
        except (OSError, HTTPException) as error:
            self.ended = f"the connection to the camera broke ({_reason(error)})"
        except CameraError as error:
            raise CameraError(f"{self._shown}: {error}") from error
        finally:
            self._response.close()

    def close(self) -> None:
        """End running `frames`; the connection is closed there."""
        self._closed = True
        self._deadline.break_off()
        if not self._reading:
            self._response.close()


class _SameHost(request.HTTPRedirectHandler):
    """Follows a camera's redirection to another path, port or scheme of its own host alone.

    Elsewhere may be what only this machine can reach, and a camera shall not choose it.
    """

    max_redirections = 5

    def redirect_request(
        self, req: request.Request, fp: IO[bytes], code: int, msg: str, headers: Any, newurl: str
    ) -> request.Request | None:
        fp.close()  # else all of its body would be read, and it may have no end
        parts = urlsplit(newurl)
        host = urlsplit(req.full_url).hostname
        if parts.scheme not in ("http", "https") or parts.hostname != host:
            place = short_name(f"{parts.scheme}://{parts.netloc.rpartition('@')[2]}")
            raise CameraError(f"sends on to {place}; if that is right, give that address")
        return super().redirect_request(req, fp, code, msg, headers, newurl)


def _answer(address: Address, deadline: Deadline) -> HTTPResponse:
    passwords = request.HTTPPasswordMgrWithDefaultRealm()
    if address.user:
        passwords.add_password(None, address.url, address.user, address.password)
    opener = request.OpenerDirector()  # without proxies: a camera stands in the same room
    for handler in (
        DeadlineHandler(deadline),
        _SameHost(),
        request.HTTPBasicAuthHandler(passwords),
        request.HTTPDigestAuthHandler(passwords),
        request.HTTPDefaultErrorHandler(),
        request.HTTPErrorProcessor(),
    ):
        opener.add_handler(handler)
    shown = address.shown
    try:
        return opener.open(address.url, timeout=deadline.next_s())
    except CameraError as error:
        raise CameraError(f"{shown}: {error}") from error
    except HTTPError as error:
        error.close()
        remedies = {401: "put user:password@ before the host", 404: "check the path"}
        remedy = remedies.get(error.code, "check the address")
        said = f"{error.code} {short_name(error.reason)}"
        raise CameraError(f"{shown}: answers {said}; {remedy}") from error
    except URLError as error:
        is_known = isinstance(error.reason, Exception)
        why = short_name(_reason(error.reason) if is_known else error.reason)
        raise CameraError(
            f"{shown}: cannot be reached ({why}); is the camera on, and the address right?"
        ) from error
    except TimeoutError as error:
        seconds = deadline.whole_s if deadline.is_over else deadline.silence_s
        raise CameraError(
            f"{shown}: does not answer within {seconds:g} s; is the camera on?"
        ) from error
    except (OSError, HTTPException, ValueError) as error:
        raise CameraError(
            f"{shown}: does not answer as a camera does ({type(error).__name__}); check the address"
        ) from error


def _reason(error: object) -> str:
    return getattr(error, "strerror", None) or str(error) or type(error).__name__
