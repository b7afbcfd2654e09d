"""Backscatter of the measured fogs at 20,001 radii, written into ``tests/oracles/physics_oracles.json``.

The block ``fog_table5`` had it from 3,000 radii, too few for the resonances of nearly transparent spheres: it was up to
3 % off (``PHYSICS.md`` 10.9). The Mie series here is one of its own (Bohren and Huffman 1983, appendix A, upward
recurrence of the Riccati-Bessel functions), on numpy only.

Run ``python tests/reference/make_fog_backscatter.py`` (about two minutes on one core).
"""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

ORACLES = Path(__file__).parents[1] / "oracles" / "physics_oracles.json"
WAVELENGTHS_NM = {"B": 460.0, "G": 530.0, "R": 600.0, "865": 865.0, "905": 905.0, "1550": 1550.0}
RADII_UM = np.geomspace(0.02, 150.0, 20001)
AT_ONCE = 500
Array = NDArray[np.float64]


def backscatter_efficiency(index: complex, size: Array) -> Array:
    """``Q_back = |sum (2n+1)(-1)^n (a_n - b_n)|^2 / x^2`` of spheres of size parameters x, sorted."""
    terms = int(size.max() + 4.05 * np.cbrt(size.max()) + 12)
    z = index * size
    start = terms + 16 + int(abs(z).max())
    # D_n(z) = d ln psi_n / dz by downward recurrence.
    derivative = np.zeros((terms + 1, size.size), dtype=complex)
    d = np.zeros(size.size, dtype=complex)
    for n in range(start, 0, -1):
        d = n / z - 1.0 / (d + n / z)
        if n - 1 <= terms:
            derivative[n - 1] = d
    psi_before, psi = np.cos(size), np.sin(size)
    chi_before, chi = -np.sin(size), np.cos(size)
    total = np.zeros(size.size, dtype=complex)
    own_terms = size + 4.05 * np.cbrt(size) + 2
    for n in range(1, terms + 1):
        psi_before, psi = psi, (2 * n - 1) * psi / size - psi_before
        chi_before, chi = chi, (2 * n - 1) * chi / size - chi_before
        xi, xi_before = psi - 1j * chi, psi_before - 1j * chi_before
        da, db = derivative[n] / index + n / size, derivative[n] * index + n / size
        a = (da * psi - psi_before) / (da * xi - xi_before)
        b = (db * psi - psi_before) / (db * xi - xi_before)
        # Beyond its own number of terms a sphere adds nothing, and the recurrence is lost in rounding.
        total += np.where(n <= own_terms, (2 * n + 1) * (-1) ** n * (a - b), 0.0)
    return np.asarray(np.abs(total) ** 2 / size**2)


def main() -> None:
    """Compute and write."""
    oracles = json.loads(ORACLES.read_text(encoding="utf-8"))
    optical = oracles["refractive_index"]["optical"]
    radius_m = RADII_UM * 1e-6
    step = math.log(RADII_UM[1] / RADII_UM[0])
    for band, wavelength_nm in WAVELENGTHS_NM.items():
        material = optical[f"{wavelength_nm:g}nm"]
        # The index of the library: IAPWS at 10 degrees Celsius, absorption of the table.
        index = complex(material["water_n_iapws"]["10"], material["water_segelstein"][1])
        size = 2 * math.pi * radius_m / (wavelength_nm * 1e-9)
        parts = [backscatter_efficiency(index, size[i : i + AT_ONCE]) for i in range(0, size.size, AT_ONCE)]
        efficiency = np.concatenate(parts)
        for row in oracles["fog_table5"]["rows"].values():
            p = row["params"]
            gauss = np.exp(-0.5 * ((np.log(RADII_UM) - p["ln_r_um"]) / p["sigma"]) ** 2)
            per_log_m3 = p["N_cm3"] * 1e6 / (math.sqrt(2 * math.pi) * p["sigma"]) * gauss
            found = float((per_log_m3 * math.pi * radius_m**2 * efficiency).sum() * step / (4 * math.pi))
            known = row["extinction_1_per_m"][band]
            print(
                f"{band} {known['backscatter_per_sr']:.6g} -> {found:.6g} ({found / known['backscatter_per_sr']:.4f})"
            )
            known["backscatter_per_sr"] = found
            known["lidar_ratio_sr"] = known["full"] / found
    oracles["fog_table5"]["backscatter"] = "20,001 radii, tests/reference/make_fog_backscatter.py"
    half_written = ORACLES.with_suffix(".tmp")
    half_written.write_text(json.dumps(oracles, indent=1) + "\n", encoding="utf-8")
    half_written.replace(ORACLES)


if __name__ == "__main__":
    main()
