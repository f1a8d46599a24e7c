"""Record what the commands say: parts of `tests.bench.promises`.

`help` asks every command and subcommand for its help, version and completions; `refusals` runs the
lines of `refusals.txt`; `recorders` is `tests.bench.promises_recorders`.
"""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

from tests.bench.promised_runs import JOBS, ROOT, SCRIPTS, digest, make_clips, ran
from tests.bench.promises_recorders import recorders

SAMPLES = ROOT / "sample_logs"
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


def all_help(folder: Path) -> dict[str, str]:
    """Return every help as it is, versions, and the digests of the shells' completions."""
    commands = [[name] for name in SCRIPTS]
    below = [[name, one] for name, ones in SUBCOMMANDS.items() for one in ones]
    shells = [["--print-completion", one] for one in ("bash", "zsh", "tcsh")]
    asked = [[*words, "--help"] for words in (*commands, *below)]
    asked += [[name, "--help", *topic] for name, topic in ALL.items()]
    asked += [[*words, *more] for words in commands for more in (["--version"], *shells)]

    def told(words: Sequence[str]) -> str:
        done = ran(words, folder)
        out = digest(done.out.encode()) if "--print-completion" in words else done.out
        return f"exit code {done.code}\n{out}{done.err}"

    with ThreadPoolExecutor(JOBS) as pool:
        return dict(zip(map(" ".join, asked), pool.map(told, asked), strict=True))


def refusals(folder: Path) -> dict[str, str]:
    """Return what each line of `refusals.txt` answers and leaves, in a copy of the inputs."""
    folder = folder / "commands"
    if not folder.exists():
        _make_inputs(folder)
    lines = [one for one in LINES.read_text().splitlines() if one and not one.startswith("#")]
    asked = list(dict.fromkeys(tuple(words) for line in lines for words in _swept(line)))
    with ThreadPoolExecutor(JOBS) as pool:
        answers = list(pool.map(partial(_answer, folder), asked))
    return dict(zip(map(" ".join, asked), answers, strict=True))


def _swept(line: str) -> Iterator[list[str]]:
    """Yield a line, and after a sign the same with each option of its command, right or wrong."""
    sign, line = (line[0], line[2:]) if line[0] in "+?" else ("", line)
    words = line.split()
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
    return {str(one.relative_to(folder)): digest(one.read_bytes()) for one in paths}


def _make_inputs(folder: Path) -> None:
    """Write logs, tunings and files that are nothing, for the lines of `refusals.txt`."""
    (folder / "empty").mkdir(parents=True)
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


PARTS: dict[str, Callable[[Path], dict[str, str]]] = {
    "help": all_help,
    "refusals": refusals,
    "recorders": recorders,
}
