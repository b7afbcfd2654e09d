"""No frame is simulated twice, and frames that were kept are those that a fresh simulation gives."""

from __future__ import annotations

import numpy as np
import pytest

from torchweather.gap.inference.kept_frames import KeptFrames
from torchweather.gap.statistics.frame_statistics import Reduced


def of_places(setting: int, some: slice) -> Reduced:
    """Frames whose sums are their place, of a setting."""
    place = np.arange(some.start, some.stop, dtype=np.float64)[:, None] + 1000.0 * setting
    return Reduced(place, place, place, place, place[:, None])


@pytest.mark.parametrize("asked", [(6, 16, 48), (48, 6, 16), (16, 48, 6), (7, 48)])
def test_every_frame_is_simulated_once_whatever_is_asked_for_first(asked: tuple[int, ...]) -> None:
    kept, given = KeptFrames((6, 16, 48), 1000), []

    def simulate(some: slice) -> Reduced:
        given.append((some.start, some.stop))
        return of_places(3, some)

    for number in asked:
        found = kept.first("setting", number, simulate)
        np.testing.assert_array_equal(found.value[:, 0], 3000.0 + np.arange(number))
        assert found.maps.shape == (number, 1, 1)
    places = [place for first, last in sorted(given) for place in range(first, last)]
    assert places == list(range(48))
    assert kept.simulated == 48
    if 7 not in asked:
        assert sorted(given) == [(0, 6), (6, 16), (16, 48)]


def test_the_settings_that_were_asked_for_last_are_kept() -> None:
    kept, given = KeptFrames((6,), 12), []

    def ask(setting: int) -> None:
        def simulate(some: slice) -> Reduced:
            given.append(setting)
            return of_places(setting, some)

        found = kept.first(setting, 6, simulate)
        np.testing.assert_array_equal(found.value[:, 0], 1000.0 * setting + np.arange(6))

    for setting in (1, 2, 1, 3, 1, 2):  # the third takes the place of the second
        ask(setting)
    assert given == [1, 2, 3, 2]
    assert kept.simulated == 24


def test_one_setting_is_kept_however_large() -> None:
    kept = KeptFrames((), 4)
    for _ in range(2):
        assert len(kept.first("a", 9, lambda some: of_places(0, some))) == 9
    assert kept.simulated == 9
