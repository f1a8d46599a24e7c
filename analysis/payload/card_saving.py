"""Writes the card that a tuning leaves of its arm."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from analysis.payload.arm_card import ArmCard, arm_sha256, card_text, read_arm_card
from analysis.payload.detection import PayloadDetection
from analysis.payload.torque_terms import arm_terms
from analysis.record import Tuning
from analysis.result_files import replacing
from tunenet_logs.errors import LogError, UsageError


def save_arm_card(tuning: Tuning, path: Path, *, overwrite: bool) -> None:
    """Write what a tuning learnt of its arm, and what the card said that it was made with.

    Args:
        tuning: of a log, with where it comes from.
        path: where to.
        overwrite: whether the card of other runs may be replaced; another file never is.

    Raises:
        LogError: there is nothing to write, or something else in its place; names the remedy.
        OSError: it cannot be written.
    """
    detection = tuning.detection
    provenance = tuning.provenance
    is_payload = isinstance(detection, PayloadDetection) and tuning.verdict != "rejected"
    if not is_payload or provenance is None:
        raise LogError(
            f"{path}: not written: {tuning.log} shows no payload, and so no arm",
            "name a log of an arm that moves",
        )
    log = {"log": tuning.log.name, "sha256": provenance.log_sha256}
    before = detection.card.runs if detection.card else ()
    card = ArmCard(
        arm_sha256(detection.arm),
        detection.log.joints,
        (*before, log, *map(dict, provenance.tares)),
        arm_terms(detection.arm),
        detection.fit.learnt,
    )
    if path.exists():
        _check_own(path, card, overwrite=overwrite)
    with replacing(path) as unfinished:
        unfinished.write_text(card_text(card), "utf-8", errors="backslashreplace")


def _check_own(path: Path, card: ArmCard, *, overwrite: bool) -> None:
    """Refuse to replace something else.

    Raises:
        LogError: the file is no card, or one of other runs.
    """
    there = None
    with suppress(UsageError):
        there = read_arm_card(path)
    if there is None:
        raise LogError(f"{path}: exists, and is no card of an arm; choose another --save-arm-card")
    if not overwrite and there.sha256s != card.sha256s:
        raise LogError(
            f"{path}: exists, and is a card of other runs; choose another --save-arm-card, or pass "
            "--overwrite"
        )
