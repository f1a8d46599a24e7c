"""Record each log as it is read, and as `info` shows it: a part of `tests.bench.promises`.

The logs: samples, recordings and cases of others, one file of each kind, small files that hurt, and
all that the tests of `tunenet_logs` leave behind.
"""

from __future__ import annotations

import io
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import redirect_stderr, redirect_stdout
from functools import partial
from itertools import islice
from pathlib import Path

from tests.bench.promises import JOBS, ROOT, SHARED, Part, Texts, apart, digest, once, together
from tunenet_logs.cli import main as logs_main
from tunenet_logs.episode import Episode, Frame
from tunenet_logs.errors import TuneNetError
from tunenet_logs.reader import read_episode

_LOGS_A_JOB = 24
_MAX_FRAMES = 40
_MAX_BYTES, _MAX_BOMB_BYTES = 300_000, 8_000_000
# Bombs that take seconds to make or to refuse.
_DEAR = {"workbook_of_zeros", "bz2_table", "zip_of_many", "dense_table", "long_motive",
         "long_table", "zip_of_blanks", "zeros_npz", "zeros_mat", "zip_of_one_file",
         "bag_of_tiny_messages", "gzip_table", "zstd_table", "poses_in_chunks"}  # fmt: skip

# Tests whose files are kept: small ones, made in a minute or two.
_CHEAP = "not (bomb or fuzz or hostile or many or full_disk or test_work or test_video)"

_DOUBT = "names no unit and was taken as"
_NO_INPUTS = {".md", ".py", ".rrd", ".sh", ".lock"}


def episodes(inputs: Path) -> Texts:
    """Read every log, and show what is in it."""
    folder = once(inputs / "logs", _make_logs)
    logs = [path for group in sorted(folder.iterdir()) for path in sorted(group.iterdir())]
    bombs = [[path] for path in logs if path.parent.name.startswith("bombs+")]
    rest = [path for path in logs if [path] not in bombs]
    batches = bombs + [rest[at : at + _LOGS_A_JOB] for at in range(0, len(rest), _LOGS_A_JOB)]
    jobs = {
        str(paths[0].relative_to(folder)): partial(
            apart, str(paths[0].relative_to(folder)), _read_all, folder, paths
        )
        for paths in batches
    }
    return together(jobs, "reading")


def _read_all(folder: Path, paths: Sequence[Path]) -> Texts:
    said: Texts = {}
    for path in paths:
        name = str(path.relative_to(folder))
        for key, words in ((name, _episode_words), (f"{name}, info", _info_words)):
            text = words(path).replace(str(path), name).replace(str(path.parent), "FOLDER")
            said[key] = _in_order(text.replace(str(folder), "."))
    return said


def _in_order(text: str) -> str:
    """Sort doubts of a table's clocks among themselves: theirs is the order of a set."""
    lines = text.split("\n")
    doubts = iter(sorted(line for line in lines if _DOUBT in line))
    return "\n".join(next(doubts) if _DOUBT in line else line for line in lines)


def _info_words(path: Path) -> str:
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = logs_main(["info", str(path)])
    return f"{out.getvalue()}exit code {code}"


def _episode_words(path: Path) -> str:
    """Say all that an episode has, arrays as digests; or why there is none."""
    try:
        return "\n".join(_episode_lines(read_episode(path)))
    except TuneNetError as error:
        return f"{type(error).__name__}: {error}"
    except Exception as error:  # noqa: BLE001 (a file that breaks a reader is recorded as such)
        return f"not caught: {type(error).__name__}: {error}"


def _episode_lines(episode: Episode) -> Iterator[str]:
    yield json.dumps(episode.info.to_strings())
    for name, one in episode.signals.items():
        told = (one.name, one.unit, one.columns, one.frame, one.counts_frames, one.drives)
        arrays = (one.values.shape, digest(one.stamps_ns), digest(one.values))
        yield f"signal {name}: {told} {arrays} left out {dict(one.left_out)}"
    for one in episode.channels:
        told = (one.type_name, one.encoding, one.pictures, one.drives, one.sounds, one.skipped)
        arrays = (one.messages, digest(one.log_ns))
        yield f"channel {one.topic}: {told} {arrays} left out {dict(one.left_out)}"
    for what in ("warnings", "losses"):
        yield from (f"{what}: {line}" for line in getattr(episode, what))
    yield f"tainted {episode.tainted!r}, frames untimed {episode.frames_untimed}"
    for topic in episode.picture_topics:
        yield f"frames {topic}: {_frames_words(episode, topic)}"
    for topic in episode.sound_topics:
        yield f"sound {topic}: {_sound_words(episode, topic)}"


def _frames_words(episode: Episode, topic: str) -> str:
    """Say what the first frames are, and what the last of them shows."""
    found: list[Frame] = []
    try:
        found.extend(islice(episode.frames(topic), _MAX_FRAMES))
        stamps = [frame.stamp_ns for frame in found]
        last = found[-1:]
        told = [(one.encoding, one.size_px(), digest(one.data)) for one in last]
        return f"{len(found)} {digest(stamps)} {told} {[digest(one.decode()) for one in last]}"
    except TuneNetError as error:
        return f"{len(found)}, then {type(error).__name__}: {error}"


def _sound_words(episode: Episode, topic: str) -> str:
    try:
        if (one := episode.sounds(topic)) is None:
            return "none"
        told = (one.name, one.start_ns, one.rate_hz, one.file_rate_hz, one.channels, one.codec)
        return f"{told} {len(one.samples)} {digest(one.samples)} {one.warnings}"
    except TuneNetError as error:
        return f"{type(error).__name__}: {error}"


def _make_logs(folder: Path) -> None:
    """Collect all logs, each in the folder of its group."""
    from tests import (
        definition_bombs,
        export_bombs,
        hostile,
        small_exports,
        sound_bombs,
        work_bombs,
    )

    for name, given in {"samples": ROOT / "sample_logs", "real": SHARED / "real",
                        "cases": SHARED / "cases"}.items():  # fmt: skip
        _keep_files(folder, given, name, _MAX_BOMB_BYTES)
    (folder / "kinds").mkdir()
    for name, make in small_exports.KINDS.items():
        make(folder / "kinds" / name)
    in_a_folder = (*sound_bombs.BOMBS, *export_bombs.BOMBS)
    to_a_file = (*hostile.BOMBS, *definition_bombs.BOMBS, *work_bombs.BOMBS)
    for bomb in (*in_a_folder, *to_a_file):
        place = folder / f"bombs+{bomb.__module__.split('.')[-1]}+{bomb.__name__}"
        if bomb.__name__ in _DEAR:
            continue
        place.mkdir()
        bomb(place if bomb in in_a_folder else place / "bomb.mcap")  # type: ignore[arg-type]
        size = sum(path.stat().st_size for path in place.rglob("*") if path.is_file())
        if size > _MAX_BOMB_BYTES:
            shutil.rmtree(place)
    with tempfile.TemporaryDirectory() as left:
        words = [
            "-q",
            "-k",
            _CHEAP,
            "-n",
            str(JOBS),
            "--dist",
            "loadfile",
            "-p",
            "no:cacheprovider",
        ]
        words += ["-m", "not slow and not docs and not live", "-o", "tmp_path_retention_policy=all"]
        words = [sys.executable, "-m", "pytest", "tests/tunenet_logs", *words]
        subprocess.run([*words, f"--basetemp={left}/all"], check=False, cwd=ROOT, stdout=2)
        _keep_files(folder, Path(left), "tests", _MAX_BYTES)


def _keep_files(folder: Path, given: Path, name: str, largest: int) -> None:
    """Copy every file below `given`, and every bag's folder, equal ones once."""
    seen: set[str] = set()
    for path in sorted(given.rglob("*")):
        parts = path.relative_to(given).parts
        is_bag = path.is_dir() and (path / "metadata.yaml").is_file()
        if path.is_symlink() or not (path.is_file() or is_bag) or "licences" in parts:
            continue
        if path.suffix in _NO_INPUTS or path.stem in ("README", "LICENSE"):
            continue
        files = sorted(path.glob("*")) if is_bag else [path]
        files = [one for one in files if one.is_file()]
        if sum(one.stat().st_size for one in files) > largest:
            continue
        content = path.suffix + digest(b"".join(one.read_bytes() for one in files))
        if content not in seen:
            seen.add(content)
            place = folder / "+".join((name, *parts[:-1])) / path.name
            place.parent.mkdir(parents=True, exist_ok=True)
            (shutil.copytree if is_bag else shutil.copyfile)(path, place)


PARTS: dict[str, Part] = {"episodes": episodes}
