"""Links as a study of the search for missing effects, and the model with the effects that it found."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from parts.link_losses import WET_MM_PER_H, dry_steps, measured_db, quiet_links
from parts.link_recordings import STEP_MIN, Array, Recording
from parts.link_scores import Rules, held_out_links, odd_days, scores

from torchweather.gap import GapReport, Study
from torchweather.physics import rain_attenuation_coefficients, wet_cover_series_db
from torchweather.pipeline.effect import Effect
from torchweather.radar.effects.all import RadarPathLossScale, RadarWetRadome


def study_of(
    recording: Recording, attenuation_db: Array, chosen: Array, held: Array, rules: Rules, reference_sd: float = 0.0
) -> Study:
    """The chosen links as a study: those of the half held out, where the rules say so on the days held out.

    ``reference_sd``: relative standard deviation of the reference's mean rain.
    """
    odd = odd_days(len(attenuation_db))

    def condition(name: str, on: Array | bool, split: str | None) -> dict[str, Any]:
        frame = {
            "time_s": 60.0 * STEP_MIN * np.arange(len(attenuation_db)),
            "attenuation_db": np.where(on, attenuation_db, np.nan)[:, chosen],
            "rain_mm_per_h": recording.along_mm_per_h[:, chosen],
        }
        return {"id": name, "frames": [frame], "split": split, "rel_sd": reference_sd}

    days = [condition("even days", ~odd, "fit"), condition("odd days", odd, "holdout")]
    return Study.from_arrays(
        kind="link",
        links={
            "length_km": recording.length_km[chosen],
            "frequency_ghz": recording.frequency_ghz[chosen],
            "polarisation": recording.vertical[chosen],
            "split": held[chosen].astype(int),
        },
        conditions=days if rules.alternate_days else [condition("all", True, None)],
    )


def fitted_rain_factor(found: GapReport, rain_mm_per_h: Array) -> Array:
    """What the search takes the reference's rain to be times: a factor for each class of rain, 1 where it is exact."""
    fitted = found.answer["nuisance"]["by_condition"]  # "0.1 to 0.5 mm/h", ..., "20 mm/h and more", "after rain"
    classes = sorted((float(label.split()[0]), factor) for label, factor in fitted.items() if "mm/h" in label)
    lows, factors = np.array(classes).T
    place = np.searchsorted(lows, np.nan_to_num(rain_mm_per_h), side="right")
    return np.array([1.0, *factors])[place]


def with_effects(recording: Recording, effects: Sequence[Effect], rain_factor: Array | float = 1.0) -> Array:
    """Attenuation by P.838-3 with effects, dB ``(steps, links)``, the reference's rain on the path times a factor."""
    known = rain_attenuation_coefficients(torch.from_numpy(recording.frequency_ghz))
    exponent = np.where(recording.vertical == 1, known.alpha_vertical, known.alpha_horizontal)
    total_db = recording.model_db * rain_factor**exponent
    for effect in effects:
        if isinstance(effect, RadarPathLossScale):
            total_db = total_db * float(effect.factor)
        elif isinstance(effect, RadarWetRadome):
            rain = np.nan_to_num(np.where(recording.rain_mm_per_h < WET_MM_PER_H, 0.0, recording.rain_mm_per_h))
            time_min = STEP_MIN * torch.arange(len(rain), dtype=torch.float64)
            series = torch.from_numpy(rain.T.copy())
            drying = float(effect.drying_min)
            film = wet_cover_series_db(
                series, time_min, 0.0, float(effect.film_db), float(effect.film_exponent), drying
            )
            wet = wet_cover_series_db((series > 0).double(), time_min, 0.0, float(effect.loss_db), 0.0, drying)
            total_db = total_db + (film + wet).numpy().T
    return total_db


def said(effect: Effect | dict[str, Any]) -> str:
    """An effect with its parameters in a line."""
    values = effect if isinstance(effect, dict) else effect.to_dict()
    numbers = {key: value for key, value in values.items() if key != "effect"}
    return f"{values['effect']}({', '.join(f'{key} = {value:.2f}' for key, value in numbers.items())})"


class Held:
    """A set of links with its halves: what was measured, and how a model is judged."""

    def __init__(self, recording: Recording, rules: Rules) -> None:
        self.recording, self.rules = recording, rules
        self.attenuation_db, _ = measured_db(recording)
        self.chosen = quiet_links(recording, self.attenuation_db, rules.longer_than_km)
        self.known = np.isfinite(recording.model_db - self.attenuation_db)
        odd = odd_days(len(self.attenuation_db))
        self.days, self.searched_days = (odd, ~odd) if rules.alternate_days else (odd | True, odd | True)

    def study(self, seed: int, reference_sd: float) -> Study:
        half = held_out_links(self.chosen, seed)
        return study_of(self.recording, self.attenuation_db, self.chosen, half, self.rules, reference_sd)

    def judged(self, seed: int) -> Array:
        return self.known & self.days & held_out_links(self.chosen, seed)

    def searched(self, seed: int) -> Array:
        return self.known & self.searched_days & self.chosen & ~held_out_links(self.chosen, seed)

    def scores(
        self, effects: Sequence[Effect], seed: int, rain_factor: Array | float = 1.0
    ) -> tuple[float, float, float]:
        error = with_effects(self.recording, effects, rain_factor) - self.attenuation_db
        return scores(self.recording, error, self.judged(seed), self.rules)

    def scores_of(self, found: GapReport, seed: int) -> tuple[float, float, float]:
        return self.scores(found.effects, seed, fitted_rain_factor(found, self.recording.rain_mm_per_h))

    def dry_noise_db(self) -> float:
        dry = dry_steps(self.recording.rain_mm_per_h) & np.isfinite(self.attenuation_db) & self.chosen
        return float(self.attenuation_db[dry].std())
