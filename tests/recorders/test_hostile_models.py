"""Models that strangers made to hurt: each is refused in one line, in bounded time and memory."""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.recorders.test_model_file import TETRAHEDRON, urdf
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.model.reading import read_model


def world(body: str) -> str:
    return f"<mujoco><worldbody>{body}</worldbody></mujoco>"


def asset(element: str) -> str:
    return f"<mujoco><asset>{element}</asset></mujoco>"


def mesh(name: str) -> str:
    return (
        f'<mujoco><asset><mesh name="a" file="{name}"/></asset>'
        '<worldbody><geom type="mesh" mesh="a"/></worldbody></mujoco>'
    )


def included(name: str) -> str:
    return f'<mujoco><include file="{name}"/></mujoco>'


BALL = '<geom size="0.1"/>'
COPIED = '<replicate count="1000" offset="1 0 0">'
HINGES = "".join(f'<body><joint axis="{a}"/>{BALL}</body>' for a in ["1 0 0", "0 1 0"] * 101)
MOTOR = '<motor joint="j"/>'
HELD = f'<body><joint name="j"/>{BALL}</body>'

# By what they are: the text, and the words of the refusal.
TEXTS = {
    "a word": ("hello", "is not XML"),
    "nothing": ("", "is not XML"),
    "another root": ("<sdf/>", "begins with <sdf>; --model takes"),
    "entities": (
        '<!DOCTYPE m [<!ENTITY a "b"><!ENTITY c "&a;&a;">]><mujoco model="&c;"/>',
        "document type",
    ),
    "outside by an entity": (
        '<!DOCTYPE m [<!ENTITY a SYSTEM "file:///etc/passwd">]><mujoco model="&a;"/>',
        "document type",
    ),
    "xacro": ('<robot name="${n}"/>', "expand it first"),
    "deep": (world("<body>" * 300 + "</body>" * 300), "over 200 deep"),
    "tags": (world(BALL * 100_001), "over 100000 tags"),
    "large": (world("x" * 4_000_001), "is larger than 4 MB"),
    "copies": (
        world(f'<replicate count="1000000000" offset="1 0 0">{BALL}</replicate>'),
        "over 100000 elements, copies of <replicate>",
    ),
    "copies of copies": (world(COPIED * 4 + BALL + "</replicate>" * 4), "over 100000 elements"),
    "grid": (
        world('<flexcomp name="a" type="grid" count="1000 1000 1000" dim="3"/>'),
        "copies of <flexcomp>",
    ),
    "plugin": (
        '<mujoco><extension><plugin plugin="mujoco.pid"/></extension></mujoco>',
        "plugins run code of others",
    ),
    "plugin of a body": (world('<body><plugin instance="a"/></body>'), "plugins run code"),
    "not a number": (world('<geom size="nan"/>'), '<geom size="nan"> is not finite'),
    "infinite": (world('<body pos="0 -Inf 0"/>'), "is not finite"),
    "too large a number": (world('<body pos="0 1e999 0"/>'), "is not finite"),
    "infinite when compiled": (
        world('<body><geom size="1e200" mass="1e300"/></body>'),
        "not finite",
    ),
    "working memory": ('<mujoco><size memory="1T"/></mujoco>', "over 400 MB"),
    "some working memory": ('<mujoco><size memory="350M"/></mujoco>', "367 MB of working"),
    "keyframes": ('<mujoco><size nkey="2000000000"/></mujoco>', "over the limit of 100000"),
    "user values": ('<mujoco><size nuser_body="2000000000"/></mujoco>', "over the limit"),
    "height field": (
        asset('<hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/>'),
        "over 400 MB",
    ),
    "texture": (
        asset('<texture name="t" builtin="flat" width="1000000" height="1000000"/>'),
        "over 400 MB",
    ),
    "sensor": ('<mujoco><sensor><user dim="2000000000"/></sensor></mujoco>', "over 400 MB"),
    "actuator": (
        f"<mujoco><worldbody>{HELD}</worldbody><actuator>"
        '<general joint="j" dyntype="user" actdim="2000000000"/></actuator></mujoco>',
        "over 400 MB",
    ),
    "joints": (world(HINGES), "202 degrees of freedom, over the limit of 200"),
    "bodies": (world(f"<body>{BALL}</body>" * 2001), "2002 bodies, over the limit of 2000"),
    "geoms": (world(BALL * 10_001), "10001 geoms, over the limit of 10000"),
    "actuators": (
        f"<mujoco><worldbody>{HELD}</worldbody><actuator>{MOTOR * 2001}</actuator></mujoco>",
        "2001 actuators, over the limit of 2000",
    ),
    "heights from nothing": (
        asset('<hfield name="h" nrow="4000" ncol="4000" size="1 1 1 1"/>'),
        "64 MB when compiled, over the limit of 30",
    ),
    "step": ('<mujoco><option timestep="0"/></mujoco>', "timestep of 0 s; give one of 1e-05"),
    "long step": ('<mujoco><option timestep="1"/></mujoco>', "timestep of 1 s"),
    "massless": (world("<body><joint/></body>"), "give that body or link a mass"),
    "unknown element": (world("<goem/>"), "unrecognized element; Element 'goem'; correct"),
    "a long name": (world(f'<body name="{"x" * 3000}"><joint/></body>'), "…"),
    "controls": (world('<body name="&#13;&#10;a"><joint/></body>'), "give that body or link"),
    "no file": (mesh("gone.stl"), 'names "gone.stl", which is not there'),
    "no file in a name": (mesh("x" * 5000 + ".stl"), "is not there"),
    "no name": (mesh(""), "cannot be a mesh"),
    "above": (mesh("../secret.stl"), 'names "../secret.stl", which is outside the model'),
    "absolute": (included("/etc/passwd"), "which is outside"),
    "shouted": ('<mujoco><INCLUDE file="/etc/passwd"/></mujoco>', "which is outside"),
    "a link out": (mesh("link.stl"), "which is outside"),
    "a folder out": (
        '<mujoco><compiler meshdir="/"/><asset><mesh file="etc/passwd"/></asset></mujoco>',
        "which is outside",
    ),
    "by a package": (urdf("package://a/../../secret.stl"), "which is outside"),
    "by a URL": (urdf("file:///etc/passwd"), "which is outside"),
    "by the web": (urdf("https://127.0.0.1/a.stl"), "is not there"),
    "in another element": (
        world('<geom size="1" file="/etc/passwd"/>'),
        "names a file, which MuJoCo reads in no such element",
    ),
    "a pipe": (mesh("pipe.stl"), "is no regular file"),
    "a folder": (mesh("folder.stl"), "cannot be read"),
    "large mesh": (mesh("hole.stl"), "is larger than 64 MB"),
    "large meshes": (
        asset("".join(f'<mesh name="{n}" file="hole{n}.stl"/>' for n in range(5))),
        "over 256 MB",
    ),
    "itself": (included("m.xml"), "twice, or in itself"),
    "in a circle": (included("circle_a.xml"), "twice, or in itself"),
    "in a row": (included("row0.xml"), "over 16 deep"),
    "no model": (included("secret.xml"), "begins with <secret>"),
    "attached itself": (asset('<model file="m.xml"/>'), "attaches itself"),
    "attached plugin": (asset('<model file="plugin.xml"/>'), "plugins run code"),
    "attached file": (asset('<model file="reader.xml"/>'), "which is outside"),
    "other mesh": (urdf("shape.dae"), "cannot be a mesh; MuJoCo reads .stl, .obj, .msh; convert"),
    "forged .stl": (mesh("forged.stl"), "number of faces"),
    "short .stl": (mesh("short.stl"), "wrong size"),
    "empty .stl": (mesh("empty.stl"), "is empty"),
    "forged .msh": (mesh("forged.msh"), "too large sizes"),
    "negative .msh": (mesh("negative.msh"), "invalid sizes"),
    "wild .msh": (mesh("wild.msh"), "does not exist"),
    "wild .obj": (mesh("wild.obj"), "does not take it"),
    "infinite .obj": (mesh("nan.obj"), "not finite"),
    "forged heights": (asset('<hfield file="h.bin" size="1 1 1 1"/>'), "does not take it"),
    "forged picture": (asset('<hfield file="h.png" size="1 1 1 1"/>'), "does not take it"),
    "forged skin": (asset('<skin file="s.skn"/>'), "too large sizes"),
}


def write_strange_files(folder: Path) -> Path:
    """A model's folder, with files that hurt beside and in it."""
    own = folder / "model"
    (own / "folder.stl").mkdir(parents=True)
    (folder / "secret.stl").write_bytes(b"secret")
    (own / "link.stl").symlink_to(folder / "secret.stl")
    os.mkfifo(own / "pipe.stl")
    for name, size in [("hole.stl", 64_000_001), *[(f"hole{n}.stl", 60_000_000) for n in range(5)]]:
        with open(own / name, "wb") as file:
            file.truncate(size)
    texts = {f"row{n}.xml": included(f"row{n + 1}.xml") for n in range(20)} | {
        "circle_a.xml": included("circle_b.xml"),
        "circle_b.xml": included("circle_a.xml"),
        "secret.xml": "<secret/>",
        "plugin.xml": TEXTS["plugin"][0],
        "reader.xml": mesh("../secret.stl"),
        "shape.dae": "<COLLADA/>",
        "wild.obj": "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 2000000000\n",
        "nan.obj": TETRAHEDRON.decode().replace("1", "nan", 1),
    }
    for name, text in texts.items():
        (own / name).write_text(text)
    counts: dict[str, tuple[int, ...]] = {
        "forged.msh": (2**30,) * 4,
        "negative.msh": (-1, 5, 5, 5),
        "wild.msh": (4, 0, 0, 2, *range(1, 13), 0, 1, 2**30, -7, 1, 2),
        "h.bin": (10**9, 10**9),
        "s.skn": (2**30,) * 4,
    }
    for name, numbers in counts.items():
        (own / name).write_bytes(struct.pack(f"<{len(numbers)}i", *numbers))
    (own / "empty.stl").touch()
    (own / "forged.stl").write_bytes(bytes(80) + struct.pack("<I", 2**31) + bytes(50))
    (own / "short.stl").write_bytes(bytes(80) + struct.pack("<I", 200_000) + bytes(50))
    (own / "h.png").write_bytes(b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + b"\x7f\xff" * 8)
    return own


_READ_ALL = """
import json, resource, sys
from pathlib import Path
from tunenet_logs.recorders.simulators.model.reading import read_model
from tunenet_logs.errors import UsageError

def cpu_s():
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime

said = {}
folder, cases = Path(sys.argv[1]), json.load(sys.stdin)
for case, text in cases.items():
    path = folder / ("m.urdf" if text.lstrip().startswith(("<robot", "<?xml")) else "m.xml")
    path.write_text(text)
    before = cpu_s()
    try:
        read_model(path)
    except UsageError as error:
        said[case] = [str(error), error.remedy, cpu_s() - before]
    path.unlink()
json.dump([said, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss], sys.stdout)
"""


def test_a_hostile_model_is_refused_in_one_line_with_a_bound_of_time_and_memory(tmp_path: Path):
    """In a fresh process: until it runs, a child counts what its parent has."""
    folder = write_strange_files(tmp_path)
    words = [sys.executable, "-c", _READ_ALL, folder]
    cases = json.dumps({case: text for case, (text, _) in TEXTS.items()})
    done = subprocess.run(words, input=cases, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    refused, peak_kib = json.loads(done.stdout)
    assert refused.keys() == TEXTS.keys()
    for case, (said, remedy, cpu_s) in refused.items():
        assert TEXTS[case][1] in said, case
        assert said.startswith(f"{folder}/"), case
        assert said.isprintable(), case
        assert len(said.replace(str(folder), "")) < 600, case
        assert remedy or ";" in said, case
        assert cpu_s < 12, case
    assert peak_kib < 0.6 * 1024**2


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda path: None, "cannot be read (No such file"),
        (lambda path: path.mkdir(), "cannot be read (Is a directory"),
        (os.mkfifo, "is no regular file"),
        (lambda path: path.symlink_to(path), "cannot be read"),
        (lambda path: path.symlink_to("/dev/zero"), "is no regular file"),
        (lambda path: path.write_bytes(b"\xff\xfe<\0"), "no text in UTF-8"),
    ],
)
def test_what_is_no_file_is_no_model(tmp_path: Path, make: Callable[[Path], object], words: str):
    make(tmp_path / "m.xml")
    with pytest.raises(UsageError) as caught:
        read_model(tmp_path / "m.xml")
    assert words in str(caught.value)


def test_a_home_is_no_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A mesh of package://NAME may be in a folder of that name above, but not in all of a home."""
    (tmp_path / "somebody/models").mkdir(parents=True)
    (tmp_path / "somebody/key.obj").write_bytes(TETRAHEDRON)
    path = tmp_path / "somebody/models/m.urdf"
    path.write_text(urdf("package://somebody/key.obj"))
    assert read_model(path).compile().nmesh == 1
    monkeypatch.setenv("HOME", str(tmp_path / "somebody"))
    with pytest.raises(UsageError, match="is not there"):
        read_model(path)


@pytest.mark.slow
def test_what_never_ends_is_ended(tmp_path: Path):
    """Copies of a model that is attached: only its compiling tells how many there are."""
    (tmp_path / "part.xml").write_text(world(f'<body name="b">{BALL * 300}</body>'))
    (tmp_path / "m.xml").write_text(
        '<mujoco><asset><model name="c" file="part.xml"/></asset><worldbody>'
        '<replicate count="9000" offset="1 0 0"><attach model="c" body="b" prefix="x"/>'
        "</replicate></worldbody></mujoco>"
    )
    with pytest.raises(UsageError, match=r"takes MuJoCo over (10 s|400 MB)"):
        read_model(tmp_path / "m.xml")
