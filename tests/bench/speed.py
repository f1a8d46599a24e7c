"""Measure speed and memory beside bare library work: sections of `python -m tests.bench`.

Each yields figures as they come, by what they are of. Both sides of a ratio are measured in one
run, in turns where they are long, so that they see the machine in the same state. What takes much
memory is imported by the sections that need it: one of them measures that of this process.
"""

from __future__ import annotations

import json
import logging
import math
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from mcap.reader import make_reader

from tests import strangers
from tests.bench import BIN, REAL, SAMPLES, Figures, best_s, spent
from tunenet_logs.analysis.batch.ledger import ledger_file
from tunenet_logs.analysis.batch.logs import find_logs
from tunenet_logs.analysis.drop.bounce_posterior import drop_posterior
from tunenet_logs.analysis.drop.motion import rig_like
from tunenet_logs.analysis.drop.presets import TRAININGS
from tunenet_logs.analysis.evaluation.worlds.ball import RealBall, drop_ball
from tunenet_logs.analysis.evaluation.worlds.clips import (
    clip_frames,
    draw_clip,
    draw_stage,
    write_clip,
)
from tunenet_logs.analysis.experiment import Tuning, record_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.parallel import streamed
from tunenet_logs.analysis.record import to_json
from tunenet_logs.analysis.result_files import log_sha256
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.episode import Array
from tunenet_logs.outcomes import Outcome, write_outcome
from tunenet_logs.recorders.orders import FilmOrder
from tunenet_logs.recorders.simulators.arm.description import Payload, jaco
from tunenet_logs.recorders.simulators.arm.path import (
    CIRCLE_CSV,
    CIRCLE_RAD_S,
    circle_at,
    link_poses,
    write_path_file,
)
from tunenet_logs.recorders.simulators.arm.path import circle as circle_path
from tunenet_logs.recorders.simulators.arm.payload import (
    CALIBRATED,
    PAPER,
    joint_efforts_nm,
    roll_out,
)
from tunenet_logs.recorders.simulators.ball import DropSimulator
from tunenet_logs.recorders.simulators.pybullet import pybullet
from tunenet_logs.terminal import Progress

if TYPE_CHECKING:
    from tunenet_logs.analysis.batch.run import Result, Work

Results = Iterator[tuple[int, "Result"]]
TUNE = [sys.executable, "-m", "tunenet_logs.analysis.cli.tune"]
QUIET = Progress(quiet=True)


def started(*words: object, **how: Any) -> subprocess.CompletedProcess[str]:
    """Run a command to its good end."""
    return subprocess.run([*map(str, words)], check=True, capture_output=True, text=True, **how)


def cores() -> int:
    return len(os.sched_getaffinity(0))


# ---- Start-up.


def start_up(best_of: int) -> Figures:
    """Start commands beside a bare interpreter, and tune beside loading the libraries."""

    def best(*words: object) -> float:
        return best_s([lambda: started(*words)], best_of)[0]

    bare_s = best(sys.executable, "-c", "pass")
    yield "bare interpreter [s]", bare_s
    for name in ("logs", "record", "tune", "review", "train", "eval"):
        took_s = best(BIN / f"tunenet-{name}", "--help")
        yield f"tunenet-{name} --help, times the interpreter", took_s / bare_s
    with tempfile.TemporaryDirectory() as folder:
        libraries = "import numpy, mcap, rosbags.typesys, pybullet, rerun"
        loading_s = best(sys.executable, "-c", libraries)
        tuning_s = best(BIN / "tunenet-tune", SAMPLES / "bouncy.mcap", "-o", folder)
        yield "loading the libraries of a tuning [s]", loading_s
        yield "tunenet-tune of a sample, times that", tuning_s / loading_s
        words = "drop", "--preset", "paper-code", "-o", f"{folder}/weights.safetensors"
        yield (
            "tunenet-train, all of it [s]",
            spent(lambda: started(BIN / "tunenet-train", *words))[0],
        )


# ---- Films.

# A film: the number of a drawn clip, size [px], pictures a second, seconds before the release and
# in all.
_FILMS: dict[str, tuple[int, tuple[int, int], int, float, float]] = {
    "1080p, 7 s": (10, (1920, 1080), 30, 2.5, 7.2),
    "640 x 480, 10 s": (19, (640, 480), 60, 3.0, 10.0),
    "1080p, 7 s, another": (2, (1920, 1080), 30, 2.5, 7.2),
    "640 x 480, 10 s, another": (23, (640, 480), 60, 3.0, 10.0),
    "1080p, the fall alone": (10, (1920, 1080), 30, 2.5, 2.8),
}
_GIVEN = {
    "slow motion of another": "videos/red_ball_drop_120fps.mp4",
    "a ball in a hand": "negatives/green_ball_in_hand.mp4",
    "a ball tossed": "negatives/green_ball_tossed.mp4",
}


def films(drawn: int) -> Figures:
    """Tune drawn and given films from the file to JSON and review, after a first one."""
    from tunenet_logs.analysis.batch.run import Work, Writing, tuned_and_written

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        tuned_and_written(Work(SAMPLES / "filmed.mcap", folder / "first"), TuneOptions(), Writing())
        paths = {what: REAL / path for what, path in _GIVEN.items() if (REAL / path).exists()}
        for at, (what, order) in enumerate([*_FILMS.items()][:drawn]):
            paths[what] = folder / f"{at}.mp4"
            _draw_film(paths[what], *order)
        for what, path in paths.items():
            bare_s = min(spent(partial(_decode, path))[1] for _ in range(2))
            work = Work(path, folder / path.stem)
            wall_s, cpu_s, done = spent(partial(tuned_and_written, work, TuneOptions(), Writing()))
            yield f"{what}: times decoding to luma", cpu_s / bare_s
            yield f"{what}: times its duration", wall_s / _decode(path, only_length=True)
            yield f"{what}: verdict", done.row.record.verdict


def _draw_film(
    path: Path, number: int, size_px: tuple[int, int], rate_hz: int, held_s: float, whole_s: float
) -> None:
    """Render a clip in another size and length; store it as phones do (H.264, CABAC)."""
    from tests.bench.lab import write_video

    order = draw_clip(77, number)
    focal_px = order.view.focal_px * size_px[1] / order.view.size_px[1]
    view = replace(order.view, size_px=size_px, focal_px=focal_px)
    stage = draw_stage(view, order.ball.drop_m, np.random.default_rng(77))
    times = {"rate_hz": rate_hz, "held_s": held_s, "length_s": whole_s - held_s}
    pictures = clip_frames(replace(order, view=view, stage=stage, **times))
    write_video(path, pictures, "libx264", rate_hz, options={"crf": "20"})


def _decode(path: Path, *, only_length: bool = False) -> float:
    """Decode every picture to luma in one thread; return the film's duration [s]."""
    import av

    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        stream.thread_type = "NONE"
        for one in () if only_length else container.decode(stream):
            one.to_ndarray(format="gray")
        return (container.duration or 0) / av.time_base


def memory(seconds: float, longer: int) -> Figures:
    """Tune a drawn clip of 640 x 480 at 60 Hz, and one that is longer, by the command."""
    from tests.hostile import spent

    order, peaks = draw_clip(1000, 34), []
    assert (order.view.size_px, order.rate_hz) == ((640, 480), 60.0)
    for times in (1, longer):
        held = replace(order, as_log=False, held_s=times * seconds - order.length_s)
        with tempfile.TemporaryDirectory() as folder:
            path = write_clip(held, Path(folder))
            peaks.append(spent([*TUNE, str(path), "--no-review"], Path(folder)).peak_kib / 1024)
    yield f"a clip of {seconds:g} s [MiB]", peaks[0]
    yield f"one {longer} times as long, times that", peaks[1] / peaks[0]


# ---- Small logs of positions, alone and in batches.


# How late a sample is stamped [ms], as recorders do: on arrival in a busy process, on arrival over
# Wi-Fi, by a timer that is uneven, or with what waited for a network that sends in parcels.
_LATE_MS: tuple[Callable[[np.random.Generator, Array], Array], ...] = (
    lambda rng, taken_ms: rng.exponential(0.8, len(taken_ms)),
    lambda rng, taken_ms: rng.uniform(0, 12, len(taken_ms)),
    lambda rng, taken_ms: np.abs(rng.normal(0, 0.4, len(taken_ms))),
    lambda rng, taken_ms: -taken_ms % 25 + rng.exponential(0.1, len(taken_ms)),
    lambda rng, taken_ms: rng.exponential(5, len(taken_ms)),
)


def write_log(path: Path, index: int, *, late: bool = False) -> None:
    """Write a drop of 1 to 3 s at 60 to 240 Hz, 1 mm of noise: ideal, or with air and slope.

    `late` stamps every other one as samples arrive, in JSON each fifth.
    """
    rng = np.random.default_rng([24, index])
    restitution, gap_m = float(rng.uniform(0.3, 0.92)), float(rng.uniform(0.3, 1.6))
    rate_hz, lasts_s, hold_s = (
        float(rng.uniform(*ends)) for ends in ((60.0, 240.0), (1.3, 3.0), (0.1, 0.3))
    )
    seconds = np.arange(int(lasts_s * rate_hz)) / rate_hz - hold_s
    if index % 2:
        slope, drag_1_m = float(rng.uniform(0.0, 0.12)), float(np.exp(rng.uniform(-5.8, -1.7)))
        heights_m = drop_ball(RealBall(restitution, slope, drag_1_m, gap_m), seconds).heights_m
    else:
        heights_m = strangers.bounce_heights(restitution, gap_m, seconds)
    positions_m = np.column_stack([np.zeros((len(seconds), 2)), heights_m])
    positions_m += rng.normal(0.0, 0.001, positions_m.shape)
    taken_ms = (seconds + hold_s) * 1e3
    if late and index // 2 % 2:
        taken_ms = taken_ms + _LATE_MS[index // 4 % len(_LATE_MS)](rng, taken_ms)
        taken_ms = np.maximum.accumulate(taken_ms) + 1e-3 * np.arange(len(seconds))
    stamps_ns = 1_700_000_000_000_000_000 + np.round(taken_ms * 1e6).astype(np.int64)
    write = strangers.write_json if late and index % 5 == 1 else strangers.write_poses
    write(path, stamps_ns, positions_m)


def state_logs(count: int, late: int) -> Figures:
    """Tune logs from reading to JSON, without the review, in one process after its start.

    After tidy ones so many `late`: those of others, half of them stamped on arrival.
    """
    count = max(count, 4)
    with tempfile.TemporaryDirectory() as folder:
        logs = [Path(folder) / f"{index:05}.mcap" for index in range(count + late)]
        for index, log in enumerate(logs):
            write_log(log, index - count * (index >= count), late=index >= count)
        for log in (*logs[:6], *logs[count:][:6]):
            _tuned(log)
        for what, chosen in (("tidy", logs[:count]), ("of others", logs[count:])):
            spent_s = floor_s = read_s = 0.0
            for done, log in enumerate(chosen, start=1):
                _, cpu_s, tuning = spent(partial(_tuned, log))
                spent_s += cpu_s
                read_s += spent(partial(_read, log))[1]
                floor_s += spent(_least_work(log, tuning))[1]
                if what == "tidy" and done in (count // 4, count // 2, count):
                    yield f"resident memory after {done} logs [MB]", _resident_mb(os.getpid())
            if chosen:
                yield f"{what}: logs a CPU second", len(chosen) / spent_s
                yield f"{what}: times bare reading", spent_s / read_s
                ratio = spent_s / floor_s
                yield f"{what}: times bare reading, K + 2 rollouts and the fit alone", ratio


def _tuned(path: Path) -> Tuning:
    """Tune a log as `tunenet-tune` does, and make its JSON."""
    log_sha256(path)
    tuning = tune_log(path, TuneOptions())
    to_json(record_of(tuning))
    return tuning


def _read(path: Path) -> None:
    """Read a log by the mcap library alone."""
    with path.open("rb") as file:
        for _ in make_reader(file).iter_messages():
            pass


def _least_work(path: Path, tuning: Tuning) -> Callable[[], None]:
    """Return what none can do without: bare reading, K + 2 rollouts and the fit alone."""
    detection, trace = tuning.detection, tuning.trace
    if detection is None or trace is None:
        return partial(_read, path)
    simulator = DropSimulator(*rig_like(detection))
    names = [parameter.name for parameter in tuning.parameters]
    settings = [dict(zip(names, map(float, step.values), strict=True)) for step in trace.steps]

    def work() -> None:
        _read(path)
        for values in settings:
            simulator.rollout(values)
        drop_posterior.__wrapped__(detection.found, detection.ball.drag_1_m)

    return work


def _resident_mb(process: int) -> float:
    try:
        return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * 4096 / 1e6
    except OSError:
        return 0.0


_STARTING = 64  # results before which processes are still starting


def batches(count: int, kills: int) -> Figures:
    """Tune logs to JSON and ledger by one process, two, two of Ray; or be killed and resume."""
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made) / "logs"
        folder.mkdir()
        for index in range(count):
            path = folder / f"{index:06}.mcap"
            if index < 100:
                write_log(path, index)
            else:
                shutil.copyfile(folder / f"{index % 100:06}.mcap", path)
        for index in range(19, count, 20):  # cut in its middle, or no log at all
            path = folder / f"{index:06}.mcap"
            path.write_bytes(b"no log" * 100 if index % 40 > 20 else path.read_bytes()[:300])
        yield from (_killed if kills else _rates)(folder, Path(made), kills)


def _rates(folder: Path, out: Path, _kills: int) -> Figures:
    from tunenet_logs.analysis.batch.run import Order, Writing, run_batch

    logs = find_logs([folder]).logs
    ways: dict[str, Callable[..., Results]] = {
        "one process": partial(streamed, jobs=1),
        "two processes": partial(streamed, jobs=2),
    }
    if find_spec("ray"):
        from tunenet_logs.analysis.parallel import HERE, Cluster, on_cluster

        ways["two workers of Ray"] = partial(on_cluster, Cluster(HERE, 2))
    rates: dict[str, float] = {}
    for name, way in ways.items():
        moments_s: list[float] = []
        largest_mb: list[float] = []
        place = out / name.replace(" ", "_")
        writing = Writing(reviewed=frozenset())
        order = Order(logs, writing=writing, folder=place, keeps_ledger=True)
        batch = run_batch(order, QUIET, partial(_noting, way, moments_s, largest_mb))
        counted = moments_s[_STARTING:]
        rates[name] = (len(counted) - 1) / (counted[-1] - counted[0])
        yield f"{name}: logs a second", rates[name]
        yield f"{name}: largest worker [MB]", max(largest_mb, default=0.0)
        yield f"{name}: verdicts", str(dict(batch.verdicts))
    one, two, *ray = rates.values()
    yield "two processes against one", two / one
    if ray:
        yield "Ray against processes", ray[0] / two


def _noting(
    way: Callable[..., Results],
    moments_s: list[float],
    largest_mb: list[float],
    work: Callable[[Work], Result],
    items: Sequence[Work],
    lost: Callable[[Work], Result],
) -> Results:
    """Stream results, and note when they come and what the workers hold at the end."""
    for one in way(work=work, items=items, lost=lost):
        moments_s.append(time.monotonic())
        if len(moments_s) == len(items):
            largest_mb += map(_resident_mb, _workers(os.getpid()))
        yield one


def _killed(folder: Path, out: Path, kills: int) -> Figures:
    """Kill the driver and its workers in turn, at random moments, and begin again."""
    words = [*TUNE, folder, "-o", out, "--resume", "--no-review", "--quiet", "--jobs", "2"]
    rng, left, starts, until_s = random.Random(5), kills, 0, time.monotonic() + 600.0
    while time.monotonic() < until_s:
        starts += 1
        with subprocess.Popen(words, stdout=subprocess.DEVNULL) as driver:
            at_s = time.monotonic() + rng.uniform(1.5, 5.0)
            while driver.poll() is None:
                time.sleep(0.01)
                if left and time.monotonic() > at_s:
                    workers = _workers(driver.pid)
                    victim = driver.pid if left % 2 or not workers else rng.choice(workers)
                    os.kill(victim, signal.SIGKILL)
                    left -= 1
                    at_s = time.monotonic() + rng.uniform(0.5, 4.0)
        if driver.returncode in (0, 1):
            break
    from pyarrow import parquet

    rows = parquet.read_table(ledger_file(out)).to_pylist()
    names = Counter(row["log"] for row in rows)
    wanted = {str(path.resolve()) for path in folder.iterdir()}
    yield "kills", kills - left
    yield "starts", starts
    yield "bad: logs lost", len(wanted - set(names))
    yield "bad: logs twice", sum(count > 1 for count in names.values())
    yield "logs with an error, the damaged ones", sum(row["error"] is not None for row in rows)
    yield "verdicts", str(dict(Counter(row["verdict"] for row in rows)))


def _workers(process: int) -> list[int]:
    """List processes below one that tune: of the pool, or of Ray."""
    found: list[int] = []
    try:
        children = Path(f"/proc/{process}/task/{process}/children").read_text().split()
        for child in map(int, children):
            words = Path(f"/proc/{child}/cmdline").read_bytes()
            found += [child] * (b"spawn_main" in words or b"ray::MapWorker" in words)
            found += _workers(child)
    except OSError:
        pass
    return found


def remote(count: int) -> Figures:
    """Tune logs of a real S3 server (moto) behind a relay that counts all that it sends."""
    import boto3
    from moto.server import ThreadedMotoServer

    from tests.analysis.batch.relay import CountingRelay

    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = ThreadedMotoServer("127.0.0.1", port=0, verbose=False)
    server.start()
    relay = CountingRelay(server.get_host_and_port()[1])
    os.environ |= {
        "AWS_ACCESS_KEY_ID": "key",
        "AWS_SECRET_ACCESS_KEY": "secret",
        "AWS_DEFAULT_REGION": "us-east-1",
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{relay.port}",
    }
    client, size = boto3.client("s3"), 0
    client.create_bucket(Bucket="lab")
    with tempfile.TemporaryDirectory() as folder:
        for index in range(count):
            log = Path(folder) / f"{index:05}.mcap"
            write_log(log, index)
            size += log.stat().st_size
            client.upload_file(str(log), "lab", f"runs/{log.name}")
        words = ["s3://lab/runs/", "-o", f"{folder}/out", "--no-review", "--resume", "--jobs", "2"]
        for what in ("times their bytes (wanted: at most 1.1)", "the same with --resume"):
            relay.passed = 0
            started(*TUNE, *words, "--quiet")
            yield what, relay.passed / size
    server.stop()


# ---- Training.

_PAPER = TRAININGS["paper-code"]
_PAIRS, _STEPS, _WIDTH = 800, 400, 32


def rollouts(count: int) -> Figures:
    """Make rollouts in processes, beside as many bare drops in as many, in three parts in turns.

    Of the preset `paper-code` each has 400 steps; `default` flies in closed form between impacts.
    """
    jobs, count = cores(), max(count, 100)
    for name, wanted in {"paper-code": " (wanted: at most 1.3)", "default": ""}.items():
        most = count if wanted else 4096  # of `default` any more pairs are drawn among these
        each, ours_s, bare_s = min(count // 3, most), 0.0, 0.0

        def make(rollouts: int, seed: int, name: str = name) -> int:
            return len(TRAININGS[name].make_pairs(rollouts // 2, seed, jobs, QUIET).values)

        for part in range(3):
            starting_s = spent(partial(make, 2 * jobs, 0))[0]
            whole_s, _, made = spent(partial(make, each, part))
            ours_s += whole_s - starting_s
            bare_s += _bare_stepping_s(jobs, made)
        yield f"{name}: ms each", 1e3 * ours_s / (3 * each)
        yield f"{name}: times 400 bare steps{wanted}", ours_s / bare_s


def training(rounds: int) -> Figures:
    """Make 800 pairs of 400 steps and train 200 epochs, beside what has nothing of ours in it.

    Bare: 1600 x 400 `stepSimulation` shared by as many processes, all ready before the clock
    starts; as many SGD steps of the paper's network of `torch.nn.Linear` on tensors that are ready.
    All figures are of the round whose ratio is the median.
    """
    import torch

    from tunenet_logs.analysis.tunenet.network import train

    torch.set_num_threads(1)
    torch.optim.SGD([torch.zeros(1, requires_grad=True)], lr=0.1)  # the first loads 100s of modules
    jobs = cores()

    def one_round() -> tuple[float, float, float, float]:
        # One rollout each: all the rest of it is loading and starting.
        starting_s = spent(lambda: _PAPER.make_pairs((jobs + 1) // 2, 0, jobs, QUIET))[0]
        whole_s, _, pairs = spent(lambda: _PAPER.make_pairs(_PAIRS, 0, jobs, QUIET))
        stepping_s = _bare_stepping_s(jobs, 2 * _PAIRS)
        train_s = spent(lambda: train(_PAPER.network, pairs, _PAPER.recipe, 0, QUIET))[0]
        return whole_s - starting_s, stepping_s, train_s, spent(_bare_optimizing())[0]

    done = sorted(((a + c) / (b + d), a, b, c, d) for a, b, c, d in
                  (one_round() for _ in range(rounds)))  # fmt: skip
    ratio, data_s, stepping_s, train_s, optimizing_s = done[rounds // 2]
    yield "seconds (wanted: at most 6 on 2 idle cores)", data_s + train_s
    yield "data, times stepping the engine", data_s / stepping_s
    yield "training, times the optimizer's steps", train_s / optimizing_s
    yield "data and training, times both (wanted: at most 1.5)", ratio


def _bare_stepping_s(jobs: int, drops: int) -> float:
    """Time the slowest of the processes, which start together and share the drops."""
    context = get_context("spawn")
    ready = context.Barrier(jobs)
    with context.Pool(jobs, initializer=_wait_for_all, initargs=(ready,)) as pool:
        return max(pool.map(_step_bare_world, [drops // jobs] * jobs, chunksize=1))


def _wait_for_all(ready: Any) -> None:
    pybullet()  # loading it is start-up
    ready.wait(60.0)


def _step_bare_world(drops: int) -> float:
    """Time so many drops from 4.5 m with restitution 0.5."""
    engine = pybullet()
    engine.connect(engine.DIRECT)
    engine.setGravity(0, 0, -9.8)
    plane = engine.createMultiBody(0, engine.createCollisionShape(engine.GEOM_PLANE))
    sphere = engine.createCollisionShape(engine.GEOM_SPHERE, radius=0.5)
    ball = engine.createMultiBody(1.0, sphere)
    engine.changeDynamics(plane, -1, restitution=1.0)
    engine.changeDynamics(ball, -1, restitution=0.5)
    engine.setTimeStep(1 / 60)
    start = time.perf_counter()
    for _ in range(drops):
        engine.resetBasePositionAndOrientation(ball, [0, 0, 4.5], [0, 0, 0, 1])
        engine.resetBaseVelocity(ball, [0, 0, 0], [0, 0, 0])
        for _ in range(_STEPS):
            engine.stepSimulation()
            engine.getBasePositionAndOrientation(ball)
    return time.perf_counter() - start


def _bare_optimizing() -> Callable[[], None]:
    """Prepare as many steps as the training makes."""
    import torch

    recipe, linear = _PAPER.recipe, torch.nn.Linear
    proposed, target = linear(_STEPS, _WIDTH), linear(_STEPS, _WIDTH)
    joint, out = linear(2 * _WIDTH, _WIDTH), linear(_WIDTH, 1)
    weights = torch.nn.ModuleList([proposed, target, joint, out]).parameters()
    optimizer = torch.optim.SGD(weights, lr=recipe.learning_rate, weight_decay=recipe.weight_decay)
    shapes = (recipe.batch, _STEPS), (recipe.batch, _STEPS), (recipe.batch,)
    ready = [[torch.rand(*shape) for shape in shapes] for _ in range(_PAIRS // recipe.batch)]

    def steps() -> None:
        for _ in range(recipe.epochs):
            for o_p, o_t, wanted in ready:
                sides = torch.cat((proposed(o_p).relu(), target(o_t).relu()), dim=1)
                residual = out(joint(sides).relu()).tanh()[:, 0]
                optimizer.zero_grad()
                ((residual - wanted) ** 2).mean().backward()
                optimizer.step()

    return steps


# ---- Arm.


def arm(rounds: int) -> Figures:
    """Roll an arm out over 5 s of the paper's circle, beside inverse dynamics."""
    body, held, path = jaco(), Payload(0.7), circle_path(60)
    inverse_s = best_s([lambda: joint_efforts_nm(body, path, held)], rounds)[0]
    yield "inverse dynamics, 5 s at 60 Hz [ms]", 1e3 * inverse_s
    for settings in (CALIBRATED, PAPER):
        times = settings.times()
        work = partial(roll_out, body, circle_at(times), held, settings)
        took_s, rollout = best_s([work], rounds)[0], work()
        yield f"rollout, settings {settings.name}: times that", took_s / inverse_s
        along = {"the circle": circle_at(times[settings.burn_in : -1]), "its own way": rollout.path}
        for what, way in along.items():
            off = rollout.effort_nm - joint_efforts_nm(body, way, held, settings.gravity_m_s2)
            told = f"rollout, settings {settings.name}: torques off along {what} [N·m rms]"
            yield told, float(np.sqrt(np.mean(off**2)))


def circle(out: str) -> Figures:
    """Make one turn of the paper's circle by the Jaco: `recorders/simulators/arm/circle.csv`.

    Seven joints leave four ways to hold the tool at a point. Of these each sample takes the one
    nearest to a posture, so that the turn closes and is smooth.
    """
    body, samples = jaco(), 256
    turn = np.arange(samples + 1) / samples
    angle_rad = 2 * math.pi * turn[:-1]
    tool_m = np.column_stack(
        [np.full(samples, -0.4), 0.2 * np.cos(angle_rad), 0.3 + 0.2 * np.sin(angle_rad)]
    )
    posture = np.array([[0.323, 3.394, 0.688, 1.365, 2.32, 1.916, 0.672]])
    position_rad = np.repeat(posture, samples, axis=0)
    for _ in range(400):
        poses = link_poses(body, position_rad)
        reached_m = poses.position_m[:, -1]
        columns = [
            np.cross(poses.rotation[:, index] @ joint.axis, reached_m - poses.position_m[:, index])
            for index, joint in enumerate(body.joints, start=1)
        ]
        jacobian = np.stack(columns, axis=-1)
        inverse = np.linalg.pinv(jacobian)
        to_point = np.einsum("tji,ti->tj", inverse, tool_m - reached_m)
        home = posture - position_rad
        along_null = home - np.einsum("tji,tik,tk->tj", inverse, jacobian, home)
        step = np.clip(0.3 / np.abs(to_point + along_null).max(axis=1, keepdims=True), 0, 1)
        position_rad = position_rad + step * (to_point + along_null / 2)
    closed = np.concatenate([position_rad, position_rad[:1]])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(out or f"{folder}/circle.csv")
        write_path_file(path, body.joint_names, 2 * math.pi / CIRCLE_RAD_S * turn, closed,
                        overwrite=False)  # fmt: skip
        shipped, made = (np.loadtxt(one, delimiter=",", skiprows=1) for one in (CIRCLE_CSV, path))
    off_rad = float(np.abs(shipped - made).max())
    yield "largest difference from the shipped one [rad]", off_rad
    yield "bad: another circle than the shipped one", int(off_rad > 1.5e-6)


# ---- Campaign.

_BALLS = {
    "squash ball": 0.55, "foam ball": 0.62, "tennis ball": 0.68,
    "red gel": 0.74, "racquetball": 0.79, "bouncy ball": 0.84,
}  # fmt: skip


def campaign(out: str, attempts: int) -> Figures:
    """Review a campaign of six balls, every drop filmed at 640 x 480 and 60 pictures a second.

    `out` keeps the campaign; where it is there already, it is reviewed again.
    """
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(out or f"{scratch}/campaign")
        if not folder.exists():
            folder.mkdir(parents=True)
            (Path(scratch) / "films").mkdir()
            _fill(folder, Path(scratch) / "films", attempts)
        yield "attempts", attempts * len(_BALLS)
        yield "logs [MB]", sum(one.stat().st_size for one in folder.glob("*.mcap")) / 1e6
        review = folder.with_suffix(".rrd") if out else Path(scratch) / "review.rrd"
        review.unlink(missing_ok=True)
        words = "-m", "tunenet_logs.analysis.cli.review", folder, "-o", review, "--quiet"
        yield "review [s]", spent(lambda: started(sys.executable, *words))[0]
        yield "review [MB]", review.stat().st_size / 1e6
        verify = subprocess.run([BIN / "rerun", "rrd", "verify", review], check=False, stdout=2)
        yield "bad: exit code of rerun rrd verify", verify.returncode


def _fill(folder: Path, films: Path, attempts: int) -> None:
    """Film and tune one drop a ball; copy log and tuning for its attempts, with made-up outcomes.

    Every fourth attempt has a rejected drop before it, and every twentieth no other.
    """
    from tests.conftest import film

    rng, number = np.random.default_rng(0), 0
    camera = FilmOrder(size_px=(640, 480), exposure_s=0.004, noise=4.0)
    drops = {"height_m": 0.8, "radius_m": 0.03, "seconds": 3.0, "hold_s": 0.3}
    logs = {
        ball: film(films / f"{seed}.mcap", camera, restitution=restitution, seed=seed, **drops)
        for seed, (ball, restitution) in enumerate(_BALLS.items())
    }
    tune = [*TUNE, *logs.values(), "--quiet"]
    subprocess.run(tune, check=False, stdout=subprocess.DEVNULL)  # one may be rejected

    def copy(log: Path, to: Path, *, is_rejected: bool) -> None:
        """Copy a log and its tuning under another name."""
        shutil.copyfile(log, to)
        told = {**json.loads(log.with_suffix(".json").read_text()), "log": to.name}
        if is_rejected:
            reason = "ball stays in view: left"
            told |= {"verdict": "rejected", "reason": reason, "parameters": None}
        to.with_suffix(".json").write_text(json.dumps(told))

    for attempt in range(1, attempts + 1):
        for ball, log in logs.items():
            number += 1
            name, is_bad = f"drop_{number:02d}", number % 20 == 7
            if number % 4 == 0:
                copy(log, folder / f"{name}a.mcap", is_rejected=True)
            copy(log, folder / f"{name}b.mcap", is_rejected=is_bad)
            miss_m = float(rng.normal(0, 0.02))
            is_in = abs(miss_m) < 0.03 and not is_bad
            outcome = Outcome(
                task="bounce-shot",
                ball=ball,
                attempt=attempt,
                success=is_in,
                stamp_ns=1_800_000_000_000_000_000 + number * 120_000_000_000,
                shot_height_m=None if is_bad else float(rng.uniform(0.4, 0.8)),
                miss_m=None if is_bad else miss_m,
                drop_log=f"{name}b.mcap",
                tuning=f"{name}b.json",
                reason="no good drop" if is_bad else "" if is_in else "rim",
            )
            write_outcome(folder, outcome)
