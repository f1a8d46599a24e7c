"""Export a tuned simulator of one's own: the model's file with new numbers, or its values as data.

The file is the user's own, edited (`recorders.simulators.model.text`), then loaded again and
rolled out beside the tuned model. The data has ranges and a joint sample for randomising a
simulator, where the values have intervals; else it says why there are none.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from os.path import isfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tunenet_logs.analysis.export.cards import JSON_CARD, YAML_CARD, Card, flat, provenance_card
from tunenet_logs.analysis.export.exported import ExportOrigin, origin_lines, origin_of, xml_comment
from tunenet_logs.analysis.record import Estimate, Posterior, Record
from tunenet_logs.analysis.sysid.source import ModelSource
from tunenet_logs.episode import Array
from tunenet_logs.errors import LogError, NotFoundError, TuneNetError, UsageError
from tunenet_logs.files import real_path
from tunenet_logs.terminal import one_line, short_name

if TYPE_CHECKING:
    from tunenet_logs.recorders.simulators.model.writing import WrittenModel

TASK = "simulator"  # of records that are exported here


# ---- Tuning of a simulator, and the model's file that it was made with


@dataclass(frozen=True, eq=False)
class TunedSimulator:
    """Tuned values of a simulator of one's own, for export."""

    named: str  # the tuning, in errors
    origin: ExportOrigin
    estimates: tuple[Estimate, ...]
    posterior: Posterior | None  # None where the values have no intervals
    source: ModelSource | None  # of the model; None of one in Python, or without its file
    missing: str = ""  # why there is no source

    @property
    def values(self) -> dict[str, float]:
        """Tuned values by address."""
        return {one.name: one.value for one in self.estimates if isinstance(one.value, float)}

    @property
    def doubt(self) -> str:
        """Why the values have no intervals; "" where they have."""
        if self.posterior is not None:
            return ""
        why = self.origin.reason if self.origin.verdict == "suspect" else None
        return why or "the method that was used finds none"


def tuned_simulator(
    record: Record, named: str, model: Path | None = None, near: Path | None = None
) -> TunedSimulator:
    """Take what is exported from a record, and find its model.

    `model` is where the user says that it is, else it is sought as it was named when tuned, and
    in the folder `near`. A model that has changed since is refused.
    """
    if record.verdict == "rejected":
        raise NotFoundError(
            f"{named}: this tuning was rejected ({one_line(record.reason)})",
            "record again and tune that log",
        )
    if any(not isinstance(one.value, float) for one in record.estimates) or not record.estimates:
        raise LogError(f"{named}: holds no values of a simulator", "tune the log again")
    posterior = record.posterior
    if posterior is not None and not _fits(posterior, len(record.estimates)):
        raise LogError(f"{named}: its posterior is none of its values", "tune the log again")
    source, missing = None, "it is of a simulator in Python, which has no file"
    told = record.provenance and record.provenance.model
    if told:
        wanted = record.provenance.options.get("parameters", ()) if record.provenance else ()
        wanted = tuple(one for one in wanted if isinstance(one, str))
        path, missing = _model_file(told.path, told.sha256, model, near)
        source = None if path is None else ModelSource(path, wanted)
    elif record.provenance and "model" in record.provenance.options:
        missing = "it was made by a version that did not keep the model's path: tune the log again"
    elif model is not None:
        raise UsageError(f"{named}: {missing}; leave --model out")
    return TunedSimulator(named, origin_of(record), record.estimates, posterior, source, missing)


def _fits(posterior: Posterior, count: int) -> bool:
    """Return whether a posterior, which may be anybody's, is one of so many values."""
    rows = posterior.correlation
    same = {len(posterior.sd), len(posterior.bounds), len(posterior.searched), len(rows)}
    return same == {count} and all(len(row) == count for row in rows) and min(posterior.sd) >= 0


def _model_file(
    told: str, sha256: str, model: Path | None, near: Path | None
) -> tuple[Path | None, str]:
    """Find the model's file; else return None, and why not."""
    from tunenet_logs.recorders.simulators.model.reading import ModelFiles

    named = Path(told)
    places = [named, *([near / named, near / named.name] if near else [])]
    changed: Path | None = None
    there = [one for one in places if isfile(one)]  # noqa: PTH113 (False for any error)
    for place in there if model is None else [model]:
        try:
            if ModelFiles(place).sha256 == sha256:
                return place, ""
        except UsageError:
            if model is not None:
                raise
        changed = changed or place
    if changed is not None:
        raise UsageError(
            f"{changed}: has changed since it was tuned, or a file that it names",
            "give the one that was tuned with --model, or tune the log again",
        )
    where = f"its model {short_name(told, 200)} is not found from here"
    return None, f"{where}: name it with --model"


# ---- The model's own file


@dataclass(frozen=True, eq=False)
class ModelExport:
    """Files of an exported model, and what is said of them."""

    texts: Mapping[Path, bytes]  # by their paths; the model's own comes first
    lines: tuple[str, ...]  # what is in them, and what is not
    written: WrittenModel | None = None  # None of data


def model_export(
    item: TunedSimulator, to: str, output: Path | None, tuning: Path | None
) -> ModelExport:
    """Make the files of a format, by default beside the model, or data beside the `tuning`."""
    if to in ("yaml", "json"):
        return _data_export(item, YAML_CARD if to == "yaml" else JSON_CARD, output, tuning)
    from tunenet_logs.recorders.simulators.model.writing import write_model

    if item.source is None:
        raise UsageError(f"{item.named}: {item.missing}", "give --to yaml for its values")
    source = item.source
    files = source.files
    _check_kind(source, to)
    wanted = {one.parameter.name: one for one in source.tuned}
    if lost := [name for name in item.values if name not in wanted]:
        what = f"{item.named}: {short_name(lost[0])} is none of what was tuned"
        raise LogError(what, "tune the log again")
    from tunenet_logs.recorders.simulators.model.parameters import DELAY
    from tunenet_logs.recorders.simulators.model.servo import nearest

    remarks = {
        one.name: f"{estimate_line(one)}, was {wanted[one.name].given:.6g}; {_from(item.origin)}"
        for one in item.estimates
        if one.name != DELAY
    }
    values = dict(item.values)
    for name, by in nearest(values, source.model).items():
        values[name] = values.get(name, wanted[name].given) + by
        was = remarks.get(name, f"was {wanted[name].given:.6g}")
        remarks[name] = f"{was}; {by:.3g} of it in place of what MuJoCo's servos lack"
    written = write_model(files, source.tuned, values, remarks, source.process)
    left = [
        f"not written: {one.name} = {estimate_line(one)}: {written.unwritten[one.name]}"
        for one in item.estimates
        if one.name in written.unwritten
    ]
    if len(left) == len(item.estimates):
        raise UsageError(f"{item.named}: {'; '.join(left)}", "give --to yaml for its values")
    home = files.path.parent
    folder = source.path.parent if real_path(source.path.parent) == home else home
    place = output or folder / f"{files.path.stem}.tuned{files.path.suffix}"
    if place.suffix != files.path.suffix:
        raise UsageError(f"{place}: give -o a name that ends {files.path.suffix}, as the model's")
    if written.xml.names_files and real_path(place).parent != home:
        raise UsageError(
            f"{place}: {source.path.name} names other files, which are found from its own folder",
            f"leave -o out, or name a file in {home}",
        )
    renamed = written.xml.renames(place)
    for path in renamed.values():
        if real_path(path) in files.texts:
            raise UsageError(f"{path}: is the model itself", "give -o another name")
    head = [*origin_lines(item.origin), *_doubt_lines(item), *left]
    head += [f"Kept as it was: {one}." for one in written.kept]
    texts = written.xml.texts(
        {path: one.name for path, one in renamed.items()}, xml_comment(head).replace("<!D", "<! D")
    )
    if files.path not in texts:  # nothing in it changes but that it has a name of its own
        texts = {files.path: files.texts[files.path], **texts}
    ordered = {renamed[path]: texts[path] for path in (files.path, *texts)}
    beside = "beside the model, from where its other files are found"
    lines = [beside] * (written.xml.names_files and output is None) + left
    lines += [f"kept as it was: {one}, which MuJoCo would derive anew" for one in written.kept]
    return ModelExport(ordered, tuple(lines), written)


def _check_kind(source: ModelSource, to: str) -> None:
    """Refuse a format that the model is not in."""
    from tunenet_logs.recorders.simulators.model.text import ModelXml

    is_urdf = ModelXml(source.files).is_urdf
    if is_urdf and to == "mjcf":
        raise UsageError(
            f"{source.path}: is a URDF: an MJCF that MuJoCo writes of it has merged links and "
            "fewer digits, which is another model",
            "give --to urdf",
        )
    if not is_urdf and to == "urdf":
        raise UsageError(
            f"{source.path}: is an MJCF, whose actuators, contacts, friction and armature have no "
            "place in a URDF",
            "give --to mjcf",
        )


def _from(origin: ExportOrigin) -> str:
    """Say in a few words whose value it is."""
    of = f", SHA-256 {origin.log_sha256[:12]}" if origin.log_sha256 else ""
    return f"from {short_name(origin.log)}{of}; {origin.verdict}"


def _doubt_lines(item: TunedSimulator) -> list[str]:
    return [f"No intervals: {short_name(item.doubt, 200)}"] * bool(item.doubt)


def estimate_line(one: Estimate) -> str:
    """Format value, unit and interval: `0.3458 kg (95 %: 0.3422 to 0.3494)`."""
    assert isinstance(one.value, float)
    unit = "" if one.unit == "1" else f" {short_name(one.unit)}"
    ends = one.components[0].interval95
    if ends is None:
        return f"{one.value:.6g}{unit} (no reliable interval)"
    # To a hundredth of what is unsure.
    unsure = max(ends[1] - ends[0], 1e-300)
    digits = int(np.clip(np.ceil(np.log10(max(abs(one.value), unsure) / unsure)) + 2, 2, 15))
    value, low, high = (f"{number:.{digits}g}" for number in (one.value, *ends))
    return f"{value}{unit} (95 %: {low} to {high})"


def check_export(export: ModelExport, item: TunedSimulator) -> str:
    """Load the written model from the disk and roll it out beside the tuned one; say how they are.

    LogError where they are not the same.
    """
    from tunenet_logs.recorders.simulators.model.reading import ModelFiles
    from tunenet_logs.recorders.simulators.model.writing import TEST_S, differences, rollouts_differ

    assert export.written is not None
    assert item.source is not None
    path = next(iter(export.texts))
    model = ModelFiles(path).spec().compile()
    off = differences(export.written.tuned, model)
    if off != export.written.off:
        raise LogError(f"{path}: is not the tuned model when it is read; please report it")
    try:
        apart, alike_s, stopped = rollouts_differ(export.written.tuned, model, item.source.process)
    except LogError as error:
        return f"loaded again: the same model; not rolled out: {error.what}"
    stops = f", which stops ({stopped})," if stopped else ""
    if not off and not apart:
        return (
            f"loaded again: every number is the tuned model's; {TEST_S:g} s of it{stops} move "
            "alike to the last bit"
        )
    by = "loaded again: every number is the tuned model's"
    if off:
        worst = max(off, key=lambda name: off[name])
        by = f"loaded again: {worst} is off by {off[worst]:.1g} of its size, by rounding"
    if apart < 1e-6:
        return f"{by}; {TEST_S:g} s of it{stops} move alike to {apart:.1g}"
    return f"{by}; {alike_s:.2g} s of it move alike to 1e-6, then chaos makes more of that"


# ---- Values as data, with ranges and a joint sample

COUNT = 1000  # rows of the sample
_LISTED = 100  # of them that are listed in the text
_SEED = 0


def ranges(item: TunedSimulator) -> dict[str, tuple[float, float]] | None:
    """Return the range in which to vary each value; None where the values have no intervals.

    Its 95 % interval; of what the log cannot tell no more than was searched.
    """
    if item.posterior is None:
        return None
    found: dict[str, tuple[float, float]] = {}
    names, values = _named(item)
    limits_of = _limits(names, values, item.posterior)
    for one, limits in zip(item.estimates, limits_of, strict=True):
        ends = one.components[0].interval95
        if ends is None:
            return None
        low, high = np.clip(ends, *limits).tolist()
        found[one.name] = (low, high)
    return found


def _named(item: TunedSimulator) -> tuple[list[str], Array]:
    """Return names and values, shape (P,)."""
    values = np.array([one.value for one in item.estimates], np.float64)
    return [one.name for one in item.estimates], values


def _limits(names: Sequence[str], values: Array, posterior: Posterior) -> Array:
    """Return the ends between which values are drawn, shape (P, 2)."""
    found: list[tuple[float, float]] = []
    for number, (name, value) in enumerate(zip(names, values.tolist(), strict=True)):
        low, high = posterior.bounds[number]
        if name in posterior.unidentifiable:
            low = max(low, min(posterior.searched[number][0], value))
            high = min(high, max(posterior.searched[number][1], value))
        found.append((low, high))
    return np.array(found)


def joint_sample(item: TunedSimulator, count: int = COUNT) -> Array:
    """Draw rows of all values from their posterior, shape (count, P); UsageError without one."""
    posterior = item.posterior
    if posterior is None:
        raise UsageError(f"the values have no intervals ({item.doubt}), so no sample of them")
    return posterior_sample(*_named(item), posterior, count)


def posterior_sample(
    names: Sequence[str], values: Array, posterior: Posterior, count: int, seed: int = _SEED
) -> Array:
    """Draw rows of values from their posterior about them, shape (count, P).

    A Gaussian with the intervals' widths and the fit's correlations, cut where physics ends and,
    of what the log cannot tell, where the search did.
    """
    sd = np.array(posterior.sd)
    correlation = np.array(posterior.correlation)
    sizes, axes = np.linalg.eigh((correlation + correlation.T) / 2)
    factor = sd[:, None] * axes * np.sqrt(np.maximum(sizes, 0.0))
    middle = np.asarray(values, np.float64)
    low, high = _limits(names, middle, posterior).T
    rng = np.random.default_rng(seed)
    found = np.zeros((0, len(middle)))
    for _ in range(100):
        drawn = middle + rng.standard_normal((count, len(middle))) @ factor.T
        inside = np.all((drawn >= low) & (drawn <= high), axis=1)
        found = np.concatenate([found, drawn[inside]])[:count]
        if len(found) == count:
            return found
    rest = middle + rng.standard_normal((count - len(found), len(middle))) @ factor.T
    return np.concatenate([found, np.clip(rest, low, high)])


_MAX_BYTES = 200_000_000  # of all arrays together


def model_arrays(source: ModelSource, names: Sequence[str], rows: Array) -> dict[str, Array]:
    """Return the arrays of MuJoCo's model that differ between rows of values (N, P), (N, ...) each.

    Those that follow from others, too, such as `body_subtreemass`. LogError beyond 200 MB.
    """
    from tunenet_logs.recorders.simulators.model.writing import arrays_of, tuned_models

    given = arrays_of(source.model)
    by_row = [dict(zip(names, row, strict=True)) for row in rows.tolist()]
    changed = dict.fromkeys(
        name
        for model in tuned_models(source.spec, source.tuned, by_row[:3])
        for name, array in arrays_of(model).items()
        if array.dtype.kind == "f" and not np.array_equal(array, given[name])
    )
    if len(rows) * sum(given[name].nbytes for name in changed) > _MAX_BYTES:
        raise LogError(
            f"they have over {_MAX_BYTES // 1_000_000} MB", "set the values in the model"
        )
    found = {name: np.empty((len(rows), *given[name].shape)) for name in changed}
    for number, model in enumerate(tuned_models(source.spec, source.tuned, by_row)):
        for name, array in found.items():
            array[number] = attrgetter(name)(model)
    return found


def _data_export(
    item: TunedSimulator, card: Card, output: Path | None, tuning: Path | None
) -> ModelExport:
    place = output
    if place is None:
        assert tuning is not None, "where an output is left out"
        place = tuning.with_suffix(f".card{card.SUFFIX}")
    if place.suffix != card.SUFFIX:
        raise UsageError(f"{place}: give -o a name that ends {card.SUFFIX}")
    arrays = place.with_suffix(".npz")
    known, found = item.posterior, ranges(item)
    notes = [*origin_lines(item.origin), *_doubt_lines(item)]
    values: dict[str, Any] = {}
    for number, one in enumerate(item.estimates):
        told: dict[str, Any] = {
            "value": one.value,
            "interval95": flat(one.components[0].interval95),
            "unit": one_line(one.unit),
        }
        if known is not None:
            told["searched"] = flat(known.searched[number])
            told["told_by_the_log"] = one.name not in known.unidentifiable
        values[one_line(one.name)] = told
    data: dict[str, Any] = {
        "kind": "model",
        "verdict": item.origin.verdict,
        "reason": item.origin.reason,
        "values": values,
        "randomisation": None,
        "provenance": provenance_card(item.origin),
    }
    lines: list[str] = []
    texts: dict[Path, bytes] = {}
    if found is None or known is None:
        lines.append(f"no ranges and no sample: {item.doubt}")
        notes.append("No ranges and no sample: the values have no intervals.")
    else:
        sample = joint_sample(item)
        notes += [
            "randomisation: `ranges` are 95 % intervals, each of a value alone; a row of `sample`",
            f"has values that go together: the first {_LISTED} of {COUNT} in {arrays.name}.",
            "Of what the log cannot tell they reach no further than was searched.",
        ]
        data["randomisation"] = {
            "ranges": {one_line(name): flat(ends) for name, ends in found.items()},
            "standard_deviations": flat(known.sd),
            "correlations": [flat(row) for row in known.correlation],
            "file": arrays.name,
            "sample": [flat(row) for row in sample[:_LISTED].tolist()],
        }
        origin = "\n".join(map(one_line, origin_lines(item.origin)))
        stored: dict[str, Any] = {"origin": np.array(origin.encode())}  # by which it is known
        stored["names"] = np.array([one.name for one in item.estimates])
        stored["units"] = np.array([one.unit for one in item.estimates])
        stored["values"] = np.array([one.value for one in item.estimates])
        stored |= {"sample": sample, **_stored(item, sample, lines)}
        body = io.BytesIO()
        np.savez(body, **stored)
        texts[arrays] = body.getvalue()
    return ModelExport({place: card.text(data, notes).encode(), **texts}, tuple(lines))


def _stored(item: TunedSimulator, sample: Array, lines: list[str]) -> dict[str, Array]:
    """Return MuJoCo's arrays by the names that they have in the file; a line says what is amiss."""
    if item.source is None:
        lines.append(f"without MuJoCo's arrays: {item.missing}")
        return {}
    names = [one.name for one in item.estimates]
    try:
        found = model_arrays(item.source, names, sample)
    except TuneNetError as error:
        lines.append(f"without MuJoCo's arrays: {error}")
        return {}
    return {f"mujoco.{name}": array for name, array in found.items()}
