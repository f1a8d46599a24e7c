"""Record what the commands promise beside their tunings, to hold later versions against.

    python -m tests.bench.promises --write DIR     make the inputs, keep them and all answers in DIR
    python -m tests.bench.promises --compare DIR   answer the same inputs again: what has moved?

Each part is a function from the folder of its inputs, `DIR/inputs`, which it makes only if they are
not there yet, to texts by name; what it said is kept as `DIR/PART.json`. `--compare` ends with 1 if
anything moved. What `tunenet-tune` finds is held by `tests.bench.answers`, with more logs.

Commands are those of `pyproject.toml`, each in a process of its own, so that nothing here depends
on how the inside is cut.
"""

from __future__ import annotations

import argparse
import difflib
import hashlib
import io
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import (
    AbstractContextManager,
    ExitStack,
    contextmanager,
    nullcontext,
    redirect_stderr,
    redirect_stdout,
)
from dataclasses import dataclass, field
from functools import cache, partial
from html import unescape
from itertools import islice
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from threading import Lock
from typing import Any, NamedTuple

import numpy as np
from mcap.reader import make_reader
from numpy.typing import ArrayLike
from tqdm import tqdm

from tests.bench import ROOT, SAMPLES, SHARED, kept_or_compared
from tests.clips import clicks, write_clip
from tests.recorders.films import film
from tests.recorders.mjpeg_camera import playing
from tests.recorders.ros2_publisher import STATES, TORQUES, free_domain, publishing
from tests.recorders.servers import rtsp_camera
from tunenet_logs.cli import main as logs_main
from tunenet_logs.episode import Episode, Frame
from tunenet_logs.errors import TuneNetError
from tunenet_logs.reader import read_episode

SCRIPTS: dict[str, str] = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
INPUTS, JOBS = "inputs", 2  # at a time
SETTINGS = {  # of all that is started
    "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1",
    "COLUMNS": "200", "TZ": "UTC",
    "PYTHONHASHSEED": "0",  # the order of some warnings is that of a set
}  # fmt: skip
_MAX_S = 600  # that one job may take
_MAX_LINES = 12  # of a difference, that are shown

Texts = dict[str, str]
Part = Callable[[Path], Texts]  # from `DIR/inputs` to what is promised, by name: a digest or a text


def together(jobs: Mapping[str, Callable[[], str | Texts]], what: str) -> Texts:
    """Do all jobs, `JOBS` at a time, and join what they say; a text by the job's name."""
    with ThreadPoolExecutor(JOBS) as pool:
        said = pool.map(lambda job: job(), jobs.values())
        said = list(tqdm(said, what, len(jobs), disable=None))
    texts: Texts = {}
    for name, one in zip(jobs, said, strict=True):
        texts |= {name: one} if isinstance(one, str) else one
    return texts


def apart(name: str, work: Callable[..., Texts], *arguments: object) -> Texts:
    """Work in a fresh process, whose end is an answer, too."""
    context = get_context("forkserver")
    context.set_forkserver_preload(["tests.bench.promises"])  # once for all fresh processes
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_send, args=(theirs, work, arguments))
    process.start()
    theirs.close()
    try:
        return ours.recv() if ours.poll(_MAX_S) else {name: f"took over {_MAX_S} s"}
    except EOFError:
        process.join()
        return {name: f"ended by {process.exitcode}"}
    finally:
        process.kill()
        process.join()


def _send(pipe: Connection, work: Callable[..., Texts], arguments: Sequence[object]) -> None:
    pipe.send(work(*arguments))
    pipe.close()


def once(folder: Path, make: Callable[[Path], object]) -> Path:
    """Make a folder of inputs unless it is there."""
    if not folder.exists():
        unfinished = folder.with_name(f"{folder.name}.partial")
        shutil.rmtree(unfinished, ignore_errors=True)
        unfinished.mkdir(parents=True)
        make(unfinished)
        unfinished.rename(folder)
    return folder


def digest(data: bytes | ArrayLike, digits: int = 16) -> str:
    """Shorten bytes, or the bytes of an array, to digits of their SHA-256."""
    kept = data if isinstance(data, bytes) else np.asarray(data).tobytes()
    return hashlib.sha256(kept).hexdigest()[:digits]


whole_digest = partial(digest, digits=64)


class Ran(NamedTuple):
    """What a command did in a folder."""

    code: int  # its exit code
    out: str  # what it said, the folder called DIR
    err: str  # likewise


_START = "import sys; sys.argv[0] = {name!r}; from {module} import {call}; sys.exit({call}())"


def ran(words: Sequence[str], folder: Path, stdin: bytes = b"") -> Ran:
    """Run a command by its name, in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-P", "-c", _start(words[0]), *words[1:]], cwd=folder,
        env={**os.environ, **SETTINGS, "COLUMNS": "100", "LC_ALL": "C.UTF-8"},
        input=stdin, capture_output=True, timeout=120, check=False,
    )  # fmt: skip
    out, err = (one.decode().replace(str(folder), "DIR") for one in (done.stdout, done.stderr))
    return Ran(done.returncode, out, err)


def _start(name: str) -> str:
    module, call = SCRIPTS[name].split(":")
    return _START.format(name=name, module=module, call=call)


def _shell(commands: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run lines of a shell with the commands of this tree, whatever tree is installed."""
    with tempfile.TemporaryDirectory() as place:
        for name in SCRIPTS:
            script = Path(place) / name
            script.write_text(f'#!/bin/sh\nexec {sys.executable} -P -c "{_start(name)}" "$@"\n')
            script.chmod(0o755)
        path = f"{place}:{Path(sys.executable).parent}:{os.environ['PATH']}"
        return subprocess.run(
            ["/bin/sh", "-c", commands], check=False, capture_output=True, text=True, cwd=folder,
            env={**os.environ, **SETTINGS, "PATH": path},
        )  # fmt: skip


# ---- Logs: each as it is read, and as `info` shows it. Samples, recordings and cases of others,
# one file of each kind, small files that hurt, and what the tests of `tunenet_logs` leave behind.

_LOGS_A_JOB, _MAX_FRAMES = 24, 40
_MAX_BYTES, _MAX_BOMB_BYTES = 300_000, 8_000_000
# Bombs that take seconds to make or to refuse.
_DEAR = {"workbook_of_zeros", "bz2_table", "zip_of_many", "dense_table", "long_motive",
         "long_table", "zip_of_blanks", "zeros_npz", "zeros_mat", "zip_of_one_file",
         "bag_of_tiny_messages", "gzip_table", "zstd_table", "poses_in_chunks"}  # fmt: skip
# Tests whose files are kept: small ones, made in a minute or two.
_CHEAP = "not (bomb or damage or hostile or many or full_disk or test_work or test_video)"
_DOUBT = "names no unit and was taken as"
_NO_INPUTS = {".md", ".py", ".rrd", ".sh", ".lock"}


def episodes(inputs: Path) -> Texts:
    """Read every log, and show what is in it."""
    folder = once(inputs / "logs", _make_logs)
    logs = [path for group in sorted(folder.iterdir()) for path in sorted(group.iterdir())]
    bombs = [[path] for path in logs if path.parent.name.startswith("bombs+")]
    rest = [path for path in logs if [path] not in bombs]
    batches = bombs + [rest[at : at + _LOGS_A_JOB] for at in range(0, len(rest), _LOGS_A_JOB)]
    names = [str(paths[0].relative_to(folder)) for paths in batches]
    jobs = {
        name: partial(apart, name, _read_all, folder, paths)
        for name, paths in zip(names, batches, strict=True)
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
    out = io.StringIO()
    with redirect_stdout(out), redirect_stderr(io.StringIO()):
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
    from tests import small_exports
    from tests.hostile_files import EVERY

    for name, given in {"samples": SAMPLES, "real": SHARED / "real",
                        "cases": SHARED / "cases"}.items():  # fmt: skip
        _keep_files(folder, given, name, _MAX_BOMB_BYTES)
    (folder / "kinds").mkdir()
    for name, make in small_exports.KINDS.items():
        make(folder / "kinds" / name)
    for name, bomb in EVERY.items():
        if name in _DEAR:
            continue
        place = folder / f"bombs+{name}"
        place.mkdir()
        bomb.write(place)
        size = sum(path.stat().st_size for path in place.rglob("*") if path.is_file())
        if size > _MAX_BOMB_BYTES:
            shutil.rmtree(place)
    with tempfile.TemporaryDirectory() as left:
        words = f"-q -n {JOBS} --dist loadfile -p no:cacheprovider --basetemp={left}/all".split()
        words += ["-o", "tmp_path_retention_policy=all", "-m", "not slow and not docs and not live"]
        pytest = [sys.executable, "-m", "pytest", "tests/tunenet_logs", "-k", _CHEAP]
        subprocess.run([*pytest, *words], check=False, cwd=ROOT, stdout=2)
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


# ---- Reviews, exports and reports, as a user runs them in a copy of a bench: the samples, what the
# gallery's commands need beside them, and tunings that were kept when the bench was made.

_TEXTS = {".json", ".html", ".csv", ".xml", ".sdf", ".urdf", ".usda", ".py", ".yaml"}
# Columns of a ledger that tell when, or how long it took.
_LEDGER_CLOCK = re.compile("second|date|time_s|modified|tuned")

# Reviews of the tests that the bench makes, too.
_AS_OTHERS = {"payload_of_no_arm", "filmed_drop", "payload_without_tare"}

_ARM_BAG = SHARED / "real" / "ros1" / "jaco_names_recorded_by_rosbag.bag"
_MODEL = (
    "sample_logs/models/{0}.mcap --model sample_logs/models/{0}.xml "
    "--tune sample_logs/models/{0}.yaml"
)
# Tunings that are kept, to be exported, compared and reported.
_TUNED = {
    "light": "sample_logs/light.mcap",
    "filmed": "sample_logs/filmed.mcap",
    "noisy": "sample_logs/noisy.mcap",
    "payload": "sample_logs/payload.mcap --tare sample_logs/payload_empty.mcap",
    "pendulum": _MODEL.format("pendulum"),
    "rejected": "sample_logs/campaign/drop_6.mcap",
}

_MORE_RUNS = {
    "untared": "tunenet-tune sample_logs/payload.mcap -o demo",
    "paper": "tunenet-tune sample_logs/bouncy.mcap --preset paper -o demo",
    "pendulum": f"tunenet-tune {_MODEL.format('pendulum')} -o demo",
    "block": f"tunenet-tune {_MODEL.format('block')} -o demo",
    "no log": "tunenet-tune tuned/light.json -o demo",
    "no arm": "tunenet-tune arm.bag --task payload -o demo",
}
_REPORTS = {
    **{f"report of {name}": f"tunenet-report tuned/{name}.json -o page.html --quiet"
       for name in _TUNED},
    "report of all": "mv tuned/*.rrd .; tunenet-report tuned -o page.html --quiet; rm *.rrd",
    "report of a campaign": "tunenet-report sample_logs/campaign -o page.html --quiet",
    "figures": "tunenet-report tuned/light.json --png drawn --quiet; ls drawn; rm -r drawn",
    "compare": "tunenet-compare tuned --csv balls.csv --html page.html",
    "compare nothing": "tunenet-compare tuned/rejected.json",
    "plan of a tuning": "tunenet-plan tuned/noisy.json --json plan.json",
    "plan of a light ball": "tunenet-plan tuned/light.json",
    "plan of a number": "tunenet-plan --save-rig rig.yaml; "
    "tunenet-plan --restitution 0.74 --slope 0.08 --rig rig.yaml",
    "plan of none": "tunenet-plan tuned/rejected.json",
}  # fmt: skip
_EXPORTS = "\n".join(
    [
        *(f"tunenet-export tuned/{name}.json --to ENGINE; echo exit code $?" for name in _TUNED),
        "cp tuned/light.json tuned/fast.json",
        "tunenet-export tuned/fast.json --to ENGINE --speed 3 --radius 0.03 --mass 0.05",
        "rm tuned/fast.json",
    ]
)


def reviews(inputs: Path) -> Texts:
    """Describe the gallery's reviews, and those of the tests."""
    from tests.analysis.review.test_no_view_is_empty import MAKERS

    jobs = {
        make.__name__: partial(apart, f"tests: {make.__name__}", _made_review, make)
        for make in MAKERS
        if make.__name__ not in _AS_OTHERS
    }
    gallery = {name: text for name, text in _gallery(inputs).items() if name.endswith(".rrd")}
    return gallery | together(jobs, "reviews")


def exports(inputs: Path) -> Texts:
    """Export the kept tunings to every engine; a ball also for one speed."""
    from tunenet_logs.analysis.export.registry import FORMATS

    runs = {engine: _EXPORTS.replace("ENGINE", engine) for engine in sorted(FORMATS)}
    return _all(runs, _bench(inputs), "exports")


def reports(inputs: Path) -> Texts:
    """Write pages, comparisons and plans of the kept tunings; keep what the gallery said."""
    told = {name: text for name, text in _gallery(inputs).items() if not name.endswith(".rrd")}
    return told | _all(_REPORTS, _bench(inputs), "reports")


@cache
def _gallery(inputs: Path) -> Texts:
    """Run the gallery's commands, and some more."""
    bench = _bench(inputs)
    return _all(json.loads((bench / "gallery.json").read_text()), bench, "gallery")


def _all(runs: dict[str, str], bench: Path, what: str) -> Texts:
    return together({k: partial(_run, bench, k, v) for k, v in runs.items()}, what)


def _bench(inputs: Path) -> Path:
    return once(inputs / "bench", _make_bench)


def _make_bench(folder: Path) -> None:
    """Lay out what the gallery's commands need, and tunings."""
    from docs.make_pictures import GALLERY, SECTION

    shutil.copytree(ROOT / "sample_logs", folder / "sample_logs")
    if _ARM_BAG.is_file():
        shutil.copyfile(_ARM_BAG, folder / "arm.bag")
    sections = SECTION.finditer(GALLERY.read_text())
    runs = {Path(one["picture"]).stem: one["commands"].splitlines() for one in sections}
    ours = {name: [line for line in lines if line.startswith("tunenet-")]
            for name, lines in runs.items()}  # fmt: skip
    told = {name: "\n".join(lines) for name, lines in ours.items()} | _MORE_RUNS
    (folder / "gallery.json").write_text(json.dumps(told))
    commands = [line for name, lines in runs.items() for line in lines if line not in ours[name]]
    commands.append("mkdir tuned")
    for name, words in _TUNED.items():
        commands.append(f"tunenet-tune {words} -o made --quiet")
        commands.append(f"mv made/*.json tuned/{name}.json; mv made/*.rrd tuned/{name}.rrd")
    _shell("\n".join([*commands, "rmdir made"]), folder)


def _run(bench: Path, name: str, commands: str) -> Texts:
    """Run lines of a shell in a copy of `bench`: what they say, and the files that they write."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "bench"
        shutil.copytree(bench, folder)
        done = _shell(commands, folder)
        refused = [line for line in done.stderr.splitlines() if line.startswith("tunenet-")]
        said = [_untimed(done.stdout), *refused, f"exit code {done.returncode}"]
        texts = {f"{name}: said": "\n".join(said)}
        for file in sorted(folder.rglob("*")):
            within = file.relative_to(folder)
            if file.is_file() and not (bench / within).exists():
                texts[f"{name}: {within}"] = _file_words(file)
        return {name: text.replace(str(folder), ".") for name, text in texts.items()}


def _untimed(text: str) -> str:
    """Blank the times in a table of tunings, and what fills it up."""
    lines, at = [], None
    for line in text.splitlines():
        cells = re.split(r" {2,}", line.rstrip())
        at = cells.index("time") if "time" in cells else at if line else None
        if at is not None and len(cells) > at and re.fullmatch(r"[\d.]+ \w+", cells[at]):
            cells[at] = "#"
        lines.append("  ".join(cells))
    return re.sub("tuned in .*", "tuned in #", "\n".join(lines))


def _file_words(path: Path) -> str:
    """Say what is in a file of results, without the times that it took."""
    if path.suffix == ".rrd":
        return _review_words(path)
    if path.suffix == ".parquet":
        import pandas as pd

        table = pd.read_parquet(path)
        kept = sorted(name for name in map(str, table) if not _LEDGER_CLOCK.search(name))
        return table.sort_values("log")[kept].to_csv(index=False, float_format="%.9g")
    if path.suffix not in _TEXTS:
        return digest(path.read_bytes())
    text = path.read_text("utf-8", errors="surrogateescape")
    if path.suffix == ".html":
        bare = re.sub(r"(?s)<(script|style)\b.*?</\1>", "", text)
        bare = re.sub(r"(?s)<(img|svg)\b.*?>", r" [\1] ", bare)
        return re.sub(r"\s*\n\s*", "\n", unescape(re.sub(r"<[^>]+>", "\n", bare))).strip()
    return json.dumps(_rounded(json.loads(text)), indent=1) if path.suffix == ".json" else text


def _rounded(value: Any) -> Any:
    """Round to nine digits, and leave wall times out."""
    if isinstance(value, dict):
        return {k: _rounded(one) for k, one in value.items() if k not in ("seconds", "date")}
    if isinstance(value, list):
        return [_rounded(one) for one in value]
    return float(f"{value:.9g}") if isinstance(value, float) else value


def _made_review(make: Callable[[Path], Path]) -> Texts:
    out = io.StringIO()
    with tempfile.TemporaryDirectory() as place, redirect_stdout(out), redirect_stderr(out):
        folder = Path(place) / "made"  # a campaign is called by its folder
        folder.mkdir()
        return {f"tests: {make.__name__}": _review_words(make(folder))}


def _review_words(path: Path) -> str:
    """Say which entities have how many rows of what, and which views show them."""
    from tests.analysis.review.stored import Stored

    stored = Stored(path)
    lines = []
    for entity, components in sorted(stored.entities.items()):
        for name, one in sorted(components.items()):
            timed = {timeline: len(times) for timeline, (times, _) in sorted(one.timed.items())}
            lines.append(f"{entity} {name}: {len(one.static)} static, {timed}")
    lines += [f"timeline {name}: {len(times)}" for name, times in sorted(stored.timelines.items())]
    lines += [f"view {one.kind} {one.name} in {one.tabs}: {one.entities}" for one in stored.views]
    return "\n".join(lines)


# ---- What the commands say: every help, and the lines of `refusals.txt`.

ALL = {"tunenet-tune": ["all"], "tunenet-record": ["all"]}  # which tell little without it
SUBCOMMANDS = {"tunenet-logs": ("info", "check", "recover", "import")}
LINES = Path(__file__).with_name("refusals.txt")

_OPTION = re.compile(r"^  (?:-\w(?: \S+)?, )?(--[\w-]+) ?(\S+)?", re.MULTILINE)
_NOT_SWEPT = {"--help", "--version", "--debug", "--print-completion", "--output", "--ray"}
_CLOCK = re.compile(
    r"""(?<=such as ')[\d-]+ [\d:]+(?=')|(?<="seconds": ){[^{}]*}|(?<="date": )"[^"]*\""""
)
# What is said of the time now and in JSON of how long it took; the latter by `tunenet-tune`.
_TOOK = re.compile(
    r" {2,}\d+\.\d+ s(?=  |$)| in [\d.]+ s, [\d.]+ a second|(read|total) [\d.]+ s"
    r"|(?<=rollouts  )time *",
    re.MULTILINE,
)


def all_help(folder: Path) -> Texts:
    """Return every help as it is, versions, and the digests of the shells' completions."""
    commands = [[name] for name in SCRIPTS]
    below = [[name, one] for name, ones in SUBCOMMANDS.items() for one in ones]
    shells = [["--print-completion", one] for one in ("bash", "zsh", "tcsh")]
    asked = [[*words, "--help"] for words in (*commands, *below)]
    asked += [[name, "--help", *topic] for name, topic in ALL.items()]
    asked += [[*words, *more] for words in commands for more in (["--version"], *shells)]

    def told(words: Sequence[str]) -> str:
        done = ran(words, folder)
        out = whole_digest(done.out.encode()) if "--print-completion" in words else done.out
        return f"exit code {done.code}\n{out}{done.err}"

    return together({" ".join(words): partial(told, words) for words in asked}, "help")


def refusals(inputs: Path) -> Texts:
    """Return what each line of `refusals.txt` answers and leaves, in a copy of the inputs."""
    folder = once(inputs / "commands", _make_inputs)
    asked = dict.fromkeys(tuple(words) for line in _refused() for words in _swept(*line))
    return together(
        {" ".join(words): partial(_answer, folder, words) for words in asked}, "refusals"
    )


def _refused() -> Iterator[tuple[str, list[str]]]:
    """Yield the command lines of `refusals.txt`, each with its sign or ""."""
    for block in re.findall(r"^(tunenet.*):\n((?: .*\n)+)", LINES.read_text(), re.MULTILINE):
        for item in block[1].split("|"):
            sign, *words = item.split() if item.split()[0] in "+?" else ["", *item.split()]
            yield sign, [*block[0].split(), *(words if words != ["nothing"] else [])]


def _swept(sign: str, words: list[str]) -> Iterator[list[str]]:
    """Yield a line, and after a sign the same with each option of its command, right or wrong."""
    yield words
    if not sign:
        return
    head = 2 if words[0] in SUBCOMMANDS else 1
    for option, value in _OPTION.findall(
        ran([*words[:head], "--help", *ALL.get(words[0], [])], ROOT).out
    ):
        if option not in _NOT_SWEPT:
            given = value[1:].split(",")[0].rstrip("}") if value.startswith("{") else "1"
            given = "nonsense" if sign == "?" else given
            yield [*words[:head], option, *[given] * bool(value), *words[head:]]


def _answer(inputs: Path, words: Sequence[str]) -> str:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "here"
        shutil.copytree(inputs, folder)
        done = ran(words, folder)
        before, after = _files(inputs), _files(folder)
    left = [f"{name} is new" for name in sorted(after.keys() - before.keys())]
    left += [f"{name} is another" for name, one in before.items() if after.get(name) != one]
    said = f"exit code {done.code}\n--- out\n{done.out}--- err\n{done.err}"
    said = _CLOCK.sub("...", said)
    said = _TOOK.sub(" ...", said) if words[0] == "tunenet-tune" else said
    return said + "".join(f"--- {one}\n" for one in left)


def _files(folder: Path) -> dict[str, str]:
    paths = (one for one in sorted(folder.rglob("*")) if one.is_file())
    return {str(one.relative_to(folder)): whole_digest(one.read_bytes()) for one in paths}


def _make_inputs(folder: Path) -> None:
    """Write logs, tunings and files that are nothing, for the lines of `refusals.txt`."""
    (folder / "empty").mkdir()
    for name, source in (("drop", "bouncy"), ("held", "payload"), ("pendulum", "models/pendulum")):
        shutil.copy(SAMPLES / f"{source}.mcap", folder / f"{name}.mcap")
    shutil.copy(SAMPLES / "models" / "pendulum.xml", folder)
    whole = (folder / "drop.mcap").read_bytes()
    middle = len(whole) // 2
    broken = whole[:middle] + bytes(64) + whole[middle + 64 :]
    rows = [f"{at / 100},1,2,3" for at in range(50)]
    texts = {
        "flat.csv": "\n".join(["t,x,y,z", *rows]),
        "frames.csv": "\n".join(["frame,x,y", *(f"{at},{at},5" for at in range(50))]),
        "words.csv": "one,two\nthree,four\n",
        "words.txt": "These are only words.\n",
        "words.yaml": "words: [1, 2\n",
        "other.yaml": "words: 1\n",
        "words.xml": "<mujoco><worldbody><body></mujoco>",
        "words.urdf": "<robot name='a'/>",
        "page.html": "<!DOCTYPE html><html><body>log in</body></html>",
        "other.json": '{"words": 1}',
        "outcomes.csv": "ball,success\nred,perhaps\n",
    }
    starts = {
        "a.h5": b"\x89HDF\r\n\x1a\n", "a.pdf": b"%PDF-1.7\n", "a.7z": b"7z\xbc\xaf\x27\x1c",
        "a.png": b"\x89PNG\r\n\x1a\n", "a.ulg": b"ULog\x01", "a.pkl": bytes((128, 4)),
        "a.rrd": b"RRF2", "a.bag": b"#ROSBAG V2.0\n", "a.mp4": b"\0\0\0\x18ftypmp42",
    }  # fmt: skip
    bytes_of: dict[str, bytes] = {name: text.encode() for name, text in texts.items()}
    bytes_of |= {name: start + bytes(100) for name, start in starts.items()}
    bytes_of |= {f"junk.{kind}": bytes(range(200)) for kind in ("mcap", "json", "safetensors")}
    bytes_of |= {"broken.mcap": broken, "cut.mcap": whole[:middle], "nothing.mcap": b""}
    for name, data in bytes_of.items():
        (folder / name).write_bytes(data)
    make_clips(folder)
    logs = ["drop.mcap", "held.mcap", "flat.csv"]
    ran(["tunenet-tune", *logs, "-o", ".", "--no-review", "--jobs", "1", "--quiet"], folder)
    for path in folder.glob("ledger.*"):
        path.unlink()


def make_clips(folder: Path) -> None:
    """Write a film with sound, one without, one for a pipe, a sound, and silence."""
    write_clip(folder / "clip.mp4", clicks([0.2, 0.9]), "aac", film="libx264", pictures=60)
    write_clip(folder / "clicks.wav", clicks([0.2, 0.9, 1.6]), "pcm_s16le")
    write_clip(folder / "silent.wav", np.zeros(48_000, np.float32), "pcm_s16le")
    for name, kind in (("film.mp4", "mp4"), ("film.mkv", "matroska")):
        (folder / name).write_bytes(film(kind))


# ---- Recordings from each kind of source: of a simulation or a file all is told; of a source with
# a clock of its own, what is neither a time nor due to one. MCAP's own reader reads the logs.

_STAMP_BYTES = 12  # of a message with a header: CDR's own four bytes, seconds and nanoseconds


@dataclass(frozen=True)
class Recording:
    """A log to record."""

    words: str  # after `tunenet-record`; SOURCE is what `source` says
    # A server, while it is recorded.
    source: Callable[[], AbstractContextManager[str]] = field(default=lambda: nullcontext(""))
    live: bool = False  # whether its times and its pace are a clock's
    uncounted: tuple[str, ...] = ()  # topics whose messages have no number of their own
    stdin: str = ""  # a file of the inputs that is piped in


_OPENING = Lock()


@contextmanager
def _mjpeg() -> Iterator[str]:
    """Play pictures over HTTP; the first caller starts the server that all share."""
    with ExitStack() as stack:
        with _OPENING:
            address = stack.enter_context(playing(frames=60, rate_hz=30.0))
        yield address


def _pictures_by_rtsp() -> AbstractContextManager[str]:
    return rtsp_camera([np.full((48, 64, 3), 5 * number, np.uint8) for number in range(30)], 30)


@contextmanager
def _joints() -> Iterator[str]:
    plan = {"messages": 200, "rate_hz": 200.0, "topics": {STATES: "states", TORQUES: "angles"}}
    with free_domain() as domain, publishing(domain, **plan):
        yield str(domain)


_DROPS = ("", "--preset paper", "--rate 240 --noise 0.001 --hold 0.3 --slope 0.1 --drag 0.1")
_FILMS = ("", "--size 160x120 --blur 4 --pixel-noise 5 --lost 0.1 --fov 50")
_ARMS = (
    "", "--driver", "--empty --driver --rate 10", "--mass 0.5 --com 0.01,0,0.02 --arm ur5e",
    "--preset paper", "--path random --torque-noise 0.1 --lag 5", "--arm panda --driver",
)  # fmt: skip
_LIVE = "--camera http://SOURCE"
RECORDINGS = [
    *(
        Recording(f"--simulate {kind} {words} --seed 7 --engine {engine}")
        for engine in ("pybullet", "mujoco")
        for kind, all_words in {
            "drop --seconds 2": _DROPS,
            "drop --render --seconds 0.5": _FILMS,
            "payload --seconds 1": _ARMS,
            "bounce-shot": ("", "--restitution 0.7 --height 0.335"),
        }.items()
        for words in all_words
    ),
    Recording("--simulate payload --save-path path.csv"),
    Recording("--camera clip.mp4 --ball tennis --drop-height 1"),
    Recording("--camera film.mkv --fps 60"),
    Recording("--camera -", live=True, stdin="film.mkv"),
    Recording("--camera - --transcode", live=True, stdin="film.mkv"),
    Recording(_LIVE, _mjpeg, live=True),
    Recording(f"{_LIVE} --stamps arrival --seconds 9 --ball golf", _mjpeg, live=True),
    Recording(f"{_LIVE} --microphone clicks.wav", _mjpeg, live=True, uncounted=("/audio",)),
    Recording("--camera rtsp://SOURCE --stall 2", _pictures_by_rtsp, live=True),
    Recording("--camera rtsp://SOURCE --stall 2 --transcode", _pictures_by_rtsp, live=True),
    Recording(
        f"--joint-states {STATES},{TORQUES} --loopback --domain SOURCE --timeout 3",
        _joints, live=True,
    ),
    Recording("--outcome success --ball tennis --miss 0.01 --at 2026-11-22T14:30:00Z"),
    Recording("--outcome failure --ball red --attempt 3 --reason rim --at 2026-11-22T14:30:00Z"),
]  # fmt: skip


def recorders(inputs: Path) -> Texts:
    """Record a log of each kind and tell what is in it."""
    folder = once(inputs / "recorders", make_clips)
    return together({one.words: partial(_recorded, folder, one) for one in RECORDINGS}, "recorders")


def _recorded(inputs: Path, recording: Recording) -> str:
    with tempfile.TemporaryDirectory() as name, recording.source() as source:
        folder = Path(name) / "here"
        shutil.copytree(inputs, folder)
        words = recording.words.replace("SOURCE", source).split()
        if "--outcome" not in words and "--save-path" not in words:
            words += ["-o", "a.mcap"]
        stdin = (inputs / recording.stdin).read_bytes() if recording.stdin else b""
        done = ran(["tunenet-record", *words], folder, stdin)
        new = sorted(path for path in folder.iterdir() if not (inputs / path.name).exists())
        told = [f"exit code {done.code}", _timeless(done.out + done.err, live=recording.live)]
        for path in new:
            is_log, told = path.suffix == ".mcap", [*told, path.name]
            told += _log(path, recording) if is_log else [whole_digest(path.read_bytes())]
    return "\n".join(told)


def _timeless(text: str, *, live: bool) -> str:
    """Return what was said of a live source, without numbers, gaps, and its clock's evenness."""
    if not live:
        return text
    text = re.sub(r", stamps: [^()]*(\([^()]*\))?|, (no|\d+) gaps?[^,;]*", "", text)
    return re.sub(r"\d+(\.\d+)*", "#", text)


def _log(path: Path, recording: Recording) -> Iterator[str]:
    """Tell what is in a log, line by line."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        header, summary = reader.get_header(), reader.get_summary()
        assert summary is not None
        yield f"{header.profile}, {header.library}"
        yield f"compressed: {sorted({one.compression for one in summary.chunk_indexes})}"
        hashes = {number: hashlib.sha256() for number in summary.channels}
        counts = dict.fromkeys(hashes, 0)
        for _, channel, message in reader.iter_messages(log_time_order=False):
            counts[channel.id] += 1
            stamps = message.log_time, message.publish_time, message.sequence
            told = b"" if recording.live else repr(stamps).encode()
            hashes[channel.id].update(told + message.data[_STAMP_BYTES * recording.live :])
        for number, channel in sorted(summary.channels.items(), key=lambda one: one[1].topic):
            schema = summary.schemas[channel.schema_id]
            yield f"{channel.topic}: {channel.message_encoding}, {dict(channel.metadata)}"
            yield f"  {schema.name}, {schema.encoding}, {whole_digest(schema.data)}"
            if channel.topic not in recording.uncounted:
                yield f"  {counts[number]} messages, {hashes[number].hexdigest()}"
        for one in reader.iter_metadata():
            yield from (f"{one.name}: {line}" for line in _notes(one.metadata, recording))
        for one in reader.iter_attachments():
            yield f"{one.name}, {one.media_type}, {whole_digest(one.data)}"


def _notes(metadata: Mapping[str, str], recording: Recording) -> Iterator[str]:
    for name, text in metadata.items():
        is_kept = not (recording.live and name == "notes.stamps")
        yield f"{name} = {_timeless(text, live=recording.live) if is_kept else '...'}"


PARTS: dict[str, Part] = {
    "episodes": episodes, "reviews": reviews, "exports": exports, "reports": reports,
    "help": all_help, "refusals": refusals, "recorders": recorders,
}  # fmt: skip


def write(folder: Path, parts: Mapping[str, Part]) -> None:
    """Make the inputs and keep what is said of them."""
    (folder / INPUTS).mkdir(parents=True, exist_ok=True)
    for name, part in parts.items():
        said = part(folder / INPUTS)
        text = json.dumps(said, indent=1, ensure_ascii=False, sort_keys=True)
        (folder / f"{name}.json").write_text(text + "\n", "utf-8", errors="backslashreplace")
        print(f"{len(said)} {name} in {folder / name}.json")


def compare(folder: Path, parts: Mapping[str, Part]) -> bool:
    """Ask again, and print what has moved; return whether nothing has."""
    moved = 0
    for name, part in parts.items():
        if not (file := folder / f"{name}.json").exists():
            print(f"{name}: was not written; left out")
            continue
        before: Texts = json.loads(file.read_text("utf-8"))
        after = part(folder / INPUTS)
        for key in sorted(before.keys() | after.keys()):
            if before.get(key) != after.get(key):
                moved += 1
                print(f"{name}: {key!a}: {_difference(before.get(key), after.get(key))}")
    print(f"{moved} moved" if moved else "no change")
    return not moved


def _difference(before: str | None, after: str | None) -> str:
    """Show lines that were and lines that are, the first ones, not too long."""
    if before is None or after is None:
        return "is new" if before is None else "is gone"
    both = difflib.unified_diff(before.splitlines(), after.splitlines(), n=0, lineterm="")
    lines = [line[:200] for line in list(both)[2:] if not line.startswith("@@")]
    rest = len(lines) - _MAX_LINES
    more = [f"... {rest} more lines"] if rest > 0 else []
    text = "\n    ".join(["", *lines[:_MAX_LINES], *more])
    return text.encode("utf-8", "backslashreplace").decode()


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--part", action="append", choices=PARTS, help="may be said again")

    def chosen(asked: argparse.Namespace) -> dict[str, Part]:
        os.environ.update(SETTINGS)
        return {name: PARTS[name] for name in asked.part or PARTS}

    return kept_or_compared(
        parser,
        lambda folder, asked: write(folder, chosen(asked)),
        lambda folder, asked: compare(folder, chosen(asked)),
    )


if __name__ == "__main__":
    sys.exit(main())
