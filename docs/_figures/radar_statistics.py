"""Statistics of radar frames in which effects show, each as a curve of its axis."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from effect_curves import Array, Curve, density, in_bins, middle
from radar_frames import CLASSES, RAIN, SENSOR, Frames, Targets, frames_of, targets_of

from torchweather.physics import wet_cover_series_db
from torchweather.stages import EFFECTS


def over_clear_air(
    targets: Targets, frames: Frames, axis: str, edges: Array, what: str = "power_db", margin_db: float = 12.0
) -> Curve:
    """Mean power, or SNR, over that in clear air, of targets that no effect drawn here takes under the threshold."""
    clear = {"power_db": targets.points[:, 4].numpy(), "snr_db": targets.margin_db + SENSOR.detection_snr_db}[what]
    ratio = getattr(frames, what) - clear
    picked = np.broadcast_to(targets.margin_db > margin_db, ratio.shape)
    return in_bins(np.broadcast_to(getattr(targets, axis), ratio.shape)[picked], ratio[picked], edges)


def of_classes(targets: Targets, frames: Frames) -> Curve:
    """Mean power over clear air's of each class."""
    place, ratio = over_clear_air(targets, frames, "kind", np.arange(len(CLASSES) + 1) - 0.5)
    return place, ratio


def lost_share(targets: Targets, frames: Frames, edges: Array) -> Curve:
    """Targets that are not listed, percent, by their margin in clear air."""
    lost = 100.0 * np.isnan(frames.power_db)
    return in_bins(np.broadcast_to(targets.margin_db, lost.shape), lost, edges)


def range_of(rows: Array) -> Array:
    """Range of detections, m."""
    found: Array = np.linalg.norm(rows[..., :3], axis=-1)
    return found


def more_by_range(targets: Targets, frames: Frames, edges: Array) -> Curve:
    """Detections besides the targets' in a frame, per metre of range."""
    return density(range_of(frames.more), edges, len(frames.more))


def more_by_speed(targets: Targets, frames: Frames, edges: Array) -> Curve:
    """Detections besides the targets' in a frame, per m/s of speed."""
    return density(frames.more[..., 3], edges, len(frames.more))


def behind_targets(targets: Targets, frames: Frames, edges: Array) -> Curve:
    """Ghosts by how far they stand behind their target, percent of the targets in a bin."""
    if not frames.more.shape[1]:
        return middle(edges), np.zeros(len(edges) - 1)
    behind = range_of(frames.more) - targets.range_m
    counts, _ = np.histogram(behind[np.isfinite(behind)], edges)
    return middle(edges), 100.0 * counts / behind.size


def ratio_share(targets: Targets, frames: Frames, edges: Array) -> Curve:
    """Targets by their power over that in clear air, percent per dB."""
    ratio = (frames.power_db - targets.points[:, 4].numpy())[:, targets.margin_db > 12.0]
    x, y = density(ratio, edges, ratio.size / 100.0)
    return x, y


def speed_share(targets: Targets, frames: Frames, edges: Array) -> Curve:
    """Targets, which stand still, by their measured speed, percent per 0.1 m/s."""
    speed = frames.speed_m_per_s
    return density(speed, edges, np.isfinite(speed).sum() / 10.0)


def by_frame(targets: Targets, frames: Frames, what: Callable[[Targets, Frames], Array]) -> Curve:
    """A number of each frame."""
    value = what(targets, frames)
    return np.arange(1, len(value) + 1), value


def floors(targets: Targets, frames: Frames) -> Array:
    """Noise floor of each frame, dBm."""
    return frames.floor_db


def listed(targets: Targets, frames: Frames) -> Array:
    """Targets that each frame lists, percent."""
    found: Array = 100.0 * np.isfinite(frames.power_db).mean(1)
    return found


def listed_of(targets: Targets, frames: Frames, sizes: Array) -> Curve:
    """Detections listed of a frame that holds so many targets."""
    effect = {"effect": "radar.detection_limit", **frames.setting} if frames.setting else {}
    found = [np.isfinite(frames_of(targets_of(int(size)), RAIN, effect, 1).power_db).sum() for size in sizes]
    return sizes, np.array(found)


def residuals(targets: Targets, frames: Frames) -> Array:
    """Mean range of each frame less that in clear air, cm."""
    found: Array = 100.0 * np.nanmean(frames.range_m - targets.range_m, axis=1)
    return found


def one_target(targets: Targets, frames: Frames) -> Array:
    """Power over clear air's of a strong target in the middle of the ranges, in each frame."""
    chosen = np.argmin(np.abs(targets.range_m - 25.0) + 50.0 * (targets.margin_db < 20.0))
    found: Array = frames.power_db[:, chosen] - targets.points[chosen, 4].numpy()
    return found


def drying(targets: Targets, frames: Frames, rain_min: float = 20.0, until_min: float = 90.0) -> Curve:
    """Loss of the cover through a shower of 25 mm/h and after it."""
    time = torch.arange(0.0, until_min + 0.25, 0.25)
    rain = torch.where((time >= 5.0) & (time < 5.0 + rain_min), 25.0, 0.0)
    values = EFFECTS["radar.wet_radome"](**frames.setting).config()
    return time.numpy(), wet_cover_series_db(rain, time, **values).numpy()
