"""A network camera that sends JPEGs over HTTP (multipart/x-mixed-replace)."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from http.client import HTTPException, HTTPResponse
from urllib import request
from urllib.error import HTTPError, URLError

from recorders.camera.address import Address
from recorders.camera.multipart import MultipartParser
from tunenet_logs.clock import wall_ns
from tunenet_logs.episode import Frame
from tunenet_logs.errors import CameraError
from tunenet_logs.jpeg import is_whole

_BOUNDARY = re.compile(r'boundary\s*=\s*(?:"([^"]*)"|([^;\s]*))', re.IGNORECASE)
"""In a Content-Type: what separates the parts, with quotes or without."""


class MjpegStream:
    """An MJPEG stream over HTTP; its JPEGs stay untouched.

    A frame's stamp is when its first byte arrived. User and password in the address are sent when
    the camera asks for them (basic or digest), and go nowhere else.

    Args:
        address: where.
        timeout_s: for connecting, and for the longest silence.

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
        self._response = _answer(address, timeout_s)
        kind = self._response.headers.get_content_type()
        if not kind.startswith("multipart/"):
            self._response.close()
            raise CameraError(
                f"{self._shown}: answers with {kind}, not with an MJPEG stream "
                "(multipart/x-mixed-replace); give the address of the camera's video stream"
            )
        found = _BOUNDARY.search(self._response.headers.get("Content-Type", ""))
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
        parser = MultipartParser(self._response.read1, self._boundary, time.monotonic_ns)
        try:
            for part in parser.parts():
                if self._closed:
                    return
                if is_whole(part.data):
                    yield Frame(wall_ns(part.arrived_ns), "jpeg", part.data)
                else:
                    self.damaged += 1
            self.ended = "the stream was closed by the camera"
        except TimeoutError:
            self.ended = f"no data for {self._timeout_s:.1f} s"
        except (OSError, HTTPException) as error:
            self.ended = f"the connection to the camera broke ({_reason(error)})"
        except CameraError as error:
            raise CameraError(f"{self._shown}: {error}") from error
        finally:
            self._response.close()

    def close(self) -> None:
        """End running `frames` with the next part; the connection is closed there."""
        self._closed = True
        if not self._reading:
            self._response.close()


def _answer(address: Address, timeout_s: float) -> HTTPResponse:
    passwords = request.HTTPPasswordMgrWithDefaultRealm()
    if address.user:
        passwords.add_password(None, address.url, address.user, address.password)
    opener = request.build_opener(
        request.ProxyHandler({}),  # a camera stands in the same room
        request.HTTPBasicAuthHandler(passwords),
        request.HTTPDigestAuthHandler(passwords),
    )
    shown = address.shown
    try:
        return opener.open(address.url, timeout=timeout_s)
    except HTTPError as error:
        error.close()
        remedies = {401: "put user:password@ before the host", 404: "check the path"}
        remedy = remedies.get(error.code, "check the address")
        raise CameraError(f"{shown}: answers {error.code} {error.reason}; {remedy}") from error
    except URLError as error:
        why = _reason(error.reason) if isinstance(error.reason, Exception) else error.reason
        raise CameraError(
            f"{shown}: cannot be reached ({why}); is the camera on, and the address right?"
        ) from error
    except TimeoutError as error:
        raise CameraError(
            f"{shown}: does not answer within {timeout_s:g} s; is the camera on?"
        ) from error
    except (OSError, HTTPException, ValueError) as error:
        raise CameraError(
            f"{shown}: does not answer as a camera does ({type(error).__name__}); check the address"
        ) from error


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error) or type(error).__name__
