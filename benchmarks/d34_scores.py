"""D3.4's published scores beside the same scores simulated in scenes of their size, and what moves the simulated ones.

    python benchmarks/d34_scores.py --out benchmarks/d34_scores.json

ROADVIEW D3.4 prints scores of measured frames against clear ones (appendix 10.1.1, 10.1.2, 10.2.1, 10.2.2, 10.3.1,
10.3.2) and of its own models (10.1.7, 10.1.8, 10.2.6, 10.2.7, 10.3.4, 10.3.5). Each printed condition of rain and fog
is simulated in the hall or tunnel that it comes from, with its target at its distance. Fixed before any figure was
looked at:

- the score of a condition is the mean over ``SEEDS``;
- "as recorded" is what stands beside the measured score: clear and weathered frame have noise of their own, a camera
  keeps its mean brightness, rain falls in the sprinkled lane alone; window and surfaces are dry;
- a cloud is all returns of the sweep; of a radar all detections of a frame, rain in the whole hall;
- every other variant changes one thing of "as recorded", but for ``plain`` (weather on the very frame that it is
  compared with, everywhere) and ``clear`` (two clear frames);
- added after a first look: the two variants on an open track (where REHEARSE-3D's authors say that the rain was
  recorded), a window loss of 10 dB, the small drops among "all together"; of the camera the turn by 1 degree, the
  darker frames, multiple scattering and three changes at once;
- a table's ratio is the mean of the simulated over the mean of the measured scores; that of PSNR is one of root mean
  square errors, measured over simulated, so that above 1 means a closer picture for it as for the others.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import torch
from measure import hand_over, machine
from torch import Tensor

import torchweather as tw
from torchweather.camera.bayer import colour_means
from torchweather.camera.effects.all import CameraAdherentDrops
from torchweather.lidar.effects.all import LidarLimitedExtent, LidarWindowLoss
from torchweather.metrics import bayer_scores, cloud_scores
from torchweather.metrics.d34 import PublishedScore, published_scores
from torchweather.physics import Binned, fall_speed_after_m_per_s, marshall_palmer, rain_fall_speed_m_per_s
from torchweather.physics.precipitation_rate import precipitation_rate_mm_per_h
from torchweather.radar import FmcwRadar
from torchweather.scenes import (
    THI_RAIN_FIELD,
    Scene,
    SceneLabel,
    cerema_tunnel,
    lidar_view,
    radar_view,
    test_track,
    thi_hall,
)
from torchweather.scenes.lidar_view import ROOF_MOUNT_M
from torchweather.scenes.materials import Material
from torchweather.scenes.scene import Part

SEEDS = {"camera": (1, 2), "lidar": (1, 2, 3), "radar": (1, 2, 3)}
CAMERA_PX = (968, 732)  # half of the Lucid Triton in each direction
MEASURED = {"camera": ("10.1.1", "10.1.2"), "lidar": ("10.2.1", "10.2.2"), "radar": ("10.3.1", "10.3.2")}
MODELLED = {"camera": ("10.1.7", "10.1.8"), "lidar": ("10.2.6", "10.2.7"), "radar": ("10.3.4", "10.3.5")}
FULL_WELL, READ = 10_000.0, 4.0  # electrons; those of the embedded scenes
DIM = 16.0  # a frame of a dim hall has this factor less light for the same signal
TURN_DEG, FAR_TURN_DEG = 0.1, 1.0  # of the camera between the two recordings
STOPS = 2.0  # by which both frames are darker
NOZZLE_FALL_M = THI_RAIN_FIELD.high_m[2] - ROOF_MOUNT_M[2]
EXTENTS = 12  # groups of beams of alike way through the rain field


@dataclass(frozen=True)
class Condition:
    """One printed condition: a weather, a target, a distance."""

    sensor: str
    weather: str
    target: str
    distance_m: float
    severity: float
    label: str

    @property
    def air(self) -> tw.Rain | tw.Fog:
        """The weather."""
        return tw.Rain(self.severity) if self.weather == "rain" else tw.Fog(mor_m=-self.severity)

    def scene(self, **more: Any) -> Scene:
        """The hall or tunnel."""
        if self.weather == "rain":
            return thi_hall(self.target, self.distance_m, **more)
        return cerema_tunnel(self.target, self.distance_m)


def kind(target: str) -> str:
    return "car" if target == "Car" else "pedestrian" if target.startswith("Pedestrian") else "boards"


def printed(sections: tuple[str, ...]) -> dict[Condition, dict[str, float]]:
    """Scores of the appendix by condition."""
    found: dict[Condition, dict[str, float]] = {}
    for score in published_scores():
        if score.appendix in sections:
            found.setdefault(condition_of(score), {})[name_of(score.metric)] = score.value
    return found


def condition_of(score: PublishedScore) -> Condition:
    severity = abs(score.severity) * (1.0 if score.weather == "rain" else -1.0)
    return Condition(
        score.sensor.removesuffix("4d"),
        score.weather,
        kind(score.target),
        float(score.distance_m),
        severity,
        f"{score.condition}",
    )


def name_of(metric: str) -> str:
    return metric.lower().replace("-", "_").replace("haar_psi", "haarpsi")


# ---- camera


def noisy(signal: Tensor, seed: int, light: float) -> Tensor:
    """Shot and readout noise of a frame with ``light`` of the full well's electrons at saturation."""
    drawn = torch.randn(signal.shape, generator=torch.Generator().manual_seed(seed))
    well = FULL_WELL * light
    return (signal + (signal / well + (READ / well) ** 2).sqrt() * drawn).clamp(0, 1)


class CameraCase:
    """Simulated frames of one condition."""

    def __init__(self, condition: Condition) -> None:
        self.condition, self.scene = condition, condition.scene()
        self.camera = replace(tw.Camera.preset("lucid-triton").resized(*CAMERA_PX), response_knots=None)
        self.view = self.scene.view(self.camera)
        bright = (self.view.label == SceneLabel.ROOF) | (self.view.label == SceneLabel.WALL)
        self.airlight = tuple(float(v) for v in colour_means(self.view.bayer, self.camera.bayer_pattern, mask=bright))

    def score(self, distorted: Tensor, reference: Tensor) -> dict[str, float]:
        found = bayer_scores(distorted, reference, pattern=self.camera.bayer_pattern)
        swapped = bayer_scores(reference, distorted, ["vif"], pattern=self.camera.bayer_pattern)
        return {name: float(value) for name, value in found.items()} | {"vif_swapped": float(swapped["vif"])}

    def weathered(self, seed: int, *, turned_deg: float = 0.0, **options: Any) -> Tensor:
        camera, view = self.camera, self.view
        if turned_deg:
            camera = replace(camera, pitch_rad=camera.pitch_rad + math.radians(turned_deg))
            view = self.scene.view(camera)
        transform = tw.BayerWeather(self.condition.air, camera, airlight=self.airlight, **options)
        found: Tensor = transform(view.bayer, view.depth_m, seed=seed)
        return found

    def variants(self, seed: int) -> dict[str, dict[str, float]]:
        clear, kept = self.view.bayer, {"exposure_control": "mean"}

        def pair(distorted: Tensor, light: float = 1.0, darker: float = 1.0) -> dict[str, float]:
            frames = (noisy(one / darker, 2 * seed + k, light) for k, one in enumerate((distorted, clear)))
            return self.score(*frames)

        found = {
            "plain": self.score(self.weathered(seed), clear),
            "clear": pair(clear),
            "as recorded": pair(self.weathered(seed, **kept)),
            "exposure not controlled": pair(self.weathered(seed)),
            "both frames two stops darker": pair(self.weathered(seed, **kept), darker=2.0**STOPS),
            "camera turned by 0.1 degrees": pair(self.weathered(seed, turned_deg=TURN_DEG, **kept)),
            "camera turned by 1 degree": pair(self.weathered(seed, turned_deg=FAR_TURN_DEG, **kept)),
            "a sixteenth of the light": pair(self.weathered(seed, **kept), 1.0 / DIM),
        }
        if self.condition.weather == "fog":
            found["light scattered more than once"] = pair(self.weathered(seed, scattering="multiple", **kept))
        if self.condition.weather == "rain":
            drops = [CameraAdherentDrops(cover=0.2)]
            wet = self.weathered(seed, effects=drops, **kept)
            all_of_them = self.weathered(seed, turned_deg=FAR_TURN_DEG, effects=drops, **kept)
            found["drops on 20 % of the window"] = pair(wet)
            found["turned by 1 degree, drops, a sixteenth of the light"] = pair(all_of_them, 1.0 / DIM)
        return found


# ---- LiDAR


def drops_of(diameter_mm: float) -> Binned:
    """Drops of one size, a tenth of it wide."""
    return Binned([0.95 * diameter_mm, 1.05 * diameter_mm], [1.0])


def falling_drops(rate_mm_per_h: float, fall_m: float) -> tw.Rain:
    """Marshall and Palmer's sizes with the flux of the rate, fallen from rest over a height, not at terminal speed.

    As many drops cross the level, so their density is higher by ``v_t / v``.
    """
    edges = torch.logspace(math.log10(0.1), math.log10(8.0), 61, dtype=torch.float64)
    middle = (edges[1:] * edges[:-1]).sqrt()
    terminal = rain_fall_speed_m_per_s(middle)
    slower = fall_speed_after_m_per_s(terminal, fall_m) / terminal
    density = marshall_palmer(rate_mm_per_h).number_density_per_m3_mm(middle)
    full = Binned(edges, density)
    density = density * rate_mm_per_h / precipitation_rate_mm_per_h(full)
    thick = Binned(edges, density / slower)
    return tw.Rain(float(precipitation_rate_mm_per_h(thick)), size_distribution=thick)


def wet_floor(scene: Scene, share: float) -> Scene:
    """The scene with a film of water on its floor: that share of the light is mirrored away from the sensor."""

    def wet(part: Part) -> Part:
        dry = part.surface
        infrared = dry.near_infrared or (sum(dry.rgb) / 3,) * 2
        darker: Material = replace(dry, near_infrared=(infrared[0] * (1 - share), infrared[1] * (1 - share)))
        return Part(part.shape, darker)

    low = (SceneLabel.FLOOR, SceneLabel.LANE_MARKING)
    return replace(
        scene,
        objects=tuple(
            replace(thing, parts=tuple(map(wet, thing.parts))) if thing.label in low else thing
            for thing in scene.objects
        ),
    )


def returns(points: Tensor) -> Tensor:
    return points[(points[:, :3] != 0).any(-1)][:, :3]


class LidarCase:
    """Simulated sweeps of one condition."""

    def __init__(self, condition: Condition) -> None:
        self.condition = condition
        self.lidar = tw.Lidar.preset("ouster-os1-128")

    def scan(self, seed: int, scene: Scene | None = None, lidar: tw.Lidar | None = None) -> tuple[Tensor, Tensor]:
        view = lidar_view(scene or self.condition.scene(), lidar or self.lidar, range_noise_seed=seed)
        return view.points, view.directions

    def weathered(
        self,
        seed: int,
        *,
        scene: Scene | None = None,
        scan_seed: int | None = None,
        everywhere: bool = False,
        air: tw.Rain | tw.Fog | None = None,
        lidar: tw.Lidar | None = None,
        effects: tuple[Any, ...] = (),
        **options: Any,
    ) -> Tensor:
        """Returns of a sweep in the weather."""
        sensor, air = lidar or self.lidar, air or self.condition.air
        points, beams = self.scan(2 * seed + 1 if scan_seed is None else scan_seed, scene, sensor)
        if everywhere or self.condition.weather == "fog":
            model = tw.LidarWeather(air, sensor, effects=effects, **options)
            return returns(model(points, directions=beams, seed=seed))
        leave = THI_RAIN_FIELD.crossing_m(ROOF_MOUNT_M, beams)[1]
        group = torch.bucketize(leave, torch.quantile(leave, torch.linspace(0, 1, EXTENTS + 1)[1:-1]))
        parts = []
        for one in range(EXTENTS):
            here = group == one
            if bool(here.any()):
                extent = LidarLimitedExtent(extent_m=float(leave[here].mean()))
                model = tw.LidarWeather(air, sensor, effects=(extent, *effects), **options)
                parts.append(model(points[here], directions=beams[here], seed=1000 * seed + one))
        return returns(torch.cat(parts))

    def variants(self, seed: int) -> dict[str, dict[str, float]]:
        reference = returns(self.scan(2 * seed)[0])

        def score(distorted: Tensor, to: Tensor | None = None) -> dict[str, float]:
            found = cloud_scores(distorted, reference if to is None else to)
            return {name: float(value) for name, value in found.items()}

        def thinned(cloud: Tensor, share: float) -> Tensor:
            kept = torch.rand(len(cloud), generator=torch.Generator().manual_seed(seed)) >= share
            return cloud[kept]

        near = replace(self.lidar, near_start_m=0.5, near_full_m=2.0)
        as_recorded = self.weathered(seed)
        clear = returns(self.scan(2 * seed + 1)[0])
        found = {
            "plain": score(self.weathered(seed, scan_seed=2 * seed, everywhere=True)),
            "clear": score(clear),
            "clear, 5 % of the returns missing": score(thinned(clear, 0.05)),
            "as recorded": score(as_recorded),
            "window loses 3 dB": score(self.weathered(seed, effects=(LidarWindowLoss(loss_db=3.0),))),
            "window loses 6 dB": score(self.weathered(seed, effects=(LidarWindowLoss(loss_db=6.0),))),
            "window loses 10 dB": score(self.weathered(seed, effects=(LidarWindowLoss(loss_db=10.0),))),
            "receiver sees fully from 2 m": score(self.weathered(seed, lidar=near)),
        }
        if self.condition.weather == "fog":
            return found
        dry, rate = self.condition.scene(), self.condition.severity
        found |= {
            "rain in the whole hall": score(self.weathered(seed, everywhere=True)),
            "drops not at terminal speed": score(self.weathered(seed, air=falling_drops(rate, NOZZLE_FALL_M))),
            "drops of 0.5 mm": score(self.weathered(seed, air=tw.Rain(rate, size_distribution=drops_of(0.5)))),
            "drops of 3 mm": score(self.weathered(seed, air=tw.Rain(rate, size_distribution=drops_of(3.0)))),
            "drops of backscatter efficiency 0.6": score(self.weathered(seed, q_back=0.6)),
            "floor returns half": score(self.weathered(seed, scene=wet_floor(dry, 0.5))),
            "floor returns a tenth": score(self.weathered(seed, scene=wet_floor(dry, 0.9))),
            "masts of sprinklers": score(self.weathered(seed, scene=self.condition.scene(masts=True))),
            "all together": score(
                self.weathered(
                    seed,
                    scene=wet_floor(self.condition.scene(masts=True), 0.9),
                    lidar=near,
                    air=tw.Rain(rate, size_distribution=drops_of(0.5)),
                    effects=(LidarWindowLoss(loss_db=6.0),),
                )
            ),
        }
        track = test_track()
        open_air = returns(self.scan(2 * seed, track)[0])
        loss = (LidarWindowLoss(loss_db=6.0),)
        found |= {
            "open track": score(self.weathered(seed, scene=track), open_air),
            "open track, window loses 6 dB": score(self.weathered(seed, scene=track, effects=loss), open_air),
        }
        return found


# ---- radar


class RadarCase:
    """One condition of an imaging radar at 77 GHz; which radar was recorded is not published."""

    def __init__(self, condition: Condition) -> None:
        self.condition = condition
        self.radar = tw.Radar.preset("imaging-77ghz")
        self.scatterers = radar_view(condition.scene(), self.radar).scatterers

    def frame(self, seed: int, air: tw.Rain | tw.Fog | None = None, **options: Any) -> Tensor:
        """Detections of one frame."""
        simulator = FmcwRadar(self.radar, air, **options)
        return simulator(self.scatterers, simulator.draw(self.scatterers, seed=seed))

    def variants(self, seed: int) -> dict[str, dict[str, float]]:
        reference, air = self.frame(2 * seed), self.condition.air
        frames = {
            "plain": self.frame(2 * seed, air),
            "clear": self.frame(2 * seed + 1),
            "as recorded": self.frame(2 * seed + 1, air),
            "without echoes of drops": self.frame(2 * seed + 1, air, clutter=False),
            "radome loses 6 dB": self.frame(2 * seed + 1, air, radome_loss_db=6.0),
        }
        return {
            name: {"detections": float(len(frame)), **{k: float(v) for k, v in cloud_scores(frame, reference).items()}}
            for name, frame in frames.items()
        }


CASES: Mapping[str, Callable[[Condition], CameraCase | LidarCase | RadarCase]] = {
    "camera": CameraCase,
    "lidar": LidarCase,
    "radar": RadarCase,
}


def simulated(condition: Condition, seeds: tuple[int, ...]) -> dict[str, dict[str, float]]:
    """Mean score over the seeds, by variant and score."""
    case = CASES[condition.sensor](condition)
    runs = [case.variants(seed) for seed in seeds]
    return {
        variant: {name: sum(run[variant][name] for run in runs) / len(runs) for name in runs[0][variant]}
        for variant in runs[0]
    }


def row_of(condition: Condition, seeds: tuple[int, ...]) -> dict[str, Any]:
    """Measured, modelled and simulated scores of one condition."""
    torch.set_num_threads(1)
    return {
        **{name: getattr(condition, name) for name in ("sensor", "weather", "target", "distance_m")},
        "condition": condition.label,
        "severity": condition.severity,
        "measured": printed(MEASURED[condition.sensor])[condition],
        "d34_model": printed(MODELLED[condition.sensor]).get(condition, {}),  # of radar not every target
        "simulated": simulated(condition, seeds),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sensors", nargs="+", choices=tuple(CASES), default=tuple(CASES))
    parser.add_argument("--seeds", type=int, default=3, help="how many of the seeds at most")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--out", type=Path, help="JSON file")
    args = parser.parse_args()
    jobs = [
        (condition, SEEDS[sensor][: args.seeds]) for sensor in args.sensors for condition in printed(MEASURED[sensor])
    ]
    with ProcessPoolExecutor(args.workers, mp_context=get_context("spawn")) as pool:
        rows = list(pool.map(row_of, *zip(*jobs, strict=True)))
    hand_over({"machine": machine(), "camera_px": CAMERA_PX, "seeds": SEEDS, "rows": rows}, args.out)


if __name__ == "__main__":
    main()
