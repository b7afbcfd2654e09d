"""What measured raindrops do to light, beside what Marshall-Palmer drops of the same rain would do.

    python examples/rain_from_disdrometer.py                          # synthetic Parsivel hour
    python examples/rain_from_disdrometer.py file61_20181029.dat.gz   # OTT Parsivel telegrams
    python examples/rain_from_disdrometer.py corvdisdropsM1.b1.cdf --minutes 5

Reads a disdrometer file (Parsivel NetCDF or telegrams, ARM 2D video disdrometer), takes the wettest minutes, prints
rate, extinction and visibility, and draws the drop size distribution and extinction against rate.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib
import torch
from torch import Tensor

from torchweather.io import (
    DropSpectrum,
    atomic_write,
    parsivel_area_mm2,
    parsivel_edges_mm,
    parsivel_speeds_m_per_s,
    read_disdrometer,
    spectrum_from_counts,
)
from torchweather.physics import (
    Binned,
    SizeDistribution,
    close_rate,
    extinction_per_m,
    marshall_palmer,
    mor_from_extinction,
    rain_fall_speed_m_per_s,
    rain_rate_mm_per_h,
)

WAVELENGTH_NM = 550.0  # middle of what a camera sees; rain is grey, so 905 nm differs by less than a percent


def synthetic_hour(seed: int = 0) -> DropSpectrum:
    """What a Parsivel counts in an hour of gamma-distributed rain that rises to 40 mm/h and dies away."""
    generator = torch.Generator().manual_seed(seed)
    edges, speed = parsivel_edges_mm(), parsivel_speeds_m_per_s()
    area = parsivel_area_mm2(edges)
    diameter = 0.5 * (edges[1:] + edges[:-1])
    law = rain_fall_speed_m_per_s(diameter)
    rate = 40.0 * torch.exp(-(((torch.arange(60.0, dtype=torch.float64) - 25.0) / 12.0) ** 2)) + 0.2  # (T,)
    # Fewer small drops than Marshall-Palmer has, which is what disdrometers find (Ulbrich 1983: mu = 2 or so).
    shape = diameter**2 * torch.exp(-5.2 * rate[:, None] ** -0.16 * diameter)
    shape = torch.where((diameter > 0.25) & (diameter < 7.0), shape, 0.0)
    scale = rate / rain_rate_mm_per_h(Binned(edges, shape))
    expected = scale[:, None] * shape * edges.diff() * law * 60.0 * area * 1e-6  # (T, K)
    counts = torch.poisson(expected, generator=generator)
    nearest = (speed - law[:, None]).abs().argmin(-1)
    by_speed = torch.nn.functional.one_hot(nearest, len(speed)) * counts[..., None]  # (T, K, V)
    return spectrum_from_counts(
        by_speed,
        edges,
        speed,
        duration_s=60.0,
        area_mm2=area,
        time_s=60.0 * torch.arange(1.0, 61.0, dtype=torch.float64),
        instrument="synthetic Parsivel",
    )


def same_rain(rate_mm_per_h: Tensor, measured: DropSpectrum) -> SizeDistribution:
    """Marshall-Palmer drops of the same rate, over the diameters that the instrument resolves."""
    seen = measured.density_per_m3_mm.sum(0).nonzero().flatten()
    smallest, largest = float(measured.edges_mm[seen[0]]), float(measured.edges_mm[seen[-1] + 1])
    drops = marshall_palmer(rate_mm_per_h, diameter_min_mm=max(smallest, 0.1), diameter_max_mm=min(largest, 8.0))
    return close_rate(drops, rate_mm_per_h)


def print_table(measured: DropSpectrum, drops: Binned, model: SizeDistribution) -> None:
    rows = [
        ("rain rate, drops' own speed", "mm/h", float(measured.rate_mm_per_h[0]), None),
        ("rain rate, speed by law", "mm/h", float(rain_rate_mm_per_h(drops)), float(rain_rate_mm_per_h(model))),
        ("drops", "1/m3", float(drops.total_per_m3), float(model.total_per_m3)),
        ("liquid water", "g/m3", float(drops.liquid_water_g_per_m3()), float(model.liquid_water_g_per_m3())),
        ("effective diameter", "mm", float(drops.effective_diameter_mm), float(model.effective_diameter_mm)),
    ]
    extinction = [extinction_per_m(d, WAVELENGTH_NM) for d in (drops, model)]
    rows.append(("extinction at 550 nm", "1/km", *(1e3 * float(e) for e in extinction)))
    rows.append(("visibility (MOR)", "m", *(float(mor_from_extinction(e)) for e in extinction)))
    print(f"{measured.instrument}, mean of {measured.duration_s / 60:g} min")
    print(f"{'':30s}{'':6s}{'measured':>12s}{'M.-Palmer':>12s}")
    for name, unit, value, other in rows:
        print(f"{name:30s}{unit:6s}{value:12.4g}{'' if other is None else format(other, '12.4g')}")
    if measured.reported_rate_mm_per_h is not None:
        print(f"{'reported by the instrument':30s}{'mm/h':6s}{float(measured.reported_rate_mm_per_h[0]):12.4g}")
    if measured.reported_mor_m is not None:
        print(f"{'reported by the instrument':30s}{'m':6s}{float(measured.reported_mor_m[0]):12.4g}")


def draw(every: DropSpectrum, mean: DropSpectrum, model: SizeDistribution, path: Path) -> None:
    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
    density = mean.density_per_m3_mm[0]
    diameter = torch.linspace(0.1, 8.0, 400, dtype=torch.float64)
    left.stairs(density.clamp_min(1e-3), mean.edges_mm, fill=True, alpha=0.5, label=f"measured, {mean.instrument}")
    left.plot(diameter, model.number_density_per_m3_mm(diameter), "k", label="Marshall-Palmer, same rain")
    left.set(
        xlabel="drop diameter in mm", ylabel="drops per m³ and mm", yscale="log", xlim=(0, 7), ylim=(1e-2, 3e4),
        title=f"{float(mean.rate_mm_per_h[0]):.1f} mm/h, mean of {mean.duration_s / 60:g} min",
    )  # fmt: skip
    left.legend()

    wet = every.chosen(every.rate_mm_per_h > 0.1)
    extinction = extinction_per_m(Binned(wet.edges_mm, wet.density_per_m3_mm), WAVELENGTH_NM)
    rates = torch.logspace(-1, 2.2, 60, dtype=torch.float64)
    right.loglog(wet.rate_mm_per_h, 1e3 * extinction, ".", ms=3, alpha=0.5, label="measured, each interval")
    right.loglog(rates, 1e3 * extinction_per_m(same_rain(rates, mean), WAVELENGTH_NM), "k", label="Marshall-Palmer")
    right.set(xlabel="rain rate in mm/h", ylabel="extinction at 550 nm in 1/km", title="every interval above 0.1 mm/h")
    right.legend()
    low, high = (float(mor_from_extinction(1e-3 * limit)) for limit in right.get_ylim())
    right.twinx().set(yscale="log", ylim=(low, high), ylabel="visibility (MOR) in m")
    with atomic_write(path) as unfinished:
        figure.savefig(unfinished, dpi=120)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", nargs="?", type=Path, help="disdrometer file; without one a synthetic hour is made")
    parser.add_argument("--minutes", type=float, default=10.0, help="how many of the wettest minutes to average")
    parser.add_argument("--out", type=Path, default=Path("rain_from_disdrometer.png"), help="figure to write")
    arguments = parser.parse_args()

    every = synthetic_hour() if arguments.file is None else read_disdrometer(arguments.file)
    if not bool((every.rate_mm_per_h > 0.1).any()):
        raise SystemExit(f"{arguments.file}: no interval with more than 0.1 mm/h of rain")
    count = max(1, min(round(60 * arguments.minutes / every.duration_s), len(every.rate_mm_per_h)))
    mean = every.chosen(every.rate_mm_per_h.argsort(descending=True)[:count]).mean()
    model = same_rain(mean.rate_mm_per_h[0], mean)
    print_table(mean, Binned(mean.edges_mm, mean.density_per_m3_mm[0]), model)
    draw(every, mean, model, arguments.out)
    print(f"figure: {arguments.out}")


if __name__ == "__main__":
    main()
