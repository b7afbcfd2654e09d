"""The LiDAR's every-particle reference against the oracle, its own quadrature, brute force and closed cases."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.oracles import load
from tests.reference.agreement import ks_critical, ks_distance, share_z_of_expected
from tests.reference.every_lidar_particle import (
    LOST,
    OBJECT,
    PARTICLE,
    Chosen,
    Echoes,
    Link,
    Medium,
    ReturnMode,
    chosen,
    every_particle,
    full_beam_signal,
    lambda_by_quadrature,
    object_signal,
)
from tests.reference.every_particle import Kind, geometric_extinction, population
from tests.reference.make_lidar_table import FLAKE_REFLECTIVITY, effective_extinction_per_m, shares

Array = NDArray[np.float64]

ORACLE = load("lidar_link")
TABLE = json.loads(Path(__file__).with_name("lidar_table.json").read_text())
N_BEAMS = 200_000
OS1 = Link(0.0095, math.radians(0.18), 40.0)
HDL64 = Link(0.01, 0.002, 50.0)
MODES: tuple[ReturnMode, ...] = ("strongest", "first", "last", "dual")


def oracle_link(sensor: str) -> Link:
    """The oracle's sensor: xi = 1 from its own nearest range on, no ramp."""
    p = ORACLE["rows"][sensor]["params"]
    return Link(p["d0"], p["div"], p["R10"], near_start_m=0.0, near_full_m=1e-9, min_range_m=p["Rmin"])


def oracle_medium(rate_mm_per_h: float, q_back: float, case: dict[str, float], range_m: float) -> Medium:
    """Rain of the oracle: its extinction (q_eff = 2) from the two-way transmission that it states."""
    alpha = -math.log(case["two_way_T_Q2"]) / (2.0 * range_m)
    return Medium(population("rain", rate_mm_per_h), q_back=q_back, extinction_per_m=alpha)


def default_medium(kind: Kind, rate_mm_per_h: float) -> Medium:
    sizes = population(kind, rate_mm_per_h)
    return Medium(sizes, extinction_per_m=1.1 * geometric_extinction(sizes))  # Q_ext = 2, q_eff = 1.1


def probability(energy: float, range_m: float, link: Link, medium: Medium) -> float:
    return -math.expm1(-lambda_by_quadrature(energy, range_m, link, medium))


CASES = [
    (sensor, name, float(name.split()[0]), float(name.split()[2]))
    for sensor in ("OS1_128_865nm", "HDL64_like_905nm")
    for name in ORACLE["rows"][sensor]["cases"]
]


@pytest.mark.parametrize(("sensor", "name", "rate", "range_m"), CASES)
def test_quadrature_gives_the_oracle_s_probabilities(sensor: str, name: str, rate: float, range_m: float) -> None:
    link, case = oracle_link(sensor), ORACLE["rows"][sensor]["cases"][name]
    for q_back in (0.0943, 0.3):
        medium = oracle_medium(rate, q_back, case, range_m)
        over = probability(link.threshold, range_m, link, medium)
        # Measured: within 5e-6 everywhere; the oracle's own tolerance is 2e-3.
        assert over == pytest.approx(case[f"P_drop_over_threshold_Qb{q_back}"], rel=1e-5)
        for rho in (0.1, 0.5):
            energy = max(link.threshold, float(object_signal(range_m, rho, link, medium)))
            both = probability(energy, range_m, link, medium)
            assert both == pytest.approx(case[f"P_drop_over_thr_and_object_rho{rho}_Qb{q_back}"], rel=1e-5)


@pytest.mark.parametrize("sensor", ["OS1_128_865nm", "HDL64_like_905nm"])
def test_cone_threshold_and_smallest_visible_drop_are_the_oracle_s(sensor: str) -> None:
    link, rows = oracle_link(sensor), ORACLE["rows"][sensor]
    assert link.threshold == pytest.approx(rows["threshold_sr_m2"], rel=1e-12)
    for name, case in rows["cases"].items():
        rate, range_m = float(name.split()[0]), float(name.split()[2])
        volume = float(link.volume_m3(range_m))
        assert volume == pytest.approx(case["V_cone_m3"], rel=1e-7)  # the oracle's cone is a numerical integral
        drops = volume * replace(population("rain", rate), largest_mm=10.0).per_m3
        assert drops == pytest.approx(case["N_drops_D0p1_10"], rel=1e-7)
        np.testing.assert_allclose(link.range_of_volume_m(np.array([volume])), range_m, rtol=1e-12)
    for q_back in (0.0943, 0.3):
        clear = Medium(population("rain", 10.0), q_back=q_back)
        for range_m, diameter_mm in rows[f"D_threshold_mm_Qb{q_back}"].items():
            r = np.array(float(range_m))
            fill = link.threshold / full_beam_signal(r, link, clear)
            assert 1e3 * link.beam_diameter_m(r) * math.sqrt(fill) == pytest.approx(diameter_mm, rel=1e-9)


@pytest.mark.parametrize("sensor", ["OS1_128_865nm", "HDL64_like_905nm"])
@pytest.mark.parametrize("rate", [10.0, 25.0, 50.0])
@pytest.mark.parametrize("q_back", [0.0943, 0.3])
def test_drawn_shares_are_the_oracle_s_within_binomial_error(sensor: str, rate: float, q_back: float) -> None:
    link, case = oracle_link(sensor), ORACLE["rows"][sensor]["cases"][f"{rate:g} mm/h 28 m"]
    medium = oracle_medium(rate, q_back, case, 28.0)
    distance = np.full(N_BEAMS, 28.0)
    particles = every_particle(distance, link, medium, rng=np.random.default_rng(int(rate)))
    over = np.unique(particles.beam).size
    assert abs(share_z_of_expected(over, N_BEAMS, case[f"P_drop_over_threshold_Qb{q_back}"])) < 4.0
    for rho in (0.1, 0.5):
        signal = object_signal(distance, rho, link, medium)
        taken = int((chosen(particles, distance, signal, link, "strongest").kind == PARTICLE).sum())
        expected = case[f"P_drop_over_thr_and_object_rho{rho}_Qb{q_back}"]
        assert abs(share_z_of_expected(taken, N_BEAMS, expected)) < 4.0


@pytest.mark.parametrize("link", [OS1, HDL64], ids=["OS1", "HDL64"])
@pytest.mark.parametrize("rate", [0.5, 1.0, 3.0])
def test_drawn_snow_of_the_default_near_range_has_the_integrated_shares(link: Link, rate: float) -> None:
    medium = default_medium("snow", rate)
    distance = np.full(N_BEAMS // 2, 28.0)
    particles = every_particle(distance, link, medium, rng=np.random.default_rng(3))
    for energy in (link.threshold, 4.0 * link.threshold, 16.0 * link.threshold):
        hit = np.unique(particles.beam[particles.signal >= energy]).size
        assert abs(share_z_of_expected(hit, distance.size, probability(energy, 28.0, link, medium))) < 4.0


def test_counts_per_beam_are_poisson_with_the_integrated_mean_for_every_object_range() -> None:
    medium = default_medium("snow", 3.0)
    distance = np.repeat([1.0, 5.0, 10.0, 28.0, np.inf], 30_000)
    particles = every_particle(distance, HDL64, medium, rng=np.random.default_rng(4))
    counts = np.bincount(particles.beam, minlength=distance.size).reshape(5, -1)
    for i, range_m in enumerate([1.0, 5.0, 10.0, 28.0, 120.0]):
        mean = lambda_by_quadrature(HDL64.threshold, range_m, HDL64, medium)
        n = counts.shape[1]
        assert abs(counts[i].mean() - mean) <= 4.0 * math.sqrt(mean / n)
        # Variance of the sample variance of a Poisson variate: (mean + 2 mean^2) / n.
        assert abs(counts[i].var() - mean) <= 4.0 * math.sqrt((mean + 2.0 * mean**2) / n)


@pytest.mark.parametrize(("kind", "rate"), [("rain", 25.0), ("snow", 1.0)])
def test_thinned_slabs_draw_what_plain_rejection_in_a_box_draws(kind: Kind, rate: float) -> None:
    link = Link(0.0095, 0.003, 40.0, near_start_m=0.5, near_full_m=2.0, near_power=2.0, min_range_m=0.8)
    medium, end, n_beams = default_medium(kind, rate), 6.0, 60_000
    rng = np.random.default_rng(5)
    # All particles of a box around the cone, one box per beam; the formulas written out again, in millimetres.
    wide_mm = 9.5 + 3.0 * end
    sizes = medium.sizes
    total = rng.poisson(n_beams * sizes.per_m3 * (wide_mm * 1e-3) ** 2 * end)
    signals, ranges = [], []
    for n in np.diff(np.linspace(0, total, 9).astype(int)):
        across = rng.uniform(-wide_mm / 2.0, wide_mm / 2.0, (2, n))
        r = rng.uniform(0.0, end, n)
        beam_mm = 9.5 + 3.0 * r
        inside = (np.hypot(*across) < beam_mm / 2.0) & (r > 0.8)
        r, beam_mm = r[inside], beam_mm[inside]
        melted = sizes.diameters_mm(rng.random(r.size))
        if kind == "rain":
            bracket = np.minimum(melted**2 * 0.2 / (16.0 * math.pi / 4.0 * beam_mm**2), 0.2 / (4.0 * math.pi))
        else:
            physical = np.maximum(2.2947 * melted**1.4437, 1.0293 * melted)
            bracket = 0.9 / math.pi * np.minimum(1.0, (physical / beam_mm) ** 2)
        xi = np.minimum((r - 0.5) / 1.5, 1.0) ** 2
        x = bracket * xi * np.exp(-2.0 * medium.extinction_per_m * r) / r**2
        signals.append(x[x >= link.threshold])
        ranges.append(r[x >= link.threshold])
    x, r = np.concatenate(signals), np.concatenate(ranges)
    drawn = every_particle(np.full(4 * n_beams, end), link, medium, rng=rng)
    assert abs(len(drawn) / 4 - x.size) < 4.0 * math.sqrt(x.size * 1.25)
    assert x.size > 1000
    assert ks_distance(drawn.signal, x) < ks_critical(len(drawn), x.size)
    assert ks_distance(drawn.range_m, r) < ks_critical(len(drawn), x.size)


def test_a_flake_wider_than_the_beam_is_as_bright_as_one_that_fills_it() -> None:
    # A pencil beam, 1-4 mm wide: many flakes fill it, and an atom of the signals lies at the cap g(r).
    link = Link(0.001, 0.0003, 40.0, near_start_m=0.0, near_full_m=1e-9, min_range_m=1.0, max_range_m=10.0)
    medium = default_medium("snow", 3.0)
    distance = np.full(2_000_000, np.inf)
    particles = every_particle(distance, link, medium, rng=np.random.default_rng(10))
    cap = 0.9 / math.pi * np.exp(-2.0 * medium.extinction_per_m * particles.range_m) / particles.range_m**2
    assert np.all(particles.signal <= cap * (1.0 + 1e-12))
    filled = particles.signal >= cap * (1.0 - 1e-12)
    physical_m = 1e-3 * np.maximum(2.2947 * particles.diameter_mm**1.4437, 1.0293 * particles.diameter_mm)
    assert np.array_equal(filled, physical_m >= link.beam_diameter_m(particles.range_m))
    assert 0.05 < filled.mean() < 0.95
    for energy in (link.threshold, 0.004, 0.01, 0.05):  # the last two above g(10 m) and g(5 m)
        mean = distance.size * lambda_by_quadrature(energy, 10.0, link, medium)
        assert mean > 100.0
        assert abs(int((particles.signal >= energy).sum()) - mean) < 4.0 * math.sqrt(mean)


def test_lower_floor_only_adds_weaker_particles() -> None:
    medium = default_medium("snow", 1.0)
    distance = np.full(40_000, 28.0)
    high = every_particle(distance, OS1, medium, rng=np.random.default_rng(6))
    low = every_particle(distance, OS1, medium, rng=np.random.default_rng(7), energy_floor=0.1 * OS1.threshold)
    assert low.signal.min() >= 0.1 * OS1.threshold
    above = low.signal >= OS1.threshold
    assert len(low) > 2 * above.sum()
    assert abs(int(above.sum()) - len(high)) < 4.0 * math.sqrt(2.0 * len(high))
    assert ks_distance(low.range_m[above], high.range_m) < ks_critical(int(above.sum()), len(high))


def test_strongest_particle_s_range_has_the_law_of_the_energy_derivative() -> None:
    # PHYSICS.md 5.3: given e* the range follows d_e Lambda(e*, r) / d_e Lambda(e*, R), not Lambda(e*, r) over
    # Lambda(e*, R).
    link, medium = HDL64, default_medium("snow", 3.0)
    distance = np.full(400_000, np.inf)
    best = chosen(
        every_particle(distance, link, medium, rng=np.random.default_rng(8)), distance, 0.0, link, "strongest"
    )
    low, high = 4.0 * link.threshold, 4.4 * link.threshold
    r = np.sort(best.range_m[(best.signal >= low) & (best.signal < high)])
    grid = np.linspace(2.0, 30.0, 113)
    rows = np.array([[lambda_by_quadrature(e, float(at), link, medium) for at in grid] for e in (low, high)])
    derivative, table = rows[0] - rows[1], rows[0]
    drawn = np.searchsorted(r, grid) / r.size
    # One-sample KS at 1e-3 is 1.95 / sqrt(n); the finite band of energies adds less than 0.01.
    assert np.abs(drawn - derivative / derivative[-1]).max() < 1.95 / math.sqrt(r.size) + 0.01
    assert np.abs(drawn - table / table[-1]).max() > 0.1


@pytest.mark.parametrize(
    "row",
    [pytest.param(row, marks=[] if row["sensor"] == "OS1" else [pytest.mark.long]) for row in TABLE["rows"]],
    ids=lambda row: f"{row['sensor']} {row['weather']} {row['rate_mm_per_h']}",
)
def test_committed_table_is_what_the_quadrature_gives(row: dict[str, Any]) -> None:
    numbers = dict(TABLE["sensors"][row["sensor"]])
    alpha = effective_extinction_per_m(row["weather"], row["rate_mm_per_h"], numbers.pop("wavelength_nm"))
    assert row["effective_extinction_per_m"] == pytest.approx(alpha, rel=1e-6)
    sizes = population(row["weather"], row["rate_mm_per_h"])
    medium = Medium(sizes, flake_reflectivity=FLAKE_REFLECTIVITY, extinction_per_m=alpha)
    assert shares(Link(**numbers), medium) == pytest.approx(row["P"], rel=1e-6, abs=1e-15)


def test_printed_figures_of_the_ramp_from_0p9_to_1_m() -> None:
    # PHYSICS.md 5.3, OS1, Q_back 0.0943 and 0.3, q_eff 2, extinction of the block `rain`; two or three digits.
    link = replace(OS1, near_start_m=0.9, near_full_m=1.0)
    alpha = {rate: load("rain")["rows"][f"{rate}"]["865"]["ext"] for rate in (10, 25, 50)}
    for q_back, printed in ((0.0943, (0.042, 0.080, 0.124)), (0.3, (0.146, 0.238, 0.332))):
        for rate, value in zip(alpha, printed, strict=True):
            medium = Medium(population("rain", rate), q_back=q_back, extinction_per_m=alpha[rate])
            assert probability(link.threshold, 50.0, link, medium) == pytest.approx(value, rel=0.01)
    printed_objects = {
        (0.1, 10.0): (9.0e-5, 4.4e-4, 1.3e-3),
        (0.1, 28.0): (0.017, 0.040, 0.074),
        (0.5, 28.0): (4.9e-4, 0.0020, 0.0055),
    }
    for (rho, range_m), values in printed_objects.items():
        for rate, value in zip(alpha, values, strict=True):
            medium = Medium(population("rain", rate), q_back=0.0943, extinction_per_m=alpha[rate])
            energy = float(object_signal(range_m, rho, link, medium))
            assert probability(energy, range_m, link, medium) == pytest.approx(value, rel=0.025)


def echoes(*rows: tuple[int, float, float]) -> Echoes:
    """Echoes of (beam, range m, signal in thresholds of OS1), diameter 1 mm."""
    table = np.array(sorted(rows), dtype=np.float64).reshape(-1, 3)
    return Echoes(table[:, 0].astype(np.int64), table[:, 1], table[:, 2] * OS1.threshold, np.ones(len(table)))


def one(particles: Echoes, range_m: float, signal: float, mode: ReturnMode) -> Chosen:
    return chosen(particles, [range_m], [signal * OS1.threshold], OS1, mode)


def test_strongest_first_and_last_of_three_separate_echoes() -> None:
    particles = echoes((0, 4.0, 3.0), (0, 8.0, 5.0))
    for mode, kind, range_m in (("strongest", PARTICLE, 8.0), ("first", PARTICLE, 4.0), ("last", OBJECT, 30.0)):
        got = one(particles, 30.0, 2.0, mode)  # type: ignore[arg-type]
        assert (got.kind[0], got.range_m[0]) == (kind, range_m)
    dual = one(particles, 30.0, 2.0, "dual")
    assert dual.second is not None
    assert (dual.range_m[0], dual.second.range_m[0]) == (8.0, 30.0)
    same = one(particles, 30.0, 9.0, "dual")
    assert same.second is not None
    assert (same.kind[0], same.second.kind[0]) == (OBJECT, LOST)


def test_echoes_closer_than_the_separation_merge_into_the_stronger_one() -> None:
    assert one(echoes((0, 4.0, 3.0), (0, 5.49, 2.0)), np.inf, 0.0, "last").range_m[0] == 4.0
    assert one(echoes((0, 4.0, 3.0), (0, 5.5, 2.0)), np.inf, 0.0, "last").range_m[0] == 5.5  # strictly closer
    assert one(echoes((0, 4.0, 3.0)), 5.0, 2.0, "last").kind[0] == PARTICLE  # objects are absorbed too
    assert one(echoes((0, 4.0, 3.0)), 5.0, 4.0, "first").kind[0] == OBJECT


def test_an_absorbed_echo_absorbs_the_weaker_ones_near_it() -> None:
    # 2 lies near 3 and is gone; 1 lies near 2 only, and is gone with it.
    got = one(echoes((0, 4.0, 3.0), (0, 5.0, 2.0), (0, 6.0, 1.5)), np.inf, 0.0, "last")
    assert got.range_m[0] == 4.0


def test_an_echo_below_threshold_neither_counts_nor_absorbs() -> None:
    assert one(echoes((0, 4.0, 0.99)), np.inf, 0.0, "strongest").kind[0] == LOST
    assert one(echoes((0, 4.0, 1.0)), np.inf, 0.0, "strongest").kind[0] == PARTICLE
    assert one(echoes((0, 4.0, 0.9)), 4.5, 0.8, "strongest").kind[0] == LOST


def test_an_object_before_the_near_range_is_always_reported() -> None:
    for mode in MODES:
        got = one(echoes((0, 4.0, 1e9)), 1.9, 0.0, mode)
        assert (got.kind[0], got.range_m[0]) == (OBJECT, 1.9)
    assert len(every_particle([1.9] * 1000, OS1, default_medium("snow", 5.0), rng=np.random.default_rng(0))) == 0


def naive(particles: Echoes, range_m: float, signal: float, beam: int, link: Link) -> list[tuple[float, float, int]]:
    """Surviving echoes of one beam, by a loop over pairs: (range, signal, kind)."""
    mine = particles.beam == beam
    found = [(r, x, PARTICLE) for r, x in zip(particles.range_m[mine], particles.signal[mine], strict=True)]
    if math.isfinite(range_m):
        found.append((range_m, signal, OBJECT))
    found = [echo for echo in found if echo[1] >= link.threshold]
    return [
        (r, x, kind)
        for r, x, kind in found
        if not any(y > x and abs(s - r) < link.echo_separation_m for s, y, _ in found)
    ]


def test_choice_equals_a_loop_over_pairs_in_dense_snow() -> None:
    rng = np.random.default_rng(9)
    n = 3000
    distance = np.where(rng.random(n) < 0.2, np.inf, rng.uniform(2.0, 60.0, n))
    link, medium = replace(HDL64, echo_separation_m=0.7), default_medium("snow", 5.0)
    particles = every_particle(distance, link, medium, rng=rng)
    signal = object_signal(np.minimum(distance, 1e6), 0.1, link, medium)
    assert len(particles) > n
    assert all(np.diff(particles.range_m)[np.diff(particles.beam) == 0] >= 0.0)
    got = {mode: chosen(particles, distance, signal, link, mode) for mode in MODES}
    twice = 0
    for beam in range(n):
        left = naive(particles, float(distance[beam]), float(signal[beam]), beam, link)
        twice += len(left) > 1
        picks = {
            "strongest": max(left, key=lambda echo: echo[1], default=(0.0, 0.0, LOST)),
            "first": min(left, default=(0.0, 0.0, LOST)),
            "last": max(left, default=(0.0, 0.0, LOST)),
        }
        for mode, pick in picks.items():
            mine = got[mode]  # type: ignore[index]
            assert (mine.range_m[beam], mine.signal[beam], mine.kind[beam]) == pick
        dual = got["dual"]
        assert (dual.range_m[beam], dual.signal[beam], dual.kind[beam]) == picks["strongest"]
        second = picks["last"] if picks["last"] != picks["strongest"] else (0.0, 0.0, LOST)
        assert dual.second is not None
        assert (dual.second.range_m[beam], dual.second.signal[beam], dual.second.kind[beam]) == second
    assert twice > n // 10


def test_quadrature_falls_with_energy_and_grows_with_range() -> None:
    medium = default_medium("snow", 1.0)
    by_energy = [lambda_by_quadrature(e * OS1.threshold, 28.0, OS1, medium) for e in (0.01, 0.1, 1.0, 10.0, 100.0)]
    by_range = [lambda_by_quadrature(OS1.threshold, r, OS1, medium) for r in (1.0, 2.5, 5.0, 10.0, 50.0)]
    assert all(a > b for a, b in pairwise(by_energy))
    assert all(a < b for a, b in pairwise(by_range))
    assert by_range[0] == 0.0
    # Without a floor every particle of the cone is counted.
    cone = float(OS1.volume_m3(28.0) - OS1.volume_m3(2.0)) * medium.sizes.per_m3
    assert lambda_by_quadrature(1e-30, 28.0, OS1, medium) == pytest.approx(cone, rel=1e-5)
