"""A study of an embedded scene with effects hidden in its frames in weather, and the truth of it apart."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchweather.atmosphere.weather import Fog, Rain, Snow, Weather
from torchweather.core.errors import check_at_least, check_one_of
from torchweather.core.random import keyed_stream
from torchweather.core.threads import one_thread_an_operation
from torchweather.gap.study.embedded import RINGS
from torchweather.gap.study.frames import Frame
from torchweather.gap.study.splits import FIT, HOLDOUT
from torchweather.gap.study.study import Study
from torchweather.lidar.effects.all import EFFECTS
from torchweather.lidar.sensor import Lidar
from torchweather.lidar.stages import ToEnergy
from torchweather.lidar.transform import LidarWeather
from torchweather.pipeline.effect import Effect
from torchweather.scenes import SCENES, LidarView, lidar_view

__all__ = ["HIDEABLE", "WEATHERS", "HiddenStudy", "Hideable", "drawn_effect", "drawn_study", "hidden_study"]

# The third of each is held out: it lies between those that are fitted to.
HELD_OUT = 2
WEATHERS: Mapping[str, tuple[Weather, ...]] = {
    # The strengths of rain halls, which are stronger than most rain: drops are few.
    "rain": tuple(Rain(rate) for rate in (20.0, 40.0, 60.0, 100.0)),
    "fog": tuple(Fog(mor_m=mor) for mor in (200.0, 100.0, 70.0, 50.0)),
    "snow": tuple(Snow(rate) for rate in (0.5, 1.0, 1.5, 3.0)),
}
INTENSITY_NOISE = 0.03  # relative standard deviation of a beam's intensity from frame to frame; order of magnitude
MARGIN_DB = 1e-3  # what is reported stands above the threshold by its own signal, noise and all
FRAME_STEP_S = 0.1  # 10 Hz, the usual rate of scanning LiDAR


@dataclass(frozen=True)
class HiddenStudy:
    """A study and what is hidden in it.

    Args:
        study: whose conditions state the recorded weather.
        effects: that act in all frames of its conditions.
        weather_factor: condition to the true rate or visibility over the recorded one.
    """

    study: Study
    effects: tuple[Effect, ...]
    weather_factor: Mapping[str, float]

    def truth(self) -> dict[str, Any]:
        """Hidden effects, as JSON takes them."""
        return {
            "effects": [
                {
                    "name": effect.id,
                    "parameters": {name: _plain(value) for name, value in effect.config().items()},
                }
                for effect in self.effects
            ],
            "weather_factor": dict(self.weather_factor),
        }


@one_thread_an_operation()  # all arrays are small: torch's pool would wait longer than it works
def hidden_study(
    effects: Sequence[Effect] = (),
    weathers: Sequence[Weather] = WEATHERS["snow"],
    *,
    scene: str = "test-track",
    columns: int = 64,
    clear_frames: int = 8,
    frames: int = 6,
    rel_sd: float = 0.1,
    seed: int = 0,
) -> HiddenStudy:
    """A LiDAR study of an embedded scene in which effects are hidden: in every frame in weather, in no clear one.

    Frames of an Ouster OS1-128 of 64 rings whose intensities are reflectivities. Every frame starts from a clear one
    of its own: ranges with the sensor's noise, intensities with 3 % of it. The weather record is off: the true rate or
    visibility of a condition is the recorded one times ``exp(rel_sd n)``, n standard normal.

    Args:
        effects: of ``stages.EFFECTS`` for LiDAR, each kind once at most.
        weathers: as recorded, three or more, one condition each; the third is held out.
        scene: a name in ``torchweather.scenes.SCENES``.
        columns: of the scan, 16 or more; 64 are 4,096 beams, 256 are 16,384.
        clear_frames: 2 or more.
        frames: of each condition, 1 or more.
        rel_sd: stated relative standard deviation of the record, 0 or more.
        seed: of all noise, of the weather and of the error of the record; it does not depend on the effects.

    Returns:
        `HiddenStudy`. The geometry holds ``cos_incidence``.

    Example:
        >>> hidden = hidden_study([EFFECTS["lidar.window_loss"](loss_db=2.0)], columns=16, clear_frames=2, frames=1)
        >>> [(one.id, one.split) for one in hidden.study.conditions]
        [('snow-0.5', 'fit'), ('snow-1', 'fit'), ('snow-1.5', 'holdout'), ('snow-3', 'fit')]
        >>> hidden.truth()["effects"]
        [{'name': 'lidar.window_loss', 'parameters': {'loss_db': 2.0}}]
    """
    owner = "hidden_study"
    check_one_of("scene", scene, SCENES, owner=owner)
    check_at_least("weathers", len(weathers), HELD_OUT + 1, owner=owner)
    check_at_least("columns", columns, 16, owner=owner)
    check_at_least("clear_frames", clear_frames, 2, owner=owner)
    check_at_least("frames", frames, 1, owner=owner)
    check_at_least("rel_sd", rel_sd, 0.0, owner=owner)
    lidar = _sensor(columns)
    view = lidar_view(SCENES[scene](), lidar)
    names = [f"{weather.kind}-{float(weather.intensity):g}" for weather in weathers]
    factors = np.exp(rel_sd * _stream(seed, "record").standard_normal(len(weathers))).tolist()
    conditions = [
        {
            "id": name,
            "scene": scene,
            "weather": weather,
            "rel_sd": rel_sd,
            "frames": _weathered(view, lidar, _true(weather, factors[place]), effects, frames, place, seed),
            "time_s": [FRAME_STEP_S * number for number in range(frames)],
            "split": HOLDOUT if place == HELD_OUT else FIT,
        }
        for place, (name, weather) in enumerate(zip(names, weathers, strict=True))
    ]
    grid = (RINGS, columns)
    clear = _clear(view, lidar, clear_frames, "clear", seed)
    study = Study.from_arrays(
        sensor=lidar,
        beams={"direction": view.directions.reshape(*grid, 3).numpy()},
        scenes=[
            {
                "id": scene,
                "clear": _frames(*clear, grid),
                "geometry": {"cos_incidence": view.cos_incidence.reshape(grid).numpy()},
            }
        ],
        conditions=conditions,
    )
    return HiddenStudy(study, tuple(effects), dict(zip(names, factors, strict=True)))


@dataclass(frozen=True)
class Hideable:
    """An effect with the weather that shows it, and the span from which its parameters are drawn.

    Args:
        weather: a key of ``WEATHERS``.
        spans: parameter to its lowest and highest value; the others keep their defaults.
    """

    weather: str
    spans: Mapping[str, tuple[float, float]]


# About one to three times the catalogue's typical size. patchy_weather is left out: how much frames differ cannot be
# told from six of a condition.
HIDEABLE: Mapping[str, Hideable] = {
    "lidar.beam_divergence": Hideable("snow", {"extra_mrad": (1.0, 3.0)}),
    "lidar.isolated_return_filter": Hideable("snow", {"probability": (0.4, 0.95)}),
    "lidar.threshold_shift": Hideable("snow", {"shift_db": (1.5, 4.0)}),
    "lidar.window_loss": Hideable("rain", {"loss_db": (1.0, 4.0)}),
    "lidar.extinction_scale": Hideable("fog", {"factor": (1.4, 2.0)}),
    "lidar.wet_target": Hideable("rain", {"share": (0.2, 0.6)}),
    "lidar.blind_zone": Hideable("snow", {"range_m": (4.0, 7.0)}),
    "lidar.range_noise": Hideable("rain", {"std_m": (0.02, 0.08)}),
    "lidar.range_bias": Hideable("rain", {"offset_m": (0.03, 0.15)}),
    "lidar.limited_extent": Hideable("fog", {"extent_m": (7.0, 12.0)}),
    "lidar.last_return": Hideable("snow", {"probability": (0.4, 0.95)}),
    "lidar.static_structure": Hideable(
        "rain", {"azimuth_rad": (-math.pi, math.pi), "range_m": (6.0, 12.0), "width_rad": (0.15, 0.4)}
    ),
    "lidar.intensity_compression": Hideable("fog", {"exponent": (0.5, 0.8)}),
    "lidar.range_stretch": Hideable("fog", {"m_per_optical_depth": (0.05, 0.2)}),
    "lidar.crosstalk": Hideable("rain", {"probability": (0.01, 0.05)}),
    "lidar.particle_backscatter": Hideable("snow", {"gain_db": (-4.0, -2.0)}),
    "lidar.sector_loss": Hideable(
        "rain", {"azimuth_rad": (-math.pi, math.pi), "width_rad": (0.5, 1.0), "loss_db": (3.0, 8.0)}
    ),
    "lidar.spray": Hideable("rain", {"strength": (0.2, 0.8), "width_rad": (0.5, 1.0)}),
    "lidar.ring_gain": Hideable("rain", {"db_per_ring": (0.03, 0.08)}),
}


def drawn_effect(seed: int, *, allow_none: bool = True) -> tuple[Effect | None, str]:
    """An effect of ``HIDEABLE`` with its parameters, or none, drawn at random, and the weather that shows it.

    Args:
        seed: of the draw.
        allow_none: draw no effect as often as any one of them; ``False`` draws again until it is one.

    Example:
        >>> drawn_effect(2)
        (LidarWindowLoss(loss_db=2.490000009536743), 'rain')
        >>> drawn_effect(3)[0] is None, drawn_effect(3, allow_none=False)[0] is None
        (True, False)
    """
    draw = _stream(seed, "effect")
    choices: list[str | None] = [None, *HIDEABLE]
    name = choices[int(draw.integers(len(choices)))]
    while name is None and not allow_none:
        name = choices[int(draw.integers(len(choices)))]
    if name is None:
        return None, str(draw.choice(list(WEATHERS)))
    chosen = HIDEABLE[name]
    values = {parameter: float(f"{draw.uniform(*span):.3g}") for parameter, span in chosen.spans.items()}
    return EFFECTS[name](**values), chosen.weather


def drawn_study(seed: int, *, columns: int = 64, allow_none: bool = True) -> HiddenStudy:
    """A study in which an effect of `drawn_effect` is hidden, or none.

    Args:
        seed: of all that is drawn.
        columns: of the scan, as in `hidden_study`.
        allow_none: as in `drawn_effect`.
    """
    effect, weather = drawn_effect(seed, allow_none=allow_none)
    return hidden_study([] if effect is None else [effect], WEATHERS[weather], columns=columns, seed=seed)


# ---- frames ----------------------------------------------------------------------------------------------------------


def _stream(seed: int, name: str) -> np.random.Generator:
    return keyed_stream(seed, f"gap.hidden_study.{name}")


def _sensor(columns: int) -> Lidar:
    whole = Lidar.preset("ouster-os1-128")
    rings, offsets = whole.elevations_deg, whole.azimuth_offsets_deg
    assert rings is not None  # every preset has its pattern
    assert offsets is not None
    step = len(rings) // RINGS
    return replace(
        whole,
        elevations_deg=rings[::step],
        azimuth_offsets_deg=offsets[::step],
        origin_heights_m=None,
        columns=columns,
        intensity_unit="reflectivity",  # fine enough to carry noise
        margin_db=MARGIN_DB,
    )


def _plain(value: float) -> float | str:
    """A single-precision number by the digits that it has; infinities as text."""
    return float(f"{value:.6g}") if math.isfinite(value) else str(value)


def _true(weather: Weather, factor: float) -> Weather:
    changed: Weather = replace(weather, **{weather.intensity_name: float(weather.intensity) * factor})  # type: ignore[type-var]
    return changed


def _clear(view: LidarView, lidar: Lidar, frames: int, name: str, seed: int) -> tuple[Tensor, Tensor]:
    """Ranges and intensities ``(F, N)`` in clear air, noise of their own in each frame; 0 where no return.

    A return whose signal, noise and all, lies below the threshold is none.
    """
    noise = _stream(seed, f"noise.{name}").standard_normal((2, frames, len(view.points)), dtype=np.float32)
    range_noise, intensity_noise = torch.from_numpy(noise)
    range_m = torch.linalg.vector_norm(view.points[:, :3], dim=-1) + lidar.range_noise_m * range_noise
    range_m = torch.round(range_m / lidar.range_resolution_m) * lidar.range_resolution_m
    intensity = view.points[:, 3] * torch.exp(INTENSITY_NOISE * intensity_noise)
    energy = ToEnergy(lidar)
    strong = energy.signal_of_intensity(intensity, range_m) >= energy.beam.threshold
    seen = view.hit & (strong | (range_m < lidar.near_start_m))  # the detection lets through what is near
    return torch.where(seen, range_m, 0.0), torch.where(seen, intensity, 0.0)


def _weathered(
    view: LidarView, lidar: Lidar, weather: Weather, effects: Sequence[Effect], frames: int, place: int, seed: int
) -> list[Frame]:
    """Frames of a condition: clear ones, through the chain with the effects."""
    assert view.grid is not None
    range_m, intensity = _clear(view, lidar, frames, f"condition-{place}", seed)
    transform = LidarWeather(weather, lidar, effects=effects, beam_ends="max_range")
    points = torch.cat([view.directions * range_m[..., None], intensity[..., None]], -1)
    state = transform.state_of(points, view.directions).changed(cos_incidence=view.cos_incidence[None])
    seeds = torch.from_numpy(_stream(seed, f"weather.{place}").integers(2**62, size=frames))
    with torch.no_grad():
        out = transform.chain(state, transform.chain.draw(state, seed=seeds)).returns.points
    found = torch.linalg.vector_norm(out[..., :3], dim=-1)
    return _frames(found, out[..., 3] * (found > 0), view.grid)


def _frames(range_m: Tensor, intensity: Tensor, grid: tuple[int, int]) -> list[Frame]:
    pairs = zip(range_m, intensity, strict=True)
    return [{"range_m": r.reshape(grid).numpy(), "intensity": i.reshape(grid).numpy()} for r, i in pairs]
