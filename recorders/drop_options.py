"""Command-line options of `tunenet-record --simulate drop`, and the recording they ask for."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from tunenet_logs.commandline import number
from tunenet_logs.errors import UsageError

if TYPE_CHECKING:
    from recorders.filmed_drop import FilmOrder
    from recorders.simulated_drop import DropOrder


def drop_options(group: argparse._ArgumentGroup) -> list[argparse.Action]:
    """Add the options of the simulated drop; None where they are not given."""
    add = group.add_argument
    return [
        add(
            "--restitution",
            type=number(0, 1),
            metavar="E",
            help="coefficient of restitution, 0 to 1 (default: drawn from .1 to .95; of a bounce "
            "shot from .5 to .85)",
        ),
        add(
            "--slope",
            type=number(-0.5, 0.5),
            metavar="P",
            help="how the restitution falls with an impact's speed: E (v / v_first)^-P, constant "
            "below .05 m/s (default: 0); of a bounce shot from the one at 3 m/s",
        ),
        add(
            "--drag",
            type=number(0, 2, "1/m"),
            metavar="K",
            help="of the air on the ball, its deceleration over speed squared [1/m]; a "
            "table-tennis ball has .13 (default: 0; of a bounce shot by its ball's size and mass)",
        ),
        add(
            "--height",
            type=number(0.01, 1000, "m"),
            metavar="M",
            help="drop height, from the ball's underside to the table [m] "
            "(default: drawn, .3 to 5; with --render .4 to 2); of a bounce shot, how far it falls "
            "to the plane (default: drawn from what the rig reaches)",
        ),
        add(
            "--radius",
            type=number(0.001, 10, "m"),
            metavar="M",
            help="of the ball [m] (default: .05; preset paper: .5)",
        ),
        add(
            "--hold",
            type=number(0, 600, "s"),
            metavar="S",
            help="hold the ball before letting go [s] (default: 0)",
        ),
        add(
            "--noise",
            type=number(0, 1, "m"),
            metavar="M",
            help="standard deviation of the sensor's noise [m] (default: 0)",
        ),
        add(
            "--render",
            action="store_true",
            default=None,
            help="film it: the log holds a camera's pictures instead of positions",
        ),
        *_film_options(group),
    ]


def _film_options(group: argparse._ArgumentGroup) -> list[argparse.Action]:
    """Add the options of `--render`."""
    add = group.add_argument
    return [
        add(
            "--camera-at",
            type=_point,
            metavar="X,Y,Z",
            help="where the camera stands [m]; the ball falls at 0,0 (default: drawn, as the "
            "paper does, in drop heights)",
        ),
        add(
            "--look-at",
            type=_point,
            metavar="X,Y,Z",
            help="what it looks at [m] (default: 0.44 drop heights over the table)",
        ),
        add(
            "--fov",
            type=number(1, 150, "degrees"),
            metavar="DEG",
            help="its field of view, from the upper to the lower edge (default: 60)",
        ),
        add(
            "--blur",
            type=number(0, 1000, "ms"),
            metavar="MS",
            help="how long its shutter is open [ms] (default: 0)",
        ),
        add(
            "--pixel-noise",
            type=number(0, 100),
            metavar="N",
            help="standard deviation of a pixel, of 255 (default: 2)",
        ),
        add(
            "--lost",
            type=number(0, 0.9),
            metavar="SHARE",
            help="share of the frames that are missing (default: 0)",
        ),
    ]


def record_drop_as_asked(arguments: argparse.Namespace, path: Path) -> str:
    """Record a simulated drop; return the summary for the last line.

    Raises:
        TuneNetError: a value is invalid, or the log cannot be written.
    """
    from recorders.session import record_episode
    from recorders.simulated_drop import DropOrder, simulate_drop
    from tunenet_logs.terminal import Progress

    given = {
        "restitution": arguments.restitution,
        "slope": arguments.slope,
        "drag_1_m": arguments.drag,
        "height_m": arguments.height,
        "radius_m": arguments.radius,
        "rate_hz": arguments.rate,
        "seconds": arguments.seconds,
        "hold_s": arguments.hold,
        "noise_m": arguments.noise,
        "preset": arguments.preset,
        "seed": arguments.seed,
    }
    order = DropOrder(**{name: value for name, value in given.items() if value is not None})
    if arguments.render:
        from recorders.filmed_drop import film_drop

        episode = film_drop(order, _film_order(arguments, order))
    else:
        _refuse_film_options(arguments)
        episode = simulate_drop(order)
    progress = Progress(quiet=arguments.quiet)
    summary = record_episode(
        episode,
        path,
        overwrite=arguments.overwrite,
        progress=progress,
        min_free_bytes=round(arguments.min_free * 1e6),
    )
    truth, rig = episode.info.truth, episode.info.rig
    more = "".join(
        f"{words} {truth[name]:g}{unit}, "
        for name, words, unit in (("restitution_slope", "slope", ""), ("drag", "drag", " /m"))
        if truth.get(name)
    )
    return (
        f"restitution {truth['restitution']:.4f}, {more}"
        f"drop height {rig['drop_height_m']:.3f} m, by {episode.info.source}; "
        + summary.in_words("frames" if arguments.render else "samples")
    )


# Options that mean something to a camera alone: refused without --render.
_FILM_OPTIONS = ("camera_at", "look_at", "fov", "blur", "pixel_noise", "lost", "size")


def _refuse_film_options(arguments: argparse.Namespace) -> None:
    for name in _FILM_OPTIONS:
        if getattr(arguments, name) is not None:
            option = "--" + name.replace("_", "-")
            raise UsageError(f"{option} is for a drop that is filmed; add --render")


def _film_order(arguments: argparse.Namespace, order: DropOrder) -> FilmOrder:
    from recorders.filmed_drop import FilmOrder
    from recorders.simulators.pinhole import PinholeCamera

    given = {
        "size_px": arguments.size,
        "fov_deg": arguments.fov,
        "noise": arguments.pixel_noise,
        "lost_share": arguments.lost,
        "exposure_s": None if arguments.blur is None else arguments.blur * 1e-3,
    }
    film = FilmOrder(**{name: value for name, value in given.items() if value is not None})
    if arguments.camera_at is None:
        if arguments.look_at is not None:
            raise UsageError("--look-at needs --camera-at: where does the camera stand?")
        return film
    target = arguments.look_at
    if target is None:
        if order.height_m is None:
            raise UsageError("--camera-at needs --look-at or --height: where is the drop?")
        target = (0.0, 0.0, 0.44 * order.height_m)
    return replace(
        film, camera=PinholeCamera(arguments.camera_at, target, film.size_px, film.fov_deg)
    )


def _point(text: str) -> tuple[float, ...]:
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != 3 or not all(abs(value) < 1e4 for value in values):
        raise argparse.ArgumentTypeError(f"{text!r} is not a point X,Y,Z in meters, such as 1,-2,1")
    return values
