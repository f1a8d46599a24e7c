"""Record reviews, exports and reports: a part of `tests.bench.promises`.

Commands run as a user runs them, in a copy of a bench: the samples, what the gallery's commands
need beside them, and tunings that were kept when the bench was made.
"""

from __future__ import annotations

import io
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from functools import cache, partial
from html import unescape
from pathlib import Path
from typing import Any

from docs.make_pictures import GALLERY, SECTION
from tests.bench.promises import ROOT, SETTINGS, SHARED, Part, Texts, apart, digest, once, together

_TEXTS = {".json", ".html", ".csv", ".xml", ".sdf", ".urdf", ".usda", ".py", ".yaml"}
# Columns of a ledger that tell when, or how long it took.
_CLOCK = re.compile("second|date|time_s|modified|tuned")

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


PARTS: dict[str, Part] = {"reviews": reviews, "exports": exports, "reports": reports}


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


def _shell(commands: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run lines of a shell with the commands of this tree, whatever tree is installed."""
    with tempfile.TemporaryDirectory() as place:
        told = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
        for name, entry in told.items():
            module, function = entry.split(":")
            code = f"import sys; from {module} import {function} as f; "
            code += f"sys.argv[0] = '{name}'; sys.exit(f())"
            script = Path(place) / name
            script.write_text(f'#!/bin/sh\nexec {sys.executable} -P -c "{code}" "$@"\n')
            script.chmod(0o755)
        path = f"{place}:{Path(sys.executable).parent}:{os.environ['PATH']}"
        return subprocess.run(
            ["/bin/sh", "-c", commands],
            check=False,
            capture_output=True,
            text=True,
            cwd=folder,
            env={**os.environ, **SETTINGS, "PATH": path, "PYTHONPATH": str(ROOT)},
        )


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
        kept = sorted(name for name in map(str, table) if not _CLOCK.search(name))
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
    nowhere = io.StringIO()
    with (
        tempfile.TemporaryDirectory() as place,
        redirect_stdout(nowhere),
        redirect_stderr(nowhere),
    ):
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
