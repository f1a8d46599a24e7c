"""Draws the pictures of docs/gallery.md again: `python docs/make_pictures.py [NAME...]`.

Each section of the gallery has its commands and its picture. The commands are run as they stand
there, in a folder of their own; what the last of them, `rerun`, would open is drawn by a viewer
without a window, at a moment that the picture's comment names as a fraction of the time shown.
"""

from __future__ import annotations

import io
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from rerun.experimental import ViewerClient

ROOT = Path(__file__).resolve().parents[1]
GALLERY = ROOT / "docs" / "gallery.md"
BIN = Path(sys.executable).parent
SECTION = re.compile(
    r"```sh\n(?P<commands>(?:.*\n)*?)rerun (?P<review>\S+)\n```\n(?:.*\n)*?"
    r"!\[[^]]*\]\((?P<picture>\S+)\)(?: <!-- at (?P<moment>[\d.]+) -->)?"
)
SIZE_PX = (1280, 720)
BAR_PX = 37  # the viewer's own, with words about the machine that draws
# Until a viewer shows all; after which its notices are gone; between two looks.
_MAX_S, _NOTICES_S, _EVERY_S = 90.0, 9.0, 1.5


def main() -> int:
    """Draw those that are named, else all."""
    names = set(sys.argv[1:])
    for section in SECTION.finditer(GALLERY.read_text()):
        picture = GALLERY.parent / section["picture"]
        if not names or picture.stem in names:
            with tempfile.TemporaryDirectory() as folder:
                review = reviewed(section["commands"], section["review"], Path(folder))
                moment = None if section["moment"] is None else float(section["moment"])
                picture.parent.mkdir(exist_ok=True)
                picture.write_bytes(reduced(screenshot(review, moment)))
            size_kb = picture.stat().st_size / 1000
            print(f"{picture.relative_to(ROOT)}: {size_kb:.0f} kB", flush=True)
    return 0


def reviewed(commands: str, name: str, folder: Path) -> Path:
    """Run a section's commands in a folder; return the review that they made."""
    shutil.copytree(ROOT / "sample_logs", folder / "sample_logs")
    environment = {**os.environ, "PATH": f"{BIN}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}
    subprocess.run(["bash", "-c", commands], cwd=folder, env=environment, check=False)
    if not (folder / name).is_file():
        raise FileNotFoundError(f"{name}: its commands have not made it")
    return folder / name


def screenshot(review: Path, moment: float | None) -> bytes:
    """Return a PNG of the whole viewer, when nothing in it moves any more.

    It stops at `moment`, a fraction of the active timeline; None: where the review begins.
    """
    from rerun.experimental import ViewerClient

    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        port = one.getsockname()[1]
    words = [str(BIN / "rerun"), str(review), "--headless", "--port", str(port)]
    words += ["--window-size", "{}x{}".format(*SIZE_PX), "--hide-welcome-screen"]
    nowhere = subprocess.DEVNULL
    viewer = subprocess.Popen(words, stdout=nowhere, stderr=nowhere, start_new_session=True)
    began_s = time.monotonic()
    try:
        before = b""
        while time.monotonic() - began_s < _MAX_S:
            time.sleep(_EVERY_S)
            try:
                client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
                _hold(client, moment)
                now = client.take_screenshot()
            except (RuntimeError, ValueError, ConnectionError):  # it has only just begun
                continue
            if now == before and time.monotonic() - began_s > _NOTICES_S:
                return now
            before = now
        raise TimeoutError(f"{review}: the viewer shows no still picture in {_MAX_S:.0f} s")
    finally:
        os.killpg(viewer.pid, signal.SIGTERM)  # the command, and the viewer that it started
        viewer.wait()


def _hold(client: ViewerClient, moment: float | None) -> None:
    """Stop at a moment of the active timeline."""
    state = client.get_state()
    if state.loading or state.active_recording is None:
        raise ValueError("it is still loading")
    (recording,) = (one for one in state.recordings if one.store_id == state.active_recording)
    if not recording.timelines:  # nothing in it moves
        return
    if moment is None:
        client.set_time(play_state="paused")
        return
    lines = {line.name: line for line in recording.timelines}
    line = lines[recording.current_timeline or ""]
    at = round((1 - moment) * (line.start or 0) + moment * (line.end or 0))
    value = {
        "sequence": at,
        "duration": np.timedelta64(at, "ns"),
        "timestamp": np.datetime64(at, "ns"),
    }[line.time_type]
    client.set_time(line.name, play_state="paused", **{line.time_type: value})


def reduced(png: bytes) -> bytes:
    """The same in the gallery's size and with a palette, without the viewer's own bar."""
    from PIL import Image

    picture = Image.open(io.BytesIO(png)).convert("RGB").resize(SIZE_PX, Image.Resampling.LANCZOS)
    picture = picture.crop((0, BAR_PX, *SIZE_PX))
    small = picture.quantize(256, Image.Quantize.MAXCOVERAGE, kmeans=2, dither=Image.Dither.NONE)
    out = io.BytesIO()
    small.save(out, "PNG", optimize=True)
    return out.getvalue()


if __name__ == "__main__":
    sys.exit(main())
