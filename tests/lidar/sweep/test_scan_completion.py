"""Sweeps completed: the beams that were taken out come back, where they ended, on their laser's cone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from torchweather.atmosphere.weather import Snow
from torchweather.lidar import BeamEnd, fit_ground
from torchweather.lidar.sweep import completion
from torchweather.lidar.sweep.beam_heights import beam_heights_m
from torchweather.lidar.sweep.completion import complete_scan
from torchweather.lidar.sweep.echo_pairs import first_rows
from torchweather.sensors import Lidar
from torchweather.stages import PointKind
from torchweather.transforms import LidarSnow

COLUMNS = 720
ELEVATIONS_DEG = tuple(float(e) for e in np.concatenate([np.arange(3.0, -8.1, -0.5), np.arange(-9.0, -24.1, -1.0)]))
HEIGHTS_M = tuple(0.2 if e > -8.3 else 0.12 for e in ELEVATIONS_DEG)
RINGS = len(ELEVATIONS_DEG)
SENSOR = Lidar(
    905.0,
    elevations_deg=ELEVATIONS_DEG,
    origin_heights_m=HEIGHTS_M,
    columns=COLUMNS,
    max_range_m=100.0,
    near_start_m=1.0,
    near_full_m=10.0,
    intensity_unit="reflectivity",
)


def sweep() -> tuple[Tensor, Tensor, Tensor]:
    """A sweep ``(N, 6)`` over a road 1.7 m below and a wall 15 m to the right: x, y, z, intensity, ring, time.

    Also which of its beams return, and the ring of each.
    """
    ring, column = torch.meshgrid(torch.arange(RINGS), torch.arange(COLUMNS), indexing="ij")
    ring, column = ring.flatten(), column.flatten()
    elevation = torch.deg2rad(torch.tensor(ELEVATIONS_DEG, dtype=torch.float64))[ring]
    azimuth = torch.deg2rad((column + 0.5) * 360.0 / COLUMNS)
    height = torch.tensor(HEIGHTS_M, dtype=torch.float64)[ring]
    way = torch.stack([elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin()], -1)
    road = torch.where(way[:, 2] < 0, (1.7 + height) / -way[:, 2].clamp(max=-1e-9), torch.inf)
    wall = torch.where(way[:, 1] < 0, -15.0 / way[:, 1].clamp(max=-1e-9), torch.inf)
    range_m = torch.minimum(road, wall)
    returns = (range_m < 60.0) & (torch.arange(len(ring)) % 37 != 5)
    xyz = way * range_m.clamp(max=1e3)[:, None]
    xyz[:, 2] += height
    time = column.double() / COLUMNS
    cloud = torch.cat([xyz, torch.full_like(time, 0.2)[:, None], ring.double()[:, None], time[:, None]], -1)
    return cloud.float(), returns, ring


def with_column() -> Lidar:
    return replace(SENSOR, ring_column=4)


def run(cloud: Tensor, sensor: Lidar, complete: bool | str = True, lost: str = "zero"):  # type: ignore[no-untyped-def]
    snow = LidarSnow(Snow(rate_mm_per_h=2.0), sensor, complete_scan=complete, lost=lost)
    return snow.run(cloud, snow.draw(cloud, seed=3))


@pytest.mark.parametrize("column", [True, False])
def test_the_beams_taken_out_come_back_where_they_were(column: bool) -> None:
    cloud, returns, ring = sweep()
    found = complete_scan(cloud[returns], with_column() if column else SENSOR)
    assert len(found.direction) == int((~returns).sum())
    assert torch.equal(torch.bincount(found.ring, minlength=RINGS), torch.bincount(ring[~returns], minlength=RINGS))
    elevation = torch.rad2deg(torch.asin(found.direction[:, 2].double()))
    assert (elevation - torch.tensor(ELEVATIONS_DEG, dtype=torch.float64)[found.ring]).abs().max() < 1e-3
    assert found.height_m is not None
    assert torch.equal(found.height_m, torch.tensor(HEIGHTS_M)[found.ring])
    assert ("ring column" if column else "order of the rows") in found.words
    counts = torch.bincount(found.end.long(), minlength=6)
    assert int(counts[BeamEnd.SKY]) > 1000
    assert int(counts[BeamEnd.GROUND]) > 300
    assert found.words.startswith(f"completed from the scan pattern with {len(found.direction)} beams, which end: ")


def test_sky_alone_keeps_to_the_sky_and_rows_are_whole() -> None:
    cloud, returns, _ = sweep()
    found = complete_scan(cloud[returns], with_column(), sky_alone=True)
    assert (found.end == int(BeamEnd.SKY)).all()
    assert "only beams that end in the sky" in found.words
    every = complete_scan(cloud[returns], with_column())
    assert torch.equal(every.rows[:, 4], every.ring.float())
    azimuth = torch.rad2deg(torch.atan2(every.direction[:, 1], every.direction[:, 0])) % 360.0
    # Time is that of the nearest return of the ring; a gap in the sky may be half a turn wide.
    near = every.end != int(BeamEnd.SKY)
    off = (every.rows[:, 5] - azimuth / 360.0).abs()
    assert float(torch.minimum(off, 1 - off)[near].median()) < 2.0 / COLUMNS
    assert not every.rows[:, :4].any()


def test_cones_that_are_not_the_sensors_are_taken_from_the_sweep() -> None:
    cloud, returns, _ = sweep()
    wrong = replace(SENSOR, elevations_deg=tuple(e + 0.3 for e in ELEVATIONS_DEG), origin_heights_m=None)
    found = complete_scan(cloud[returns], wrong)
    assert "their cones from the sweep" in found.words
    elevation = torch.rad2deg(torch.asin(found.direction[:, 2].double()))
    of_ring = torch.tensor(ELEVATIONS_DEG)[found.ring]
    both = (of_ring < -3.0) & (of_ring > -6.0)  # rings on road and wall: one range alone says nothing of the height
    assert (elevation - of_ring)[both].abs().max() < 0.02


@pytest.mark.filterwarnings("ignore::torchweather.core.errors.TorchweatherWarning")
def test_more_beams_than_a_turn_has_are_refused_with_the_evidence() -> None:
    cloud, returns, _ = sweep()
    with pytest.raises(ValueError, match=r"rings x 360 columns are .* % off"):
        complete_scan(cloud[returns], replace(with_column(), columns=COLUMNS // 2))


def test_flakes_lie_above_the_road_before_their_ends_and_on_their_cones() -> None:
    cloud, returns, _ = sweep()
    result = run(cloud[returns], with_column())
    flake = result.kind == PointKind.PARTICLE
    assert int(flake.sum()) > 500
    places = result.points[flake].double()
    ground = fit_ground(cloud[returns, :3].numpy())
    assert ground is not None
    assert ground.height_above(places[:, :3].numpy()).min() > -0.05
    of_ring = places[:, 4].long()
    height = torch.tensor(HEIGHTS_M, dtype=torch.float64)[of_ring]
    off = torch.rad2deg(torch.atan2(places[:, 2] - height, places[:, :2].norm(dim=-1)))
    off -= torch.tensor(ELEVATIONS_DEG, dtype=torch.float64)[of_ring]
    assert float(off.abs().max()) < 0.01
    ends = result.beam_end[flake]
    assert set(ends.unique().tolist()) <= {BeamEnd.RETURN, BeamEnd.SKY, BeamEnd.GROUND, BeamEnd.OBSTACLE}
    assert int((ends == BeamEnd.SKY).sum()) > 50


def test_objects_keep_their_bits_and_rows_without_weather_are_those_of_the_input() -> None:
    cloud, returns, _ = sweep()
    given = cloud[returns]
    result = run(given, with_column())
    kept = result.kind[: len(given)] == PointKind.OBJECT
    assert torch.equal(result.points[: len(given)][kept][:, :3], given[kept][:, :3])
    calm = LidarSnow(Snow(rate_mm_per_h=0.0), with_column(), complete_scan=True, lost="drop")
    assert torch.equal(calm(given, calm.draw(given, seed=0)), given)


def test_a_draw_and_its_call_find_the_beams_once_and_changed_points_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    import torchweather.lidar.beams as beams

    cloud, returns, _ = sweep()
    given, calls = cloud[returns].clone(), []
    find = beams.completed  # type: ignore[attr-defined]

    def counted(*args: object, **kwargs: object) -> object:
        calls.append(1)
        return find(*args, **kwargs)  # type: ignore[arg-type]

    monkeypatch.setattr(beams, "completed", counted)
    snow = LidarSnow(Snow(rate_mm_per_h=1.0), with_column(), complete_scan=True)
    noise = snow.draw(given, seed=1)
    first = snow(given, noise)
    assert len(calls) == 1
    given.numpy()[0, 0] += 1e-3  # as a simulator that fills its buffer anew
    snow(given, noise)
    assert len(calls) == 2
    snow.sensor = replace(snow.sensor, max_range_m=40.0)
    snow(given, noise)
    assert len(calls) == 3
    with pytest.raises(ValueError, match="complete_scan is for clouds without directions"):
        snow(given, noise, directions=given[:, :3])
    again = LidarSnow(Snow(rate_mm_per_h=1.0), with_column(), complete_scan=True)
    assert torch.equal(again(cloud[returns], noise), first)


def test_a_batch_is_its_samples() -> None:
    cloud, returns, _ = sweep()
    fewer = cloud[returns].clone()
    fewer[::11, :3] = 0.0
    batch = torch.stack([cloud[returns], fewer])
    snow = LidarSnow(Snow(rate_mm_per_h=1.0), with_column(), complete_scan=True, lost="drop")
    together = snow(batch, snow.draw(batch, seed=5))
    for sample in (0, 1):
        alone = snow(batch[sample], snow.draw(batch[sample], seed=5 + sample))
        assert torch.equal(together[sample][:, :4], alone[:, :4])


def test_echoes_of_one_beam_meet_the_same_particles() -> None:
    cloud, returns, _ = sweep()
    pairs = cloud[returns].repeat_interleave(2, 0)
    result = run(pairs, with_column(), complete=False)
    assert torch.equal(result.kind[::2], result.kind[1::2])
    assert torch.equal(result.points[::2], result.points[1::2])
    assert int((result.kind == PointKind.PARTICLE).sum()) > 100
    completed = run(pairs, with_column())
    assert torch.equal(completed.kind[: len(pairs)][::2], completed.kind[: len(pairs)][1::2])
    assert len(completed.kind) == RINGS * COLUMNS + int(returns.sum())


def test_first_rows_are_those_of_a_search_of_every_pair() -> None:
    rng = np.random.default_rng(2)
    azimuth, ring = np.radians(rng.integers(0, 60, 200) * 6.0 + rng.uniform(-0.4, 0.4, 200)), rng.integers(-1, 4, 200)
    xyz = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(200)], -1) * rng.uniform(2, 50, (200, 1))
    found = first_rows(xyz, ring, 6.0)
    degrees = np.degrees(azimuth) % 360.0
    for row in range(200):
        near = (np.abs(degrees - degrees[row]) < 2.0) & (ring == ring[row])
        assert found[row] == (row if ring[row] < 0 else np.flatnonzero(near)[0])


def test_heights_without_rings_are_those_of_the_nearest_cone() -> None:
    cloud, returns, ring = sweep()
    far = cloud[returns][:, :2].norm(dim=-1) > 4.0
    found = beam_heights_m(cloud[returns], SENSOR)
    assert found is not None
    right = found == torch.tensor(HEIGHTS_M)[ring[returns]]
    assert float(right[far].float().mean()) > 0.999
    assert beam_heights_m(cloud, replace(SENSOR, origin_heights_m=None)) is None


def test_a_file_with_a_row_for_every_beam_says_how_many_returned_nothing() -> None:
    row_ring = torch.tensor([0, 1, 2]).repeat(10)
    there = torch.ones(30, dtype=torch.bool)
    there[[0, 3, 6, 1, 4]] = False  # three on ring 0, two on ring 1, none on ring 2
    found = torch.tensor([0] * 5 + [1] * 2 + [2])
    kept = completion._as_many_as_rows(row_ring, there, found)
    assert torch.bincount(found[kept], minlength=3).tolist() == [3, 2, 0]
    assert kept[[0, 2, 4]].all(), "spread over the ring"
    unequal = torch.cat([row_ring, torch.tensor([0])])
    assert completion._as_many_as_rows(unequal, torch.cat([there, there[:1]]), found).all()


def test_rows_of_a_ring_without_returns_carry_its_number() -> None:
    cloud, returns, ring = sweep()
    without = returns & (ring != 9)
    found = complete_scan(cloud[without], with_column())
    assert int((found.ring == 9).sum()) == COLUMNS
    assert torch.equal(found.rows[:, 4], found.ring.float())
