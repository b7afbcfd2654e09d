"""WeatherDataset: a data set in weather, the same for the same seed, index and epoch whatever the workers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch.utils.data import Dataset

from torchweather.compose.samples import shared
from torchweather.core.arguments import check_arguments
from torchweather.core.random import sample_seed

__all__ = ["WeatherDataset"]


class WeatherDataset(Dataset[Any]):
    """A map-style data set whose samples get weather.

    Args:
        dataset: index to sample.
        transform: ``Compose``, or anything that is called with a sample and ``seed=``.
        seed: of all samples. A sample's own seed follows from it, the index and the epoch.
        after: called with the sample in weather and the results of ``Compose.run`` (key to ``LidarResult`` and the
            like); what it returns is the sample. The place to bring labels up to date.

    Example:
        >>> import torchweather as tw
        >>> clouds = [{"points": torch.tensor([[20.0, 0.0, 0.0, 120.0]])}] * 3
        >>> lidar = tw.LidarFog(tw.Fog(mor_m=(50, 400)), tw.Lidar.preset("velodyne-hdl-64e"))
        >>> foggy = WeatherDataset(clouds, tw.Compose({"points": lidar}), seed=7)
        >>> foggy.set_epoch(1)
        >>> torch.equal(foggy[2]["points"], foggy[2]["points"])
        True
    """

    def __init__(
        self,
        dataset: Any,
        transform: Callable[..., Any],
        *,
        seed: int = 0,
        after: Callable[[dict[str, Any], dict[str, Any]], Any] | None = None,
    ) -> None:
        check_arguments(
            "WeatherDataset(transform: Callable, seed: int, after: Callable | None)",
            transform,
            seed,
            after,
        )
        self.dataset, self.transform, self.seed, self.after = dataset, transform, int(seed), after
        self._epoch = shared(torch.zeros((), dtype=torch.int64))

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        shared(self._epoch)

    def set_epoch(self, epoch: int) -> None:
        """Another epoch, another weather for each sample; workers that live on see it, too."""
        self._epoch.fill_(int(epoch))

    def __len__(self) -> int:
        return len(self.dataset)

    def __getitem__(self, index: int) -> Any:
        if index < 0:
            index += len(self)
        seed = sample_seed(self.seed, int(index), int(self._epoch))
        sample = self.dataset[index]
        if self.after is None:
            return self.transform(sample, seed=seed)
        return self.after(*self.transform.run(sample, seed=seed))  # type: ignore[attr-defined]
