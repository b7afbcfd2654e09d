from __future__ import annotations

import threading

import pytest
import torch

from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow
from torchweather.core.threads import one_thread_an_operation, side_by_side
from torchweather.sensors import Camera
from torchweather.transforms import BayerWeather


@pytest.fixture(params=[1, 2, 3])
def threads(request: pytest.FixtureRequest) -> int:
    return int(request.param)


@pytest.fixture(autouse=True)
def _restore_threads() -> object:
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


def test_every_task_runs_once_and_torch_keeps_its_threads(threads: int) -> None:
    torch.set_num_threads(threads)
    done = torch.zeros(20)
    side_by_side([lambda i=i: done[i].add_(1) for i in range(20)])  # type: ignore[misc]
    assert torch.equal(done, torch.ones(20))
    assert torch.get_num_threads() == threads


def test_tasks_run_their_operations_on_one_thread_and_new_threads_have_the_default(threads: int) -> None:
    torch.set_num_threads(threads)
    seen: list[int] = []
    side_by_side([lambda: seen.append(torch.get_num_threads())] * 8)
    assert set(seen) == {1}
    later: list[int] = []
    other = threading.Thread(target=lambda: later.append(torch.get_num_threads()))
    other.start()
    other.join()
    assert later == [threads]


def test_an_error_in_a_task_reaches_the_caller(threads: int) -> None:
    torch.set_num_threads(threads)

    def fail() -> None:
        raise ValueError("broken portion")

    with pytest.raises(ValueError, match="broken portion"):
        side_by_side([fail, fail])
    assert torch.get_num_threads() == threads


def test_one_thread_an_operation_gives_the_threads_back(threads: int) -> None:
    torch.set_num_threads(threads)
    with one_thread_an_operation():
        assert torch.get_num_threads() == 1
    assert torch.get_num_threads() == threads


def test_a_frame_has_the_same_bits_on_any_number_of_threads() -> None:
    camera = Camera.from_intrinsics(600.0, 600.0, 191.5, 143.5, 384, 288)
    weather = Mixture(Rain(20.0), Snow(1.0), Fog(150.0))
    transform = BayerWeather(weather, camera, depth=60.0, airlight=0.7)
    frame = torch.rand(1, 288, 384, generator=torch.Generator().manual_seed(0))
    frames = []
    for number in (1, 2, 3):
        torch.set_num_threads(number)
        frames.append(transform(frame, noise=transform.draw(frame, seed=5)))
    assert torch.equal(frames[0], frames[1])
    assert torch.equal(frames[0], frames[2])
