"""Reduced frames that were simulated before, so that none is simulated twice.

A fit asks for the first frames of a point for its derivatives, for more of them for its cost, and for all of them for
the scatter at its end; its next step begins where the last one ended.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from itertools import pairwise

from torchweather.gap.statistics.frame_statistics import Reduced

__all__ = ["KeptFrames"]


class KeptFrames:
    """First frames of one condition at the settings that were asked for last.

    Args:
        ends: numbers of frames that are usually asked for, rising. Frames are simulated in parts that end there,
            so that the parts are the same whichever number is asked for first.
        most: number of frames that are kept, of all settings.

    Attributes:
        simulated: number of frames that were simulated.
    """

    def __init__(self, ends: Sequence[int], most: int) -> None:
        self.ends, self.most, self.simulated = sorted(ends), most, 0
        self._kept: OrderedDict[Hashable, Reduced] = OrderedDict()

    def first(self, key: Hashable, number: int, simulate: Callable[[slice], Reduced]) -> Reduced:
        """The first frames of a setting.

        Args:
            key: of the setting; equal keys stand for equal frames.
            number: of frames.
            simulate: frames from one place to another of the setting's seeds.
        """
        found = self._kept.pop(key, None)
        present = 0 if found is None else len(found)
        if present < number:
            edges = [present, *(end for end in self.ends if present < end < number), number]
            more = [simulate(slice(*part)) for part in pairwise(edges)]
            found = Reduced.joined(more if found is None else [found, *more])
            self.simulated += number - present
        assert found is not None
        self._kept[key] = found  # at the end: asked for last
        while len(self._kept) > 1 and sum(map(len, self._kept.values())) > self.most:
            self._kept.popitem(last=False)
        return found[:number]
