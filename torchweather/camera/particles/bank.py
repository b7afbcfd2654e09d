"""DrawBank: rendered optical depth of rain or snow, from which training frames are composed by look-ups.

The optical depth of independent storms adds, and a pixel takes the particles nearer than its depth. The bank holds
storms of half of the particles each, at rates that rise by a factor of 1.4, as cumulative optical depth up to some
depths, on a torus of pixels. A sample adds two storms, each displaced by a number of pixels of its own and mirrored or
not. Between the depths and rates of the bank the optical depth is ``a tau + b``: ``a`` gives it the standard deviation,
then ``b >= 0`` the mean transmission of the exact path. The layer is the one in front of the pixel's depth, so that no
particle shows through a surface.
"""

from __future__ import annotations

import json
import math
import os
import warnings
from collections import OrderedDict
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchweather.atmosphere.weather import Rain, Snow, weather_from_dict
from torchweather.camera.particles.bank_codes import (
    AMPLITUDES,
    BIN_SHIFT,
    BankTables,
    amplitude_of,
    between,
    decoded_codes,
    depth_bins,
    encoded,
)
from torchweather.camera.particles.bank_render import storm_layers
from torchweather.camera.particles.population import RATE_CAPACITY_MM_PER_H, Population
from torchweather.camera.particles.tables import MarkOptics, particle_tables
from torchweather.camera.sensor import Camera
from torchweather.core.archives import read_archive, write_archive
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import (
    InputValueError,
    TorchweatherError,
    TorchweatherWarning,
    check_at_least,
    check_between,
)
from torchweather.core.random import Variate
from torchweather.core.threads import one_thread_an_operation

__all__ = ["STORMS", "DrawBank"]

FORMAT = "torchweather-bank/1"
STORMS = 2  # of half of the particles each, which a sample adds
# Of neighbouring rates: half a step of 1.4 changes the standard deviation by 8 %; larger frames take larger steps.
RATE_RATIOS = (1.4, 1.7, 2.0)
RATE_RANGE = 50.0  # over which all rates fit into the memory
ENOUGH_LAYERS = 5
MOST_LAYERS = 15
MOST_BYTES = 200_000_000
FEWEST_LAYERS = 3
SMALLEST_TORUS_PX = 256
LOWEST_MM_PER_H = 0.1  # below, marks are fainter instead of fewer
LAST_LAYER = 0.97  # of the standard deviation at the far limit
MOST_BANKS = 4  # of cameras and weathers, kept in a process


class DrawBank:
    """A store of rendered optical depth of rain or snow for one camera: training weather by look-ups.

    Rendered at the first use of each rate, or ahead by `prepare`; written to a file by `save` and read by `load`. The
    codes lie in shared memory: workers that are forked or spawned after ``prepare`` share them.

    Statistics over many samples are those of the exact path: mean transmission within 1 %, standard deviation of the
    covered share within 5 %, correlation of neighbouring pixels within 0.05 and the 99.9 % quantile within 10 %, for
    frames up to 1242 x 375 and scenes beyond twice ``near_m``. Nearer scenes get the mean alone. Rates below 0.1 mm/h
    get fainter marks instead of fewer.

    Args:
        weather: ``Rain`` or ``Snow``, or ``"rain"`` or ``"snow"``; the rate does not matter.
        camera: that takes the frames; its size is the frames' size.
        near_m, far_m, min_listed_coverage, max_listed_density: as of `BayerWeather`.
        rate_capacity_mm_per_h: highest rate. Default: 100 mm/h for rain, 10 mm/h for snow.
        seed: of the storms.
        most_bytes: of the codes, 1e6 to 2e9. The number of layers follows from it and from the frame's size; rates
            that were not used for the longest time are dropped.

    Raises:
        ValueError: the camera is pitched, its lens distorts, the wind blows along its axis, or the weather has gusts:
            streaks would then depend on their place in the frame, and a storm cannot be displaced.

    Example:
        >>> from torchweather.sensors import Camera
        >>> bank = DrawBank("rain", Camera.from_intrinsics(100, 100, 15.5, 11.5, 32, 24))
        >>> place = torch.tensor([[0.1, 0.7, 0.2], [0.6, 0.3, 0.9]])
        >>> bank.optical_depth(torch.full((24, 32), 40.0), 25.0, place).shape
        torch.Size([24, 32])
    """

    def __init__(
        self,
        weather: Rain | Snow | str,
        camera: Camera,
        *,
        near_m: float = 0.5,
        far_m: float = 200.0,
        min_listed_coverage: float = 1 / 1024,
        max_listed_density: float = 0.25,
        rate_capacity_mm_per_h: float | None = None,
        seed: int = 0,
        most_bytes: int = MOST_BYTES,
    ) -> None:
        check_arguments(
            "DrawBank(weather: Rain | Snow | str, camera: Camera, near_m: float, far_m: float, "
            "min_listed_coverage: float, max_listed_density: float, rate_capacity_mm_per_h: float | None, seed: int, "
            "most_bytes: int)",
            weather,
            camera,
            near_m,
            far_m,
            min_listed_coverage,
            max_listed_density,
            rate_capacity_mm_per_h,
            seed,
            most_bytes,
        )
        check_between("most_bytes", most_bytes, 1e6, 2e9, owner=self)
        check_at_least("near_m", near_m, 1e-2, unit="m", owner=self)
        check_at_least("far_m", far_m, 8 * near_m, unit="m", owner=self)
        if isinstance(weather, str):
            if weather not in RATE_CAPACITY_MM_PER_H:
                raise InputValueError(f"DrawBank: weather must be rain or snow; got {weather!r}. Fog needs no bank.")
            weather = Rain(1.0) if weather == "rain" else Snow(1.0)
        drawn: Any = weather.densest()
        self.weather: Rain | Snow = replace(drawn, rate_mm_per_h=1.0)
        self.camera, self.seed, self.most_bytes = camera, int(seed), int(most_bytes)
        self.near_m, self.far_m = float(near_m), float(far_m)
        self.rate_capacity_mm_per_h = float(rate_capacity_mm_per_h or RATE_CAPACITY_MM_PER_H[weather.kind])
        self.min_listed_coverage, self.max_listed_density = float(min_listed_coverage), float(max_listed_density)
        self._refuse_what_is_not_displaced()
        self._set_up()
        self._codes: OrderedDict[int, Tensor] = OrderedDict()  # of each rate, (storms, layers * H * W) uint8
        # Of each rate the optical depth of the mean transmission and the variance of the covered share,
        # (2, storms, layers, amplitudes).
        self._covered: dict[int, Tensor] = {}

    @classmethod
    def shared(cls, weather: Rain | Snow, camera: Camera, **values: Any) -> DrawBank:
        """The bank of this process with these arguments: made at first use, and the one that a worker was handed."""
        bank = cls(weather, camera, **values)
        return bank._enter()

    def _enter(self) -> DrawBank:
        """The bank of this process that is the same, which is this one unless there is one."""
        key = json.dumps(self.config(), sort_keys=True)
        kept = _KEPT.setdefault(key, self)
        _KEPT.move_to_end(key)
        while len(_KEPT) > MOST_BANKS:
            _KEPT.popitem(last=False)
        return kept

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._enter()

    def _refuse_what_is_not_displaced(self) -> None:
        drift = np.array(self.camera.camera_from_vehicle()) @ np.array(self.weather.wind_m_per_s)
        reason = ""
        if self.camera.distorted:
            reason = "the lens distorts (k1, k2, p1, p2, k3)"
        elif abs(self.camera.down_direction()[2]) > 1e-9:
            reason = f"the camera is pitched by {self.camera.pitch_rad:g} rad"
        elif abs(drift[2]) > 1e-9:
            reason = f"the wind blows along the camera's axis at {drift[2]:g} m/s"
        elif self.weather.patch_log_std:
            reason = f"the weather has gusts (patch_log_std={self.weather.patch_log_std:g})"
        if reason:
            raise InputValueError(
                f'DrawBank: expected streaks that are alike everywhere in the frame; {reason}. Use quality="exact".'
            )
        # A mirrored storm is as likely as itself where particles fall straight down the image.
        self.mirrors = abs(self.camera.down_direction()[0]) < 1e-9 and abs(drift[0]) < 1e-9

    def _set_up(self) -> None:
        """Depths of the layers and what each bin of depth takes from them."""
        self.size = (max(self.camera.height, SMALLEST_TORUS_PX), max(self.camera.width, SMALLEST_TORUS_PX))
        self.focal_px = math.sqrt(self.camera.fx * self.camera.fy)
        self.first_bin = int(np.float32(self.near_m).view(np.int32)) >> BIN_SHIFT
        self.bins = (int(np.float32(self.far_m).view(np.int32)) >> BIN_SHIFT) - self.first_bin + 1
        edges = ((np.arange(self.bins + 1) + self.first_bin).astype(np.int32) << BIN_SHIFT).view(np.float32)
        edges = edges.astype(np.float64)
        self.middle_m = np.clip(0.5 * (edges[:-1] + edges[1:]), self.near_m, self.far_m)
        self._tabulate_moments()
        x, y, _ = self.camera.ray_directions()
        self._mean_ray = float(torch.sqrt(1 + x.square() + y.square()).mean())
        whole = math.floor(self.most_bytes / (self.size[0] * self.size[1] * STORMS))  # layers of all rates
        for self.rate_ratio in RATE_RATIOS:
            rates = math.ceil(math.log(RATE_RANGE) / math.log(self.rate_ratio)) + 2
            self.layers = min(MOST_LAYERS, whole // rates)
            if self.layers >= ENOUGH_LAYERS:
                break
        self.layers = max(self.layers, FEWEST_LAYERS)
        self.most_rates = whole // self.layers
        if self.most_rates < 2:
            raise InputValueError(
                f"DrawBank: most_bytes={self.most_bytes:g} holds no two rates of {self.size[1]} x {self.size[0]} px; "
                f"give {2 * FEWEST_LAYERS * STORMS * self.size[0] * self.size[1]:.3g} or more, or smaller frames."
            )
        _, variance = self._moments(math.sqrt(LOWEST_MM_PER_H * self.rate_capacity_mm_per_h))
        deviation = np.sqrt(np.maximum.accumulate(variance))
        nearest = np.interp(2 * self.near_m, self.middle_m, deviation)
        wanted = np.geomspace(nearest, LAST_LAYER * deviation[-1], self.layers)
        node_bins = np.unique(np.searchsorted(deviation, wanted))
        self.layers = len(node_bins)
        self.nodes_m = edges[node_bins]
        self._node_bins = node_bins
        self._layer = np.searchsorted(node_bins, np.arange(self.bins), side="right") - 1  # -1: before the first

    def _moments(self, rate_mm_per_h: float) -> tuple[Any, Any]:
        """Mean and variance of the optical depth of all particles in front of each bin's middle."""
        place = (math.log(rate_mm_per_h) - self._log_rate_low) / self._log_rate_step
        cell = min(max(math.floor(place), 0), self._all_moments.shape[1] - 2)
        found = self._all_moments[:, cell] + (place - cell) * (
            self._all_moments[:, cell + 1] - self._all_moments[:, cell]
        )
        return found[0], found[1]

    def _tabulate_moments(self) -> None:
        """Moments at the rates of the particles' tables, ``(2, rates, bins)``."""
        tables = _all_as_haze(
            self.weather, self._optics(), self.focal_px, self.near_m, self.far_m, self.rate_capacity_mm_per_h
        )
        self._log_rate_low, self._log_rate_step = tables.log_rate_low, tables.log_rate_step
        foot = (np.log(self.middle_m / self.focal_px) - tables.log_footprint_low) / tables.log_footprint_step
        nodes = np.arange(tables.haze_depth.shape[1])
        both = (tables.haze_depth, tables.haze_variance)
        self._all_moments = np.array([[np.interp(foot, nodes, row) * self.focal_px for row in table] for table in both])

    def _optics(self) -> MarkOptics:
        focus = math.inf if self.camera.focus_distance_m is None else self.camera.focus_distance_m
        return MarkOptics(self.camera.exposure_s, self.camera.aperture_m, focus, self.camera.lens_blur_px)

    def __repr__(self) -> str:
        held = ", ".join(f"{self.rate_ratio**node:.3g}" for node in sorted(self._codes)) or "none yet"
        return (
            f"DrawBank({self.weather.kind!r}, {self.camera.width} x {self.camera.height} px, training quality, "
            f"{self.layers} layers, rates {held} mm/h)"
        )

    # ---- storms ------------------------------------------------------------------------------------------------

    @property
    def number_of_bytes(self) -> int:
        """Memory of the codes that are there."""
        return sum(codes.numel() for codes in self._codes.values())

    def node_of(self, rate_mm_per_h: float) -> int:
        """Number of the bank's rate nearest to a rate."""
        if not 0.0 <= rate_mm_per_h <= self.rate_capacity_mm_per_h * (1 + 1e-6):
            raise InputValueError(
                f"DrawBank: rate_mm_per_h must be 0 to rate_capacity_mm_per_h = {self.rate_capacity_mm_per_h:g} mm/h; "
                f"got {rate_mm_per_h:g}. Build the bank or the transform with rate_capacity_mm_per_h={rate_mm_per_h:g} "
                "or more."
            )
        return round(math.log(max(rate_mm_per_h, LOWEST_MM_PER_H)) / math.log(self.rate_ratio))

    def prepare(self, lowest_mm_per_h: float, highest_mm_per_h: float) -> DrawBank:
        """Render the storms of all rates in a range now, before workers start.

        Args:
            lowest_mm_per_h, highest_mm_per_h: limits of the rate; about a second for each factor of 1.4.

        Returns:
            The bank itself.
        """
        check_arguments(
            "DrawBank.prepare(lowest_mm_per_h: float, highest_mm_per_h: float)", lowest_mm_per_h, highest_mm_per_h
        )
        first, last = self.node_of(float(lowest_mm_per_h)), self.node_of(float(highest_mm_per_h))
        if last - first >= self.most_rates:
            warnings.warn(
                f"DrawBank: {last - first + 1} rates from {lowest_mm_per_h:g} to {highest_mm_per_h:g} mm/h do not fit "
                f"into most_bytes={self.most_bytes:g}, which holds {self.most_rates}; the others are rendered anew at "
                "each use, which takes a second. Give a smaller range, or a bank with more most_bytes.",
                TorchweatherWarning,
                stacklevel=2,
            )
        for node in range(first, last + 1)[-self.most_rates :]:
            self.codes(node)
        return self

    def codes(self, node: int) -> Tensor:
        """Codes of the storms of a rate, ``(storms, layers * H * W)`` uint8; rendered where they are not there yet."""
        if node not in self._codes:
            self._render(node)
        self._codes.move_to_end(node)
        return self._codes[node]

    def _render(self, node: int) -> None:
        rate = min(self.rate_ratio**node, self.rate_capacity_mm_per_h)
        population = Population(
            replace(self.weather, rate_mm_per_h=rate),
            replace(self.camera, width=self.size[1], height=self.size[0], cx=None, cy=None),
            near_m=self.near_m,
            far_m=self.far_m,
            min_listed_coverage=self.min_listed_coverage,
            max_listed_density=self.max_listed_density,
            ego_speed_m_per_s=0.0,
            rate_capacity_mm_per_h=self.rate_capacity_mm_per_h,
            published_blend=False,
        )
        codes = torch.empty(STORMS, self.layers, *self.size, dtype=torch.uint8)
        covered = torch.empty(2, STORMS, self.layers, len(AMPLITUDES), dtype=torch.float64)
        levels = decoded_codes().double()
        with one_thread_an_operation():
            for storm in range(STORMS):
                name = f"bank.{self.weather.kind}.{node}.{storm}"
                optical = storm_layers(population, self.nodes_m.tolist(), self.size, 1 / STORMS, self.seed, name)
                codes[storm] = encoded(optical)
                for layer in range(self.layers):
                    count = torch.bincount(codes[storm, layer].flatten(), minlength=256).double()
                    share = count / count.sum()
                    clear = torch.exp(-levels * torch.tensor(AMPLITUDES, dtype=torch.float64)[:, None])
                    covered[0, storm, layer] = -torch.log(clear @ share)
                    covered[1, storm, layer] = (clear.square() @ share - (clear @ share).square()).clamp_min(0.0)
        self._keep(node, codes.view(STORMS, -1), covered)

    def _keep(self, node: int, codes: Tensor, covered: Tensor) -> None:
        codes.share_memory_()  # type: ignore[no-untyped-call]
        self._codes[node] = codes
        self._covered[node] = covered
        while len(self._codes) > self.most_rates:
            dropped, _ = self._codes.popitem(last=False)
            del self._covered[dropped]

    # ---- samples -----------------------------------------------------------------------------------------------

    def variate(self) -> Variate:
        """Variates of a sample: displacement down and across, and mirroring, of each storm, in 0..1."""
        return Variate(f"{self.weather.kind}_place", "uniform", (STORMS, 3))

    def at_rate(self, rate_mm_per_h: float) -> BankTables:
        """The look-ups of a rate.

        Args:
            rate_mm_per_h: above 0.
        """
        node = self.node_of(rate_mm_per_h)
        self.codes(node)
        mean, variance = self._moments(rate_mm_per_h)
        _, at_node = self._moments(min(self.rate_ratio**node, self.rate_capacity_mm_per_h))
        layer = np.maximum(self._layer, 0)
        tables = self._covered[node].numpy()[:, :, layer].sum(1)  # (2, bins, amplitudes), of all storms
        covered, deviation = tables[0], np.sqrt(tables[1])
        # Marks that cover a pixel wholly do not grow with their optical depth: the others grow the more.
        growth = np.sqrt(variance / np.maximum(at_node[self._node_bins][layer], 1e-30))
        amplitude = amplitude_of(deviation, growth * deviation[:, AMPLITUDES.index(1.0)])
        amplitude = np.where(self._layer < 0, 0.0, np.minimum(amplitude, AMPLITUDES[-1] / self._mean_ray))
        # Where the storms cover more than wanted their marks are fainter; where less, the rest is even.
        # Off the axis optical depth grows with the ray; the mean is that of particles at the frame's mean ray.
        ray = self._mean_ray
        amplitude *= np.minimum(1.0, ray * mean / np.maximum(between(covered, ray * amplitude), 1e-30))
        even = np.maximum(mean - between(covered, ray * amplitude) / ray, 0.0)
        base = (layer * (self.size[0] * self.size[1])).astype(np.int32)
        return BankTables(
            node,
            self.near_m,
            self.far_m,
            self.first_bin,
            torch.from_numpy(base),
            torch.from_numpy(amplitude.astype(np.float32)),
            torch.from_numpy(even.astype(np.float32)),
            decoded_codes(),
        )

    def places(self, place: Tensor, height: int, width: int) -> list[tuple[Tensor, Tensor]]:
        """Rows (times the torus's width) and columns ``(H,)``, ``(W,)`` int32 of a sample's storms on the torus.

        Args:
            place: ``(storms, 3)`` in 0..1, what was drawn.
            height, width: of the frame.
        """
        rows, columns = self.size
        found = []
        for down, across, mirrored in place.tolist():
            v = (np.arange(height, dtype=np.int32) + int(down * rows)) % rows * columns
            u = (np.arange(width, dtype=np.int32) + int(across * columns)) % columns
            if self.mirrors and mirrored >= 0.5:
                u = columns - 1 - u
            found.append((torch.from_numpy(v), torch.from_numpy(u)))
        return found

    def optical_depth(self, depth_m: Tensor, rate_mm_per_h: float, place: Tensor) -> Tensor:
        """Optical depth in front of a scene, for rays along the axis, ``(H, W)`` float32.

        Args:
            depth_m: ``(H, W)`` metres along the axis, infinity is sky.
            rate_mm_per_h: 0 or more.
            place: ``(storms, 3)`` in 0..1, of `variate`.

        Returns:
            To be multiplied by the length of ray per depth.
        """
        check_arguments("DrawBank.optical_depth(depth_m: floating(H, W), place: floating(2, 3))", depth_m, place)
        self._check_size(depth_m)
        if rate_mm_per_h <= 0:
            self.node_of(rate_mm_per_h)
            return torch.zeros_like(depth_m, dtype=torch.float32)
        tables = self.at_rate(rate_mm_per_h)
        codes = self.codes(tables.node)
        bins = depth_bins(depth_m, tables).flatten()
        base = tables.base.index_select(0, bins).view(depth_m.shape)
        total = torch.zeros(depth_m.numel())
        for storm, (rows, columns) in enumerate(self.places(place, *depth_m.shape)):
            where = (base + rows[:, None] + columns).flatten()
            total += tables.level.index_select(0, codes[storm].index_select(0, where).int())
        total.mul_(tables.amplitude.index_select(0, bins)).add_(tables.even.index_select(0, bins))
        return total.view(depth_m.shape)

    def _check_size(self, depth_m: Tensor) -> None:
        height, width = depth_m.shape[-2:]
        if height > self.size[0] or width > self.size[1]:
            raise InputValueError(
                f"DrawBank: frames must be at most {self.size[1]} x {self.size[0]} px; got {width} x {height}. Build "
                "it for a camera of that size."
            )

    # ---- files -------------------------------------------------------------------------------------------------

    def config(self) -> dict[str, Any]:
        """Plain values of what the storms depend on."""
        return {
            "format": FORMAT,
            "weather": self.weather.to_dict(),
            "camera": self.camera.to_dict(),
            "near_m": self.near_m,
            "far_m": self.far_m,
            "min_listed_coverage": self.min_listed_coverage,
            "max_listed_density": self.max_listed_density,
            "rate_capacity_mm_per_h": self.rate_capacity_mm_per_h,
            "seed": self.seed,
            "most_bytes": self.most_bytes,
        }

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the storms that are there to a ``.npz`` file, whole or not at all."""
        check_arguments("DrawBank.save(path: path)", path)
        contents: dict[str, Any] = {"config": np.array(json.dumps(self.config(), sort_keys=True))}
        for node, codes in self._codes.items():
            contents[f"codes_{node}"] = codes.numpy()
            contents[f"covered_{node}"] = self._covered[node].numpy()
        write_archive(path, contents)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> DrawBank:
        """Read a bank that `save` wrote; nothing in the file is run.

        Raises:
            TorchweatherError: the file is none, or of another version.
        """
        check_arguments("DrawBank.load(path: path)", path)
        arrays, _ = read_archive(path)
        try:
            config = json.loads(str(arrays.pop("config")))
            if config.pop("format") != FORMAT:
                raise InputValueError("another version")
            weather: Any = weather_from_dict(config.pop("weather"))
            bank = cls(weather, Camera.from_dict(config.pop("camera")), **config)
            for name in [name for name in arrays if name.startswith("codes_")]:
                node = int(name.removeprefix("codes_"))
                codes, covered = torch.from_numpy(arrays[name]), torch.from_numpy(arrays[f"covered_{node}"])
                wanted = (STORMS, bank.layers * bank.size[0] * bank.size[1])
                layers = (2, STORMS, bank.layers, len(AMPLITUDES))
                if codes.dtype != torch.uint8 or tuple(codes.shape) != wanted or tuple(covered.shape) != layers:
                    raise InputValueError(f"{name} has shape {tuple(codes.shape)}, expected {wanted}")
                bank._keep(node, codes, covered)
        except (KeyError, ValueError, TypeError, AttributeError) as error:
            raise TorchweatherError(
                f"{os.fspath(path)}: expected a bank of {FORMAT} as DrawBank.save writes it; it cannot be read "
                f"({error}). Build and save it again."
            ) from error
        return bank


_KEPT: OrderedDict[str, DrawBank] = OrderedDict()


@lru_cache(maxsize=16)
def _all_as_haze(
    weather: Rain | Snow, optics: MarkOptics, focal_px: float, near_m: float, far_m: float, rate_capacity: float
) -> Any:
    """Tables whose haze holds all particles: the mean and variance of the whole."""
    return particle_tables(weather, optics, focal_px, near_m, far_m, 1.0, 1e-12, rate_capacity)
