"""Studies of a camera and of a radar in which something that D3.4 suspects or does is hidden."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

import torchweather as tw
from torchweather.gap import Study
from torchweather.gap.study.hidden import HiddenStudy
from torchweather.physics import rain_attenuation_p838_db_per_km
from torchweather.scenes import SCENES
from torchweather.stages import Effect

# Of the camera's study: a small frame, and the electrons of a saturated pixel and of its readout (orders of magnitude).
CAMERA_PX = (240, 180)
FULL_WELL_ELECTRONS, READ_ELECTRONS = 10_000.0, 5.0
# Radar: number of targets, their margin above the threshold in clear air, and the noise floor of the list.
TARGETS, MARGINS_DB, FLOOR_DB = 120, (1.0, 35.0), -125.0
FLOOR_READ_DB = 0.03  # to which the mean of so many cells is known
CLEAR_FRAMES, FRAMES, REL_SD = 8, 5, 0.1
RATES_MM_PER_H = {10.0: "fit", 25.0: "fit", 40.0: "holdout", 60.0: "fit"}


def camera_study(effect: Effect, seed: int) -> HiddenStudy:
    """Raw frames of the test track in rain, with an effect in the weather frames; shot and readout noise come last."""
    rng = np.random.default_rng(seed)
    camera = replace(tw.Camera.preset("lucid-triton").resized(*CAMERA_PX), response_knots=None)
    view = SCENES["test-track"]().view(camera)

    def noisy(bayer: NDArray[Any]) -> dict[str, NDArray[Any]]:
        electrons = rng.poisson(bayer * FULL_WELL_ELECTRONS) + READ_ELECTRONS * rng.standard_normal(bayer.shape)
        return {"bayer": np.clip(electrons / FULL_WELL_ELECTRONS, 0.0, 1.0).astype(np.float32)}

    geometry = {"depth_m": view.depth_m[0].numpy(), "normal": view.normal.movedim(0, -1).numpy()}
    clear = [noisy(view.bayer[0].numpy()) for _ in range(CLEAR_FRAMES)]
    conditions, factors = [], {}
    for rate, split in RATES_MM_PER_H.items():
        name = f"rain-{rate:g}"
        factors[name] = float(np.exp(REL_SD * rng.standard_normal()))
        rain = tw.BayerRain(tw.Rain(rate * factors[name]), camera, effects=[effect])
        seeds = rng.integers(2**62, size=FRAMES)
        made = [rain(view.bayer, view.depth_m, rain.draw(view.bayer, seed=int(one)))[0].numpy() for one in seeds]
        weather = {"kind": "rain", "rate_mm_per_h": rate, "rate_rel_sd": REL_SD}
        frames = [noisy(one) for one in made]
        conditions.append({"id": name, "scene": "test-track", "weather": weather, "frames": frames, "split": split})
    study = Study.from_arrays(
        sensor=camera,
        scenes=[{"id": "test-track", "clear": clear, "geometry": geometry}],
        conditions=conditions,
    )
    return HiddenStudy(study, (effect,), factors)


def radar_study(effects: Sequence[Effect], noise_up_db: float, seed: int) -> HiddenStudy:
    """Lists of a radar whose noise is up in rain while its threshold stays where it was: targets are lost or kept by
    their power, and every empty cell whose noise exceeds the threshold is listed.

    Args:
        effects: of the catalogue, that are this.
        noise_up_db: by which the noise is up.
        seed: of everything random.
    """
    rng = np.random.default_rng(seed)
    radar = tw.Radar.preset("imaging-77ghz", noise_floor_db=FLOOR_DB)
    targets = {
        "range_m": np.exp(rng.uniform(np.log(5.0), np.log(0.98 * radar.max_range_m), TARGETS)),
        "azimuth_rad": rng.uniform(-0.6, 0.6, TARGETS),
        "elevation_rad": rng.uniform(-0.1, 0.1, TARGETS),
        "speed_m_per_s": rng.uniform(-3.0, 3.0, TARGETS),
        "target_class": rng.integers(0, 3, TARGETS),
    }
    clear_snr_db = radar.detection_snr_db + rng.uniform(*MARGINS_DB, TARGETS)

    def frame(loss_db: NDArray[Any] | float, up_db: float) -> dict[str, NDArray[Any]]:
        """Powers in units of the noise as it is."""
        threshold = 10.0 ** (0.1 * (radar.detection_snr_db - up_db))
        amplitude = 10.0 ** (0.05 * (clear_snr_db - loss_db - up_db))
        receiver = rng.standard_normal((2, TARGETS)) / np.sqrt(2.0)
        snr = (amplitude + receiver[0]) ** 2 + receiver[1] ** 2
        error = rng.standard_normal((2, TARGETS)) / np.sqrt(2.0 * np.maximum(snr, 1.0))
        measured = {
            "power_db": FLOOR_DB + up_db + 10.0 * np.log10(snr),
            "range_m": targets["range_m"] + radar.range_resolution_m * error[0],
            "speed_m_per_s": targets["speed_m_per_s"] + radar.speed_resolution_m_per_s * error[1],
        }
        found = {name: np.where(snr >= threshold, values, np.nan) for name, values in measured.items()}
        noise = rng.exponential(size=radar.range_doppler_cells)
        noise = noise[noise >= threshold]
        places = [
            radar.max_range_m * rng.random(len(noise)),
            rng.uniform(-0.6, 0.6, len(noise)),
            rng.uniform(-0.1, 0.1, len(noise)),
            radar.max_speed_m_per_s * rng.uniform(-1.0, 1.0, len(noise)),
        ]
        clutter = np.stack([*places, FLOOR_DB + up_db + 10.0 * np.log10(noise), np.zeros(len(noise))], 1)
        floor_db = np.array(FLOOR_DB + up_db + FLOOR_READ_DB * rng.standard_normal())
        return {**found, "noise_floor_db": floor_db, "clutter": clutter}

    clear = [frame(0.0, 0.0) for _ in range(CLEAR_FRAMES)]
    conditions, factors = [], {}
    for rate, split in RATES_MM_PER_H.items():
        name = f"rain-{rate:g}"
        factors[name] = float(np.exp(REL_SD * rng.standard_normal()))
        per_km = float(rain_attenuation_p838_db_per_km(rate * factors[name], radar.frequency_ghz))
        frames = [frame(2e-3 * per_km * targets["range_m"], noise_up_db) for _ in range(FRAMES)]
        weather = {"kind": "rain", "rate_mm_per_h": rate, "rate_rel_sd": REL_SD}
        conditions.append({"id": name, "scene": "road", "weather": weather, "frames": frames, "split": split})
    study = Study.from_arrays(
        sensor=radar,
        scenes=[{"id": "road", "clear": clear, "geometry": targets}],
        conditions=conditions,
    )
    return HiddenStudy(study, tuple(effects), factors)
