"""The numbers behind a weather as one sensor sees it: extinction, backscatter, visibility, particles, water."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import torch
from torch import Tensor

from torchweather.atmosphere.weather import Fog, Rain, Snow, Weather, parse_weather
from torchweather.camera.sensor import Camera
from torchweather.core.errors import InputValueError
from torchweather.core.text import aligned
from torchweather.lidar.receiver_numbers import receiver_numbers
from torchweather.lidar.sensor import Lidar
from torchweather.physics import (
    DB_PER_KM,
    Q_EFF,
    SizeDistribution,
    backscatter_per_m_sr,
    extinction_per_m,
    mor_from_extinction,
    precipitation_rate_mm_per_h,
    volume_reflectivity_m2_per_m3,
)
from torchweather.radar.attenuation import weather_attenuation_db_per_km
from torchweather.radar.sensor import Radar
from torchweather.sensors import sensor_preset

__all__ = ["explain", "explanation_text"]

MOR_WAVELENGTH_NM = 550.0  # where the visibility is defined, PHYSICS.md 2.3
MEDIAN_STEPS = 60  # halvings of the logarithmic interval: far below 1e-9 of the diameter
ATTENUATION_MODELS = {
    "rain": "ITU-R P.838-3",
    "fog": "ITU-R P.840 times the liquid water content",
    "snow": "Mie, dry flakes as ice-air spheres (uncertain by a factor 3-10)",
}
GENERIC_NEAR = (
    "The near response of this preset is generic, and decides how many particles are seen (docs/sensitivity.md)."
)
# The extinction that a sensor sees, beside all of it.
EFFECTIVE, RENDERED = "extinction_effective_per_m", "extinction_rendered_per_m"
SEEN_TITLES = {EFFECTIVE: "effective extinction 1/m", RENDERED: "rendered extinction 1/m"}
# A camera draws the shadows of drops and flakes; the light that they diffract stays within its blur. Droplets of fog
# send it elsewhere (PHYSICS.md 3.2, 4.2).
Q_RENDERED = {"rain": 1.0, "snow": 1.0, "fog": 2.0}
MELTING_MODEL = "Mie, flakes enclosed in their melt water (an upper bound)"

Sensor = Camera | Lidar | Radar
Parts = list[tuple[Weather, SizeDistribution]]


def explain(
    weather: Weather | str,
    sensor: Sensor | str,
    *,
    wavelength_nm: float | None = None,
    frequency_ghz: float | None = None,
    polarisation: str | None = None,
    receiver: bool = False,
) -> dict[str, Any]:
    """The physical numbers of a weather for a sensor, as plain values.

    Args:
        weather: a weather, or its text such as ``rain:rate=25``; its intensity a single number.
        sensor: a sensor, or its text such as ``lidar:ouster-os1-128``.
        wavelength_nm: leaves one band of a camera or LiDAR, at this wavelength, 300-2500 nm.
        frequency_ghz: replaces the radar's carrier, 1-1000 GHz.
        polarisation: replaces the radar's, ``h`` or ``v``.
        receiver: add what a LiDAR's receiver makes of the weather; takes a second or more. Other sensors have none.

    Returns:
        ``weather`` (its fields), ``sensor`` (its name) and

        - ``bands``: for each, ``name``, ``extinction_per_m`` (all of it, q_eff = 2), ``backscatter_per_m_sr``, and
          ``wavelength_nm`` or, for radar, ``frequency_ghz``, ``polarisation`` and ``attenuation_db_per_km`` (one way).
          A LiDAR's bands also have ``extinction_effective_per_m``, without the forward lobe that stays in the beam; a
          camera's ``extinction_rendered_per_m``, of rain and snow the particles' shadows alone (q_eff = 1).
        - ``receiver``: where asked for, of a LiDAR (``lidar.receiver_numbers``).
        - ``mor_m``: visibility from Mie extinction at 550 nm; infinite where nothing falls. For fog beside it
          ``mor_nominal_m``, the fog's own parameter.
        - ``particles_per_m3``, ``liquid_water_g_per_m3``.
        - ``attenuation_db_per_km``: radar only, the same as in its band.
        - ``parts``: the same for each weather of a mixture, with the ``median_volume_diameter_mm`` (of the size that
          its distribution counts: melted diameter for snow) and, for rain and snow, the ``rate_carried_mm_per_h`` that
          the distribution carries with its fall speeds.

    Note:
        Backscatter of rain is the effective one of ``rain_q_back``: 0.2 up to 905 nm, 0.06 at 1550 nm, log-linear
        between. That of fog is Mie's, that of flakes a Lambertian disk's.

    References:
        PHYSICS.md 2, 3.2, 6.5-6.7, 7.

    Example:
        >>> numbers = explain("fog:mor=30", "lidar:ouster-os1-128")
        >>> numbers["bands"][0]["name"], round(numbers["bands"][0]["extinction_per_m"], 3), round(numbers["mor_m"])
        ('laser', 0.104, 30)
    """
    if isinstance(weather, str):
        weather = parse_weather(weather)
    if not weather.parts:
        raise InputValueError(
            f"explain: expected rain, fog or snow, whose particles it explains; got {weather!r}. Add e.g. rain:rate=5."
        )
    name, sensor = sensor_preset(sensor) if isinstance(sensor, str) else (sensor.kind, sensor)
    parts = [(part, _distribution(part)) for part in weather.parts]
    # Nothing scatters where nothing falls, and an empty distribution has no sizes to integrate over.
    present = [(part, distribution) for part, distribution in parts if float(distribution.total_per_m3) > 0]
    numbers: dict[str, Any] = {"weather": weather.to_dict(), "sensor": name}
    numbers["bands"] = BANDS[sensor.kind](present, sensor, wavelength_nm, frequency_ghz, polarisation)
    if receiver and sensor.kind in RECEIVERS:
        numbers["receiver"] = RECEIVERS[sensor.kind](weather, sensor)
    band = numbers["bands"][0]
    numbers |= {key: band[key] for key in ("attenuation_db_per_km",) if key in band}
    described = [_part(part, distribution) for part, distribution in parts]
    numbers["mor_m"] = _mor_m(present)
    for key in ("particles_per_m3", "liquid_water_g_per_m3"):
        numbers[key] = sum(part[key] for part in described)
    fogs = [part.intensity for part, _ in parts if isinstance(part, Fog)]
    if fogs:
        numbers["mor_nominal_m"] = float(fogs[0])
    numbers["parts"] = described
    return numbers


def _distribution(part: Weather) -> SizeDistribution:
    intensity = part.intensity
    if isinstance(intensity, Tensor) and intensity.numel() != 1:
        raise InputValueError(
            f"explain: {part.intensity_name} must be one number; got {intensity.numel()} of them. "
            "Explain one sample at a time."
        )
    assert isinstance(part, (Rain, Fog, Snow))  # parse_weather and Mixture know no others
    return part.distribution(float(intensity))


def _optical_bands(
    parts: Parts,
    sensor: Camera | Lidar,
    wavelength_nm: float | None,
    frequency_ghz: float | None,
    polarisation: str | None,
    *,
    key: str,
    seen: Mapping[str, float],
) -> list[dict[str, Any]]:
    """Bands of a camera or LiDAR; ``key`` names the extinction that the sensor sees, by the efficiencies ``seen``."""
    if frequency_ghz is not None or polarisation is not None:
        raise InputValueError(
            f"explain: frequency_ghz and polarisation are for radars; a {sensor.kind} takes wavelength_nm."
        )
    named = sensor.bands
    if wavelength_nm is not None:
        known = {wavelength: name for name, wavelength in named.items()}
        named = {known.get(wavelength_nm, f"{wavelength_nm:g} nm"): float(wavelength_nm)}
    return [_optical_band(parts, name, wavelength, key=key, seen=seen) for name, wavelength in named.items()]


def _optical_band(
    parts: Parts, name: str, wavelength_nm: float, *, key: str, seen: Mapping[str, float]
) -> dict[str, Any]:
    extinction, visible, backscatter = 0.0, 0.0, 0.0
    for part, distribution in parts:
        alone = float(extinction_per_m(distribution, wavelength_nm, temperature_c=_temperature_c(part)))
        extinction += alone
        visible += alone * seen[part.kind] / 2.0
        # A flake is a Lambertian disk: Q_back = 4 rho (PHYSICS.md 5.9). Rain and fog have defaults of their own.
        q_back = 4.0 * part.reflectivity_at(wavelength_nm) if isinstance(part, Snow) else None
        beta = backscatter_per_m_sr(distribution, wavelength_nm, temperature_c=_temperature_c(part), q_back=q_back)
        backscatter += float(beta)
    return {
        "name": name,
        "wavelength_nm": wavelength_nm,
        "extinction_per_m": extinction,
        "backscatter_per_m_sr": backscatter,
        key: visible,
    }


def _radar_bands(
    parts: Parts,
    radar: Radar,
    wavelength_nm: float | None,
    frequency_ghz: float | None,
    polarisation: str | None,
) -> list[dict[str, Any]]:
    if wavelength_nm is not None:
        raise InputValueError("explain: wavelength_nm is for cameras and LiDARs; a radar takes frequency_ghz.")
    wanted: dict[str, Any] = {"frequency_ghz": frequency_ghz, "polarisation": polarisation}
    radar = replace(radar, **{key: value for key, value in wanted.items() if value is not None})
    attenuation, backscatter = 0.0, 0.0
    for part, distribution in parts:
        attenuation += float(weather_attenuation_db_per_km(part, radar))
        melted = part.melt_fraction if isinstance(part, Snow) else 0.0
        reflectivity = volume_reflectivity_m2_per_m3(
            distribution, radar.frequency_ghz, temperature_c=_temperature_c(part), melt_fraction=melted
        )
        backscatter += float(reflectivity) / (4.0 * math.pi)
    band: dict[str, Any] = {
        "name": "carrier",
        "frequency_ghz": float(radar.frequency_ghz),
        "polarisation": radar.polarisation,
        "extinction_per_m": attenuation / DB_PER_KM,
        "backscatter_per_m_sr": backscatter,
        "attenuation_db_per_km": attenuation,
    }
    return [band]


RECEIVERS: dict[str, Callable[..., dict[str, Any]]] = {"lidar": receiver_numbers}
"""By the kind of the sensor: what its receiver makes of a weather."""
BANDS: dict[str, Callable[..., list[dict[str, Any]]]] = {
    "camera": partial(_optical_bands, key=RENDERED, seen=Q_RENDERED),
    "lidar": partial(_optical_bands, key=EFFECTIVE, seen=Q_EFF),
    "radar": _radar_bands,
}
"""By the kind of the sensor: its bands in weathers, from the sensor and what replaces its wavelength or carrier."""


def _part(part: Weather, distribution: SizeDistribution) -> dict[str, Any]:
    numbers: dict[str, Any] = {
        "kind": part.kind,
        "mor_m": _mor_m([(part, distribution)]) if float(distribution.total_per_m3) > 0 else math.inf,
        "particles_per_m3": float(distribution.total_per_m3),
        "liquid_water_g_per_m3": float(distribution.liquid_water_g_per_m3()),
        "median_volume_diameter_mm": _median_volume_diameter_mm(distribution),
    }
    if isinstance(part, Snow):
        numbers["melt_fraction"] = part.melt_fraction
    if isinstance(part, (Rain, Snow)):
        numbers["rate_carried_mm_per_h"] = float(precipitation_rate_mm_per_h(distribution, part.fall_speed_m_per_s))
    return numbers


def _mor_m(parts: list[tuple[Weather, SizeDistribution]]) -> float:
    extinction = sum(
        float(extinction_per_m(distribution, MOR_WAVELENGTH_NM, temperature_c=_temperature_c(part)))
        for part, distribution in parts
    )
    return float(mor_from_extinction(extinction))


def _temperature_c(part: Weather) -> float:
    assert isinstance(part, (Rain, Fog, Snow))
    return part.temperature_c


def _median_volume_diameter_mm(distribution: SizeDistribution) -> float | None:
    """Diameter below which half of the volume lies (half of D^3 N), by bisection; None where there are no particles."""
    half = 0.5 * float(distribution.moment(3.0))
    if not half > 0.0:
        return None
    low, high = (math.log(d) for d in distribution.span_mm())
    for _ in range(MEDIAN_STEPS):
        middle = 0.5 * (low + high)
        below = float(distribution.moment(3.0, high_mm=torch.tensor([math.exp(middle)], dtype=torch.float64)))
        low, high = (middle, high) if below < half else (low, middle)
    return math.exp(0.5 * (low + high))


def explanation_text(numbers: Mapping[str, Any]) -> str:
    """The numbers of ``explain`` as a table with units.

    Example:
        >>> print(explanation_text(explain("rain:rate=25", "radar")).splitlines()[0])
        rain (rate_mm_per_h=25) as radar:imaging-77ghz sees it
    """
    lines = [f"{_weather_text(numbers['weather'])} as {numbers['sensor']} sees it", ""]
    radar = "attenuation_db_per_km" in numbers
    seen = next((key for key in (EFFECTIVE, RENDERED) if key in numbers["bands"][0]), None)
    header = ["band", "frequency" if radar else "wavelength", "extinction 1/m", "backscatter 1/(m sr)"]
    header += ["attenuation dB/km, one way"] if radar else [SEEN_TITLES[seen]] if seen else []
    rows = [header]
    for band in numbers["bands"]:
        at = f"{band['frequency_ghz']:g} GHz {band['polarisation']}" if radar else f"{band['wavelength_nm']:g} nm"
        row = [band["name"], at, f"{band['extinction_per_m']:.4g}", f"{band['backscatter_per_m_sr']:.4g}"]
        extra = band["attenuation_db_per_km"] if radar else band[seen] if seen else None
        rows.append(row if extra is None else [*row, f"{extra:.4g}"])
    lines += ["  " + line for line in aligned(rows)]
    if seen:
        efficiencies = Q_EFF if seen == EFFECTIVE else Q_RENDERED
        named = ", ".join(f"{efficiencies[part['kind']]:g} for {part['kind']}" for part in numbers["parts"])
        lines += ["", f"  {SEEN_TITLES[seen].removesuffix(' 1/m')} = extinction q_eff / 2 with q_eff = {named}"]
    if radar:
        lines += ["", *(f"  {part['kind']}: {_attenuation_model(part)}" for part in numbers["parts"])]
    facts = [["visibility (Mie, 550 nm, 5 % contrast)", _metres(numbers["mor_m"])]]
    if "mor_nominal_m" in numbers:
        facts.append(["visibility, the fog's own parameter", _metres(numbers["mor_nominal_m"])])
    facts.append(["particles", f"{numbers['particles_per_m3']:.4g} per m^3"])
    facts.append(["liquid water", f"{numbers['liquid_water_g_per_m3']:.4g} g/m^3"])
    for part in numbers["parts"]:
        median = part["median_volume_diameter_mm"]
        if median is not None:
            facts.append([f"median volume diameter, {part['kind']}", f"{median:.4g} mm"])
        if "rate_carried_mm_per_h" in part:
            facts.append([f"rate that the {part['kind']} carries", f"{part['rate_carried_mm_per_h']:.4g} mm/h"])
    if "receiver" in numbers:
        facts += _receiver_facts(numbers["receiver"])
    text = "\n".join([*lines, "", *("  " + line for line in aligned(facts))])
    if "uncertainty" in numbers:
        rows = [[name, f"{one['value']:.3g}", _range_text(one)] for name, one in numbers["uncertainty"].items()]
        heads = ["number", "by default", "as one unmeasured default at a time is varied"]
        text += "\n\n" + "\n".join("  " + line for line in aligned([heads, *rows]))
    if numbers.get("receiver", {}).get("near_is_generic"):
        text += f"\n\n  {GENERIC_NEAR}"
    return text


def _range_text(one: Mapping[str, float]) -> str:
    """Least and largest value; numbers that no unmeasured default moves are exact but for their own laws."""
    if math.isclose(one["least"], one["largest"], rel_tol=1e-6):
        return "exact: no unmeasured default moves it"
    return f"{one['least']:.3g} to {one['largest']:.3g}"


def _receiver_facts(receiver: Mapping[str, Any]) -> list[list[str]]:
    """Rows of a LiDAR's receiver, each with the option of ``apply`` that replaces it."""
    near = (
        f"0 at {receiver['near_start_m']:g} m, full at {receiver['near_full_m']:g} m, power {receiver['near_power']:g}"
    )
    facts = [
        ["range at 10 % (--range-at-10-percent-m)", f"{receiver['range_at_10_percent_m']:g} m"],
        ["near response (--near-start-m, --near-full-m, --near-power)", near],
        ["pulse width (--pulse-width-ns)", f"{receiver['pulse_width_ns']:g} ns"],
        ["margin of returns (--margin-db)", f"{receiver['margin_db']:g} dB"],
    ]
    option = {"rain": " (--q-back)", "snow": " (--weather snow:flake_reflectivity=)"}
    facts += [
        [f"backscatter efficiency, {kind}{option.get(kind, '')}", f"{value:.3g}"]
        for kind, value in receiver["q_back"].items()
    ]
    at = f"{receiver['object_range_m']:g} m"
    return [
        *facts,
        ["false returns, of beams into open air", f"{receiver['false_return_share']:.3g}"],
        [f"lost returns, of objects of 10 % at {at}", f"{receiver['lost_share']:.3g}"],
    ]


def _attenuation_model(part: Mapping[str, Any]) -> str:
    return MELTING_MODEL if part.get("melt_fraction") else ATTENUATION_MODELS[part["kind"]]


def _weather_text(weather: Mapping[str, Any]) -> str:
    if weather["kind"] == "mixture":
        return " with ".join(_weather_text(part) for part in weather["parts"])
    intensity = "mor_m" if weather["kind"] == "fog" else "rate_mm_per_h"
    patches = ", in patches, whose mean this is" if weather["patch_log_std"] else ""
    return f"{weather['kind']} ({intensity}={weather[intensity]:g}{patches})"


def _metres(value: float) -> str:
    return "unlimited" if math.isinf(value) else f"{value:.4g} m"
