"""Shares of beams with a drop or flake above threshold and above objects, written to ``lidar_table.json``.

Run ``python tests/reference/make_lidar_table.py`` (half a minute). The table of PHYSICS.md 5.3 for the default
near-range response, by integration (``lambda_by_quadrature``): ``P = 1 - exp(-Lambda(e, R))``, with ``e`` the
threshold or the object's own signal behind the weather, whichever is larger. Flakes are those of PHYSICS.md 10.3, and
the particles of one pulse add (10.4). Rows of other near-range responses and of the sensor ``pandar64-wads`` stand
beside it, to compare. ``test_every_lidar_particle.py`` computes it anew.
"""

from __future__ import annotations

import json
import math
import platform
import sys
from pathlib import Path
from typing import Any

import numpy as np

# As a script only this file's folder is on the path; the reference is imported as pytest imports it, from the root.
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from tests.reference.every_lidar_particle import Link, Medium, lambda_by_quadrature, object_signal
from tests.reference.every_particle import Kind, population
from torchweather.physics import extinction_per_m, marshall_palmer, sekhon_srivastava

TARGET = Path(__file__).with_name("lidar_table.json")
Q_EFF = 1.1  # rain and snow, PHYSICS.md 3.2
Q_BACK = 0.2  # rain at 865 and 905 nm, PHYSICS.md 3.2
RATES_MM_PER_H: dict[Kind, tuple[float, ...]] = {"rain": (10.0, 25.0, 50.0), "snow": (0.5, 1.0, 3.0)}
OBJECT_RANGES_M = (10.0, 28.0, 50.0)
REFLECTIVITIES = (0.1, 0.5)
# Exit diameter m, full divergence rad, range at 10 % m; PHYSICS.md 7 and 5.9
OS1 = {"exit_diameter_m": 0.0095, "divergence_rad": math.radians(0.18), "range_at_10_percent_m": 40.0}
HDL64 = {"exit_diameter_m": 0.01, "divergence_rad": 0.002, "range_at_10_percent_m": 50.0}
PANDAR64 = {"exit_diameter_m": 0.01, "divergence_rad": 0.002, "range_at_10_percent_m": 30.0}
DEFAULT = {"near_start_m": 2.0, "near_full_m": 10.0, "near_power": 1.0}
HAHNER = {"near_start_m": 0.9, "near_full_m": 1.0, "near_power": 1.0}
SQUARED = {"near_start_m": 2.0, "near_full_m": 10.0, "near_power": 2.0}
SENSORS: dict[str, tuple[float, dict[str, float]]] = {
    "OS1": (865.0, {**OS1, **DEFAULT}),
    "HDL-64-like": (905.0, {**HDL64, **DEFAULT}),
    "OS1, overlap 0.9-1.0 m": (865.0, {**OS1, **HAHNER}),
    "HDL-64-like, overlap 0.9-1.0 m": (905.0, {**HDL64, **HAHNER}),
    "pandar64-wads": (905.0, {**PANDAR64, **SQUARED}),
}
BEAM = {"max_range_m": 120.0, "pulse_length_m": 0.5 * 299_792_458.0 * 10e-9}  # c tau / 2 of a pulse of 10 ns
# A layer of ice grains of 100 um, tau = 1.5 x 0.12 / (917 x 1e-4), x = 0.75 (1 - 0.77) tau, PHYSICS.md 10.3.
GRAINS = 0.75 * (1 - 0.77) * 1.5 * 0.12 / (917.0 * 1e-4)
FLAKE_REFLECTIVITY = GRAINS / (1 + GRAINS)


def effective_extinction_per_m(kind: Kind, rate_mm_per_h: float, wavelength_nm: float) -> float:
    """``alpha_Mie q_eff / 2`` of the default size distribution, one way."""
    sizes = marshall_palmer(rate_mm_per_h) if kind == "rain" else sekhon_srivastava(rate_mm_per_h)
    return float(extinction_per_m(sizes, wavelength_nm)) * Q_EFF / 2.0


def shares(link: Link, medium: Medium) -> dict[str, float]:
    """Probability per beam of a particle over the threshold, and over the threshold and each object."""

    def share(energy: float, range_m: float) -> float:
        return -math.expm1(-lambda_by_quadrature(energy, range_m, link, medium))

    found = {"over threshold, no object": share(link.threshold, link.max_range_m)}
    for range_m in OBJECT_RANGES_M:
        found[f"over threshold, object at {range_m:g} m"] = share(link.threshold, range_m)
        for rho in REFLECTIVITIES:
            signal = float(object_signal(range_m, rho, link, medium))
            found[f"over rho={rho:g} at {range_m:g} m"] = share(max(link.threshold, signal), range_m)
    return found


def table() -> list[dict[str, Any]]:
    """Every row: sensor, weather, effective extinction and the shares."""
    rows: list[dict[str, Any]] = []
    for sensor, (wavelength_nm, numbers) in SENSORS.items():
        link = Link(**numbers, **BEAM)
        for kind, rates in RATES_MM_PER_H.items():
            for rate in rates:
                alpha = effective_extinction_per_m(kind, rate, wavelength_nm)
                medium = Medium(population(kind, rate), Q_BACK, FLAKE_REFLECTIVITY, alpha)
                rows.append(
                    {
                        "sensor": sensor,
                        "weather": kind,
                        "rate_mm_per_h": rate,
                        "effective_extinction_per_m": alpha,
                        "P": shares(link, medium),
                    }
                )
    return rows


def main() -> None:
    result: dict[str, Any] = {
        "about": "Share of beams with a particle over the threshold, and over it and an object of reflectivity rho; "
        "by tests/reference/make_lidar_table.py. Rain: Marshall-Palmer 0.1-8 mm, Q_back 0.2. Snow: Sekhon-Srivastava "
        "by melted diameter, 0.1 mm to a physical 20 mm, reflectivity 0.25. Particles of one pulse add. "
        "Extinction: Mie, q_eff 1.1. An object's "
        "signal bears the near-range response and the weather. Return mode and echo merging play no part.",
        "versions": {"python": platform.python_version(), "numpy": np.__version__},
        "sensors": {
            name: {
                "wavelength_nm": wavelength_nm,
                **numbers,
                **BEAM,
            }
            for name, (wavelength_nm, numbers) in SENSORS.items()
        },
        "rows": table(),
    }
    half_written = TARGET.with_suffix(".tmp")
    half_written.write_text(json.dumps(result, indent=1) + "\n")
    half_written.replace(TARGET)


if __name__ == "__main__":
    main()
