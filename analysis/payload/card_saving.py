"""Save the arm card of a tuning."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

from analysis.payload.arm_card import MAX_CARD_BYTES, ArmCard, arm_sha256, card_in, card_text
from analysis.payload.detection import PayloadDetection
from analysis.payload.torque_terms import arm_terms
from analysis.record import Tuning
from tunenet_logs.errors import LogError
from tunenet_logs.output.owned_file import OutputPlace
from tunenet_logs.terminal import listed


def save_arm_card(tuning: Tuning, path: Path, *, overwrite: bool) -> None:
    """Write what a tuning identified of its arm, added to the card that it was made with.

    Raises:
        LogError: There is nothing to write, or a file in its place may not be replaced.
        OSError: It cannot be written.
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
    with card_place(path, card, overwrite=overwrite).replacing() as unfinished:
        unfinished.write_text(card_text(card), "utf-8", errors="backslashreplace")


def card_place(path: Path, card: ArmCard | None, *, overwrite: bool) -> OutputPlace:
    """Return the output place of a card; without one, that of any card."""

    def knows(file: BinaryIO) -> Sequence[str] | None:
        there = card_in(file.read(MAX_CARD_BYTES + 1), path.name)
        is_same = card is None or there.sha256s == card.sha256s
        return () if is_same else [run["log"] for run in there.runs]

    runs = listed(run["log"] for run in card.runs) if card else ""
    elsewhere = "choose another --save-arm-card"
    return OutputPlace(path, "card", knows, runs, elsewhere, overwrite=overwrite)
