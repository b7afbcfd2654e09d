"""The record of the weather of a study and what the weather truly was."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

__all__ = ["REL_SD", "WORST_RECORD_SD", "Amount", "drawn_amounts", "drawn_record", "recorded_weather"]

REL_SD = 0.1  # that the record states
WORST_RECORD_SD = 2.5  # records that are off by more are not drawn


@dataclass(frozen=True)
class Amount:
    """Of one condition: a rate in mm/h or a visibility in m.

    Args:
        id: of the condition.
        scene: its number.
        true: amount.
        recorded: amount.
        split: ``fit`` or ``holdout``.
    """

    id: str
    scene: int
    true: float
    recorded: float
    split: str


def drawn_record(rng: np.random.Generator, record_sd: float | None) -> tuple[str, float]:
    """How the record errs: ``common`` (one error for all conditions, as of a gauge) or ``each``; and a common error in
    standard deviations.

    Args:
        rng: draws.
        record_sd: common error, with a sign drawn; ``None`` draws it.
    """
    record = str(rng.choice(["common", "each"]))
    shared = float(np.clip(rng.standard_normal(), -WORST_RECORD_SD, WORST_RECORD_SD))
    return (record, shared) if record_sd is None else ("common", record_sd * float(rng.choice([-1.0, 1.0])))


def drawn_amounts(
    rng: np.random.Generator, amounts: Sequence[float], scenes: int, record: str, shared: float
) -> Iterator[Amount]:
    """Every amount in every scene, jittered, with the record's error.

    Args:
        rng: draws.
        amounts: recorded, about.
        scenes: their number.
        record, shared: as ``drawn_record`` gives them.
    """
    number = 0
    for scene in range(scenes):
        for place, amount in enumerate(amounts):
            recorded = float(f"{amount * np.exp(rng.uniform(-0.1, 0.1)):.3g}")
            own = float(np.clip(rng.standard_normal(), -WORST_RECORD_SD, WORST_RECORD_SD))
            true = recorded * (1.0 + REL_SD * (shared if record == "common" else own))
            # One of the middle amounts is held out, another one in each scene.
            split = "holdout" if place == min(1 + scene % 2, len(amounts) - 1) else "fit"
            yield Amount(f"c{number:02d}", scene, float(f"{true:.6g}"), recorded, split)
            number += 1


def recorded_weather(kind: str, recorded: float) -> dict[str, Any]:
    """As a study states it."""
    amount, spread = ("mor_m", "mor_rel_sd") if kind == "fog" else ("rate_mm_per_h", "rate_rel_sd")
    return {"kind": kind, amount: recorded, spread: REL_SD}
