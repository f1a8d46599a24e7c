"""motion as a camera of a test: it shows another camera's pictures to who logs in."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from http.client import HTTPConnection, HTTPException
from pathlib import Path

import pytest

from tests.recorders.free_port import free_port
from tests.recorders.live_wait import LAST_RESORT_S, ending, wait_until

USER, PASSWORD = "me", "secret"
_AUTH = {"none": 0, "basic": 1, "digest": 2}


@contextmanager
def motion_server(folder: Path, camera: str, auth: str) -> Iterator[str]:
    """Serves; its address without a scheme.

    Args:
        folder: an empty one, for its files.
        camera: the address of the camera whose pictures it shows, without a scheme.
        auth: "none", "basic" or "digest", which it wants with `algorithm=md5`.
    """
    program = shutil.which("motion")
    if program is None:
        pytest.skip("motion is not installed")
    port = free_port()
    (folder / "motion.conf").write_text(
        f"daemon off\nsetup_mode off\nnetcam_url http://{camera}\nwidth 320\nheight 240\n"
        f"framerate 20\nstream_port {port}\nstream_localhost on\nstream_maxrate 20\n"
        f"stream_auth_method {_AUTH[auth]}\nstream_authentication {USER}:{PASSWORD}\n"
        f"webcontrol_port 0\npicture_output off\nmovie_output off\ntarget_dir {folder}\n"
    )

    def answers() -> bool:
        asking = HTTPConnection("127.0.0.1", port, timeout=LAST_RESORT_S)
        with suppress(OSError, HTTPException), closing(asking):
            asking.request("GET", "/")
            return asking.getresponse().status in (200, 401)
        return False

    with (folder / "motion.log").open("w") as log:
        words = [program, "-c", folder / "motion.conf"]
        process = subprocess.Popen(words, stdout=log, stderr=log, text=True)
        with ending(process):
            wait_until(answers, "motion's stream")
            yield f"127.0.0.1:{port}/"
