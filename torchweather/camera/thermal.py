"""ThermalWeather: rain, fog and snow before a thermal camera, 8 to 14 um."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from torchweather.atmosphere.weather import Fog, Rain, Snow, Weather
from torchweather.camera.rays import rays_of
from torchweather.camera.sensor import Camera
from torchweather.core.arguments import check_arguments, check_broadcast
from torchweather.core.errors import InputTypeError, InputValueError, check_at_least, check_between
from torchweather.physics.extinction import Q_EFF, effective_extinction_per_m, extinction_per_m
from torchweather.physics.thermal_band import COLDEST_C, HOTTEST_C, ThermalBand

__all__ = ["ThermalWeather"]

FARTHEST_M = 1e12  # stands for an infinite depth
NM_PER_UM = 1e3


class ThermalWeather(nn.Module):
    """Weather on the temperatures that a thermal camera shows.

    Each wavelength of the band loses ``exp(-alpha l)`` of the scene's radiance, and air and particles at the air's
    temperature radiate the rest: ``L = B(T) exp(-alpha l) + B(T_air) (1 - exp(-alpha l))``. The sum over the band is
    read as a temperature again. ``alpha`` is by Mie theory over the weather's own droplets, with the index of water and
    ice from 8 to 14 um.

    Args:
        weather: ``Rain``, ``Fog``, ``Snow`` or a ``Mixture`` of them, with intensities that are given, not drawn; one
            for each sample where they are tensors.
        camera: its size, focal length and mounting; a camera with the thermal one's pixels.
        low_um, high_um: the detector's band, um, 8 to 14.
        air_temperature_c: of the air and what floats in it, deg C; by default the weather's own.
        layer_top_m: height of the layer's top above the ground, metres, as in ``BayerWeather``.

    Note:
        It holds where all around the particles is as warm as the air: light that a droplet scatters is then as bright
        as what it radiates. Below a clear, cold sky the fog itself looks colder than this. A clear frame holds the
        vapour that was in its air; more is not added. Drops and flakes are not drawn one by one, as a microbolometer
        averages over some 10 ms and wide pixels. Wet surfaces keep their temperature. No frame of a thermal camera was
        at hand to compare with.

    References:
        Planck's law; Hale & Querry 1973 and Warren & Brandt 2008 for the index; ``PHYSICS.md`` 3.2 and 10.11.

    Example:
        >>> camera = Camera.from_intrinsics(400, 400, 159.5, 127.5, 320, 256)
        >>> thermal = ThermalWeather(Fog(mor_m=50.0), camera, air_temperature_c=5.0)
        >>> person = torch.full((1, 256, 320), 30.0)
        >>> thermal(person, depth_m=100.0)[0, 128, 160].round(decimals=1)
        tensor(8.5000)
    """

    extinction_per_m: Tensor

    def __init__(
        self,
        weather: Weather,
        camera: Camera,
        *,
        low_um: float = 8.0,
        high_um: float = 14.0,
        air_temperature_c: float | None = None,
        layer_top_m: float = 200.0,
    ) -> None:
        super().__init__()
        check_arguments(
            "ThermalWeather(weather: Weather, camera: Camera, low_um: float, high_um: float, "
            "air_temperature_c: float | None, layer_top_m: float)",
            weather,
            camera,
            low_um,
            high_um,
            air_temperature_c,
            layer_top_m,
        )
        if getattr(weather, "conditions", ()):
            raise InputTypeError(
                "ThermalWeather: water and snow on things are not modelled; got "
                f"{', '.join(one.kind for one in weather.conditions)}. Leave them out of the mixture."
            )
        parts = [part for part in weather.parts if isinstance(part, (Rain, Snow, Fog))]
        if len(parts) < len(weather.parts) or not parts:
            raise InputTypeError(f"ThermalWeather: weather must be rain, snow, fog or a mixture; got {weather.kind}.")
        if weather.random:
            raise InputValueError(
                f"ThermalWeather: intensities must be numbers or tensors; {', '.join(weather.random)} is drawn. "
                "Take weather.drawn(seed)."
            )
        self.weather, self.camera, self.band = weather, camera, ThermalBand(low_um, high_um)
        if air_temperature_c is None:
            air_temperature_c = parts[0].temperature_c
        check_between("air_temperature_c", air_temperature_c, -60.0, 60.0, unit="deg C", owner=self)
        check_at_least(
            "layer_top_m", layer_top_m, camera.height_m, unit="m", owner=self, advice="It must be above the camera."
        )
        self.air_temperature_c, self.layer_top_m = float(air_temperature_c), float(layer_top_m)
        per_part = [_extinction_per_m(part, self.band.wavelengths_um) for part in parts]
        total = per_part[0]
        for more in per_part[1:]:
            total = total + more
        self.register_buffer("extinction_per_m", total.float())

    def forward(self, temperature_c: Tensor, depth_m: Tensor | float) -> Tensor:
        """The temperatures that the camera shows in the weather, deg C.

        Args:
            temperature_c: ``(..., H, W)`` what it shows in clear air, deg C.
            depth_m: along the optical axis, metres, a number or broadcast to the frame; ``inf`` for the sky.

        Returns:
            ``(..., H, W)``; the input bit for bit where there is no weather.
        """
        check_arguments(
            "ThermalWeather.forward(temperature_c: floating(..., H, W), depth_m: floating | float)",
            temperature_c,
            depth_m,
        )
        self._check_temperature(temperature_c)
        check_broadcast("ThermalWeather", temperature_c=temperature_c, depth_m=depth_m)
        depth = torch.as_tensor(depth_m, dtype=temperature_c.dtype, device=temperature_c.device)
        if not torch.compiler.is_compiling() and bool((depth.isnan() | (depth < 0)).any()):
            raise InputValueError(
                "ThermalWeather: depth_m must be 0 m or more, inf for the sky; got a negative depth or NaN."
            )
        path_m = self._path_m(depth)
        extinction = self.extinction_per_m.to(temperature_c)
        if extinction.ndim > 1:  # a rate for each sample
            if temperature_c.shape[0] != len(extinction):
                raise InputValueError(
                    f"ThermalWeather: the weather has {len(extinction)} intensities; the first axis of temperature_c "
                    f"must be as long; got shape {tuple(temperature_c.shape)}."
                )
            extinction = extinction.view(-1, *[1] * (temperature_c.ndim - 1), extinction.shape[-1])
        clear = torch.exp(-extinction * path_m[..., None])
        of_air = self.band.radiance(temperature_c.new_tensor(self.air_temperature_c))
        seen = torch.lerp(of_air.expand_as(clear), self.band.radiance(temperature_c), clear).sum(-1)
        untouched = (clear == 1).all(-1)
        return torch.where(untouched, temperature_c, self.band.temperature_c(seen))

    def _check_temperature(self, temperature_c: Tensor) -> None:
        if torch.compiler.is_compiling():
            return
        if temperature_c.dtype not in (torch.float32, torch.float64):
            raise InputTypeError(
                f"ThermalWeather: temperature_c must be float32 or float64; got {temperature_c.dtype}. Radiances over "
                "the band have more range than half precision."
            )
        height, width = self.camera.height, self.camera.width
        if tuple(temperature_c.shape[-2:]) != (height, width):
            raise InputValueError(
                f"ThermalWeather: temperature_c must have the camera's {height} x {width} pixels; got shape "
                f"{tuple(temperature_c.shape)}. Use camera.resized(width_px, height_px)."
            )
        low, high = float(temperature_c.detach().min()), float(temperature_c.detach().max())
        if low >= 150.0:
            raise InputValueError(
                f"ThermalWeather: temperature_c must be in deg C; got {low:g} to {high:g}, which looks like kelvin. "
                "Subtract 273.15."
            )
        check_between("temperature_c", temperature_c, COLDEST_C, HOTTEST_C, unit="deg C", owner=self)

    def _path_m(self, depth_m: Tensor) -> Tensor:
        """Way of each pixel's ray through the weather, metres, ``(..., H, W)``."""
        camera = self.camera
        fx, fy, cx, cy = (float(value) for value in camera.intrinsics)
        x = (torch.arange(camera.width, device=depth_m.device, dtype=depth_m.dtype) - cx) / fx
        y = (torch.arange(camera.height, device=depth_m.device, dtype=depth_m.dtype)[:, None] - cy) / fy
        shape = (camera.height, camera.width)
        rays = rays_of(camera, *camera.undistort(x.expand(shape), y.expand(shape)), self.layer_top_m)
        path_m = depth_m.clamp_max(FARTHEST_M) * rays.per_depth[0, 0]
        return path_m if rays.in_layer_m is None else torch.minimum(path_m, rays.in_layer_m[0, 0])


def _extinction_per_m(weather: Rain | Snow | Fog, wavelengths_um: tuple[float, ...]) -> Tensor:
    """Extinction that the camera sees at each wavelength, 1/m, ``(K,)`` or ``(B, K)``."""
    share = Q_EFF[weather.kind]
    distribution = weather.distribution()
    present = torch.as_tensor(weather.intensity)
    there = torch.isfinite(present) if isinstance(weather, Fog) else present > 0
    values = []
    for wavelength_um in wavelengths_um:
        full = extinction_per_m(distribution, wavelength_um * NM_PER_UM, temperature_c=weather.temperature_c)
        values.append(torch.where(there, effective_extinction_per_m(full, share), torch.zeros_like(full)))
    return torch.stack(values, -1)
