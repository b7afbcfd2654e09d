"""Radiance of fog lit by a low beam: paths of light, each of which sees the lamp along all of its rays.

    python -m tests.reference.headlamp_veil        # 8 minutes; writes tests/oracles/headlamp_veil.json

`fog_photons.lamp_radiance` looks at the lamp from the places of scattering alone, and its mean has a long tail: in fog
of 20 m 1.4 million photons give 0.404 +- 0.017, 6.6 million 0.463 +- 0.037. Here the lamp's light is summed along each
ray: with h the distance of the ray from the lamp, ``dt / d^2 = d theta / h``, and the scattering angle theta is drawn
by half from the phase function and by half evenly. The phase function of that last scattering is blurred by 1 degree,
as of a lamp of that size. The tail is shorter, not gone: 0.2 million paths gave 0.363 +- 0.016 (blur of 2 degrees
0.368), the 2 million of the file 0.420 +- 0.021. So the errors are lower bounds.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

import torchweather as tw
from tests.reference import fog_photons
from tests.reference.fog_photons import Array
from torchweather.camera.night.lamps import beam_share, own_headlamps
from torchweather.physics import extinction_per_m

FILE = Path(__file__).parents[1] / "oracles" / "headlamp_veil.json"
NM, HEIGHT_M, ORDERS, NEAREST_M, PER_RAY = 530.0, 1.4, 30, 0.5, 4
RUNS, PATHS, BLUR_DEG = 50, 40_000, 1.0


def blurred(per_sr: Callable[[Array], Array], deviation_rad: float) -> tuple[Array, Array]:
    """Angles and a phase function of the cosine, convolved with a Gaussian on the sphere."""
    theta = np.concatenate([np.linspace(0.0, 0.3, 601), np.linspace(0.301, math.pi, 1500)])
    off = deviation_rad * np.sqrt(-2.0 * np.log1p(-(np.arange(48) + 0.5) / 48))
    around = 2.0 * math.pi * (np.arange(32) + 0.5) / 32
    across = np.sin(theta)[:, None, None] * np.sin(off)[:, None] * np.cos(around)
    return theta, per_sr(np.cos(theta)[:, None, None] * np.cos(off)[:, None] + across).mean((1, 2))


def traced(mor_m: float, paths: int, seed: int) -> float:
    """Radiance on the axis of a camera, cd/m2, of the left low beam in fog above a black road."""
    left, _ = own_headlamps()
    distribution = tw.Fog(mor_m).distribution(mor_m)
    angles, per_sr = fog_photons.scattering_angles(distribution, NM), fog_photons.phase_of_cosine(distribution, NM)
    theta, phase = blurred(per_sr, math.radians(BLUR_DEG))
    upto = np.concatenate([[0.0], np.cumsum(0.5 * (phase[1:] + phase[:-1]) * np.diff(theta))])
    extinction = float(extinction_per_m(distribution, NM))
    lamp_m = np.array(left.position_m) - [0.0, 0.0, HEIGHT_M]
    reach_m = 20.0 / extinction + 5.0 * float(np.linalg.norm(lamp_m))
    random = np.random.default_rng(seed)
    direction, place, total = np.tile([1.0, 0.0, 0.0], (paths, 1)), np.zeros((paths, 3)), 0.0
    for _ in range(ORDERS):
        foot = ((lamp_m - place) * direction).sum(1)
        h = np.maximum(np.linalg.norm(place + foot[:, None] * direction - lamp_m, axis=1), 1e-6)
        first = math.pi - np.arctan2(h, -foot)  # the angle of scattering at the ray's beginning; at its end it is pi
        below = np.interp(first, theta, upto)
        with np.errstate(divide="ignore"):
            road_m = np.where(direction[:, 2] < 0, (-HEIGHT_M - place[:, 2]) / direction[:, 2], math.inf)
        for draw in range(PER_RAY):
            u = random.random(len(place))
            even, by_phase = first + u * (math.pi - first), np.interp(below + u * (upto[-1] - below), upto, theta)
            angle = np.clip(by_phase if draw % 2 else even, first, math.pi - 1e-9)
            value = np.interp(angle, theta, phase)
            density = 0.5 * value / np.maximum(upto[-1] - below, 1e-30) + 0.5 / np.maximum(math.pi - first, 1e-30)
            along, distance = foot - h / np.tan(angle), h / np.sin(angle)
            unit = (place + along[:, None] * direction - lamp_m) / distance[:, None]
            azimuth, elevation = np.arctan2(unit[:, 1], unit[:, 0]), np.arcsin(unit[:, 2].clip(-1.0, 1.0))
            share = beam_share("low_beam", torch.from_numpy(azimuth), torch.from_numpy(elevation)).numpy()
            light = value * share * np.exp(-extinction * (np.maximum(along, 0.0) + distance)) / (h * density)
            light *= np.minimum(1.0, distance / NEAREST_M) ** 2
            total += float(light[(along >= -1e-9) & (along < road_m)].sum())
        place = place + direction * (random.exponential(size=len(place)) / extinction)[:, None]
        inside = (np.abs(place) < reach_m).all(1) & (place[:, 2] > -HEIGHT_M)
        place, direction = place[inside], direction[inside]
        if not len(place):
            break
        turn = angles(random.random(len(place))), 2.0 * math.pi * random.random(len(place))
        direction = fog_photons.turned(direction, *turn)
    return left.intensity_cd * extinction * total / (paths * PER_RAY)


def main() -> None:
    """Trace and write."""
    found = []
    for mor_m in (20.0, 50.0):
        values = np.array([traced(mor_m, PATHS, seed) for seed in range(RUNS)])
        error = float(values.std(ddof=1) / math.sqrt(RUNS))
        found.append({"mor_m": mor_m, "radiance": round(float(values.mean()), 5), "error": round(error, 5)})
        print(found[-1], flush=True)
    FILE.write_text(json.dumps({"paths": RUNS * PATHS, "veils": found}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
