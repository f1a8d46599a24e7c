"""Compare the answers of `tunenet-tune` to a fixed set of logs between versions.

    python -m benchmarks.answers --write DIR     tune the set, keep its logs and answers in DIR
    python -m benchmarks.answers --compare DIR   tune the same logs again: what has changed?

The set: the samples, the recordings of others where they are there, 60 made logs of positions,
20 rendered films, 20 payloads with a tare, the sample campaign (`benchmarks.fixed_logs`). Only the
commands and their JSON are used, so that nothing here depends on how the inside is cut.

A value has moved if it differs by more than a tenth of the half width of its interval before (where
it had none, of the median half width of its group). `--compare` ends with 1 if anything changed.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tqdm import tqdm

from benchmarks.answers_table import Answer, compared
from benchmarks.fixed_logs import SAMPLES, FixedLog, given_logs, make_logs

BIN = Path(sys.executable).parent
LOGS, ANSWERS = "logs", "answers.json"
_MAX_S = 900


@dataclass(frozen=True)
class Answers:
    """Answers of one version of the code.

    Attributes:
        logs: by name.
        campaign: what `tunenet-review` printed of the sample campaign, without paths.
    """

    logs: Mapping[str, Answer]
    campaign: str


def tuned(log: FixedLog) -> Answer:
    """Tune one log in a process of its own."""
    tare = [] if log.tare is None else ["--tare", log.tare]
    with tempfile.TemporaryDirectory() as folder:
        words = [BIN / "tunenet-tune", log.path, *tare, "-o", folder, "--jobs", "1", "--quiet"]
        done = _run(words)
        reports = list(Path(folder).glob("*.json"))
        told: dict[str, Any] = json.loads(reports[0].read_text()) if reports else {}
    reason = told.get("reason") or ("" if told else done.stderr.strip().splitlines()[-1])
    parameters = told.get("parameters") or {}
    return Answer(
        group=log.group,
        sha256=_digest(log.path),
        truth=log.truth,
        verdict=told.get("verdict", f"exit code {done.returncode}"),
        reason=reason.replace(str(log.path), log.name),
        values={name: one["value"] for name, one in parameters.items()},
        intervals={name: one["interval95"] for name, one in parameters.items()},
        failed=sorted(one["name"] for one in told.get("checks", ()) if not one["passed"]),
    )


def _run(words: Sequence[object]) -> subprocess.CompletedProcess[str]:
    command = [str(word) for word in words]
    return subprocess.run(command, check=False, capture_output=True, text=True, timeout=_MAX_S)


def _digest(path: Path) -> str:
    """Return the SHA-256 of a file, or of all files of a folder."""
    files = sorted(path.rglob("*")) if path.is_dir() else [path]
    return hashlib.sha256(b"".join(one.read_bytes() for one in files if one.is_file())).hexdigest()


def campaign_words() -> str:
    """Return what `tunenet-review` prints of the sample campaign."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "campaign"
        shutil.copytree(SAMPLES / "campaign", folder)
        words = [BIN / "tunenet-review", folder, "-o", folder / "all.rrd", "--quiet"]
        done = _run(words)
        return (done.stdout + done.stderr).replace(str(folder), "campaign")


def answers_to(logs: Iterable[FixedLog], jobs: int) -> Answers:
    """Tune every log, `jobs` at a time."""
    logs = list(logs)
    with ThreadPoolExecutor(jobs) as pool:
        campaign = pool.submit(campaign_words)
        found = list(tqdm(pool.map(tuned, logs), "tuning", len(logs), unit="log", disable=None))
        names = [log.name for log in logs]
        return Answers(dict(zip(names, found, strict=True)), campaign.result())


def write(folder: Path, jobs: int) -> None:
    """Make the logs, tune the whole set and keep both."""
    made = make_logs(folder / LOGS)
    answers = answers_to([*given_logs(), *made], jobs)
    tares = {log.name: log.tare.name for log in made if log.tare is not None}
    text = json.dumps({**asdict(answers), "tares": tares}, indent=1, ensure_ascii=False)
    (folder / ANSWERS).write_text(text + "\n")
    print(f"{len(answers.logs)} answers in {folder / ANSWERS}")


def compare(folder: Path, jobs: int) -> bool:
    """Tune the kept logs again and print the changes; return whether there are none."""
    told = json.loads((folder / ANSWERS).read_text())
    before = {name: Answer(**one) for name, one in told["logs"].items()}
    given = {log.name: log for log in given_logs()}
    logs = []
    for name, answer in before.items():
        path, tare = folder / LOGS / name, told["tares"].get(name)
        if path.exists():
            tare = None if tare is None else folder / LOGS / tare
            logs.append(FixedLog(name, answer.group, path, answer.truth, tare))
        elif name in given and _digest(given[name].path) == answer.sha256:
            logs.append(given[name])
        else:
            print(f"{name}: not there any more, or another file; left out")
    after = answers_to(logs, jobs)
    text, same = compared({name: before[name] for name in after.logs}, after.logs)
    print(text)
    if told["campaign"] != after.campaign:
        print(f"\ncampaign, before:\n{told['campaign']}\ncampaign, after:\n{after.campaign}")
    return same and told["campaign"] == after.campaign


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--write", type=Path, metavar="DIR", help="a new folder, outside the tree")
    what.add_argument("--compare", type=Path, metavar="DIR", help="one that --write made")
    parser.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)))
    arguments = parser.parse_args()
    if arguments.write is None:
        return 0 if compare(arguments.compare, arguments.jobs) else 1
    if arguments.write.exists():
        parser.error(f"{arguments.write} is there already; choose a new folder")
    write(arguments.write, arguments.jobs)
    return 0


if __name__ == "__main__":
    sys.exit(main())
