"""What the library answers for fixed seeds: transforms, effects, files, graphs, scores, and a gap study a sensor.

Names are those that users import, so that a case stays as it is when a file changes its folder.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

import torchweather as tw
from tests.camera.effects import camera_effect_scene
from tests.gap import tiny_camera_study, tiny_link_study, tiny_radar_study, tiny_study
from tests.lidar.effects import effect_scene
from tests.radar.effects import radar_effect_scene
from torchweather import io, metrics, scenes
from torchweather.export import draw_feed, to_onnx
from torchweather.gap import Study, find_gap
from torchweather.radar.power_map import MapAxes, PowerScale
from torchweather.recipes import list_recipes, load_recipe
from torchweather.stages import EFFECTS

Case = Callable[[], Any]
SEED = 7


def cases() -> dict[str, Case]:
    """Every case by name; each takes well under a second but for graphs and studies."""
    found: dict[str, Case] = {}
    for group in (_cameras, _lidars, _radars, _several, _effects, _recipes, _files, _graphs, _scores, _studies):
        found.update(group())
    return found


# ---- transforms ------------------------------------------------------------------------------------------------------

WEATHERS: dict[str, Any] = {
    "rain": tw.Rain(rate_mm_per_h=25.0),
    "fog": tw.Fog(mor_m=60.0),
    "snow": tw.Snow(rate_mm_per_h=2.0),
    "rain-in-fog": tw.Mixture(tw.Rain(rate_mm_per_h=25.0), tw.Fog(mor_m=200.0)),
}


def _cameras() -> dict[str, Case]:
    def raw(weather: Any, **more: Any) -> Any:
        transform = camera_effect_scene.rain_in_fog(weather, **more)
        mosaic, depth = camera_effect_scene.frame(), camera_effect_scene.depth()
        noise = transform.draw(mosaic, seed=SEED)
        return transform(mosaic, depth, noise), transform.run(mosaic, depth, noise)

    def rgb(weather: Any, **more: Any) -> Any:
        transform = tw.AsBayer(camera_effect_scene.rain_in_fog(weather), **more)
        picture = camera_effect_scene.frame().mul(255).to(torch.uint8).expand(-1, 3, -1, -1).contiguous()
        return transform(picture, camera_effect_scene.depth(), transform.draw(picture, seed=SEED))

    def eight_bit(weather: Any) -> Any:
        transform = camera_effect_scene.rain_in_fog(weather)
        mosaic = camera_effect_scene.frame().mul(4095).to(torch.int32).to(torch.uint16)
        return transform(mosaic, camera_effect_scene.depth(), transform.draw(mosaic, seed=SEED))

    def random() -> Any:
        picture = camera_effect_scene.frame(1)[0].mul(255).to(torch.uint8).expand(3, -1, -1).contiguous()
        torch.manual_seed(SEED)
        makers = (tw.RandomRain, tw.RandomFog, tw.RandomSnow)
        return [make(p=1.0, depth="auto", airlight=0.65)(picture) for make in makers]

    found: dict[str, Case] = {f"camera/raw/{name}": lambda w=w: raw(w) for name, w in WEATHERS.items()}
    found |= {f"camera/uint16/{name}": lambda w=w: eight_bit(w) for name, w in WEATHERS.items()}
    found |= {f"camera/rgb/{name}": lambda w=w: rgb(w) for name, w in WEATHERS.items()}
    found["camera/rgb/through-mosaic"] = lambda: rgb(WEATHERS["rain"], through_mosaic=True)
    found["camera/d34"] = lambda: raw(tw.Rain(rate_mm_per_h=25.0), variant="d3_4")
    found["camera/random"] = random
    return found


# Intensity of a white surface.
WHITE = {"reflectivity": 1.0, "reflectivity_percent": 100.0, "uint8_linear": 255.0, "uint8_calibrated": 100.0}
WHITE["photons"] = 5000.0


def _lidars() -> dict[str, Case]:
    def run(weather: Any, **sensor: Any) -> Any:
        transform = tw.LidarWeather(weather, effect_scene.scan_sensor(**sensor))
        points = effect_scene.cloud()
        unit = sensor.get("intensity_unit", "reflectivity")
        points[..., 3] *= WHITE[unit]
        if unit.startswith("uint8"):
            points[..., 3].round_()
        return transform.run(points, transform.draw(points, seed=SEED), directions=effect_scene.directions())

    def completed(choice: bool | str) -> Any:
        view = scenes.lidar_view(scenes.test_track(), _small_lidar(), range_noise_seed=SEED)
        cloud = view.points[view.hit].float()
        transform = tw.LidarWeather(tw.Snow(rate_mm_per_h=2.0), _small_lidar(), complete_scan=choice)
        return transform.run(cloud, transform.draw(cloud, seed=SEED))

    found: dict[str, Case] = {f"lidar/{name}": lambda w=w: run(w) for name, w in WEATHERS.items()}
    for mode in ("last", "first", "dual"):
        found[f"lidar/{mode}"] = lambda mode=mode: run(WEATHERS["snow"], return_mode=mode)
    found |= {f"lidar/completed-{choice}": lambda choice=choice: completed(choice) for choice in (True, "sky")}
    for unit in ("photons", "uint8_linear", "uint8_calibrated", "reflectivity_percent"):
        found[f"lidar/{unit}"] = lambda unit=unit: run(WEATHERS["fog"], intensity_unit=unit)
    return found


def _small_lidar() -> tw.Lidar:
    return tw.Lidar.preset("velodyne-vlp-16", intensity_unit="reflectivity")


def _radars() -> dict[str, Case]:
    def run(weather: Any, **more: Any) -> Any:
        transform = tw.RadarAttenuation(weather, radar_effect_scene.SENSOR, **more)
        points = radar_effect_scene.detections()
        return transform.run(points, transform.draw(points, seed=SEED))

    def power_map(weather: Any) -> Any:
        axes = MapAxes.of_turn(bins=64, bin_m=0.5, azimuths=40, dims=("range", "azimuth"))
        level = 60.0 + 20.0 * torch.rand(axes.shape, generator=torch.Generator().manual_seed(SEED))
        values = level.to(torch.uint8)
        radar = tw.Radar.preset("navtech-radiate")
        transform = tw.RadarMapWeather(weather, radar, axes=axes, scale=PowerScale.steps(0.5), noise_floor_db=35.0)
        return transform.run(values, transform.draw(values, seed=SEED))

    found: dict[str, Case] = {f"radar/{name}": lambda w=w: run(w) for name, w in WEATHERS.items()}
    found["radar/wet-snow"] = lambda: run(tw.Snow(rate_mm_per_h=3.0, melt_fraction=0.3))
    found["radar/d34"] = lambda: run(tw.Rain(rate_mm_per_h=25.0), variant="d3_4")
    found["radar-map/rain"] = lambda: power_map(tw.Rain(rate_mm_per_h=50.0))
    found["radar-map/snow"] = lambda: power_map(tw.Snow(rate_mm_per_h=2.0))
    return found


def _several() -> dict[str, Case]:
    def together() -> Any:
        transforms = {
            "image": camera_effect_scene.rain_in_fog(tw.Rain(rate_mm_per_h=10.0)),
            "points": tw.LidarRain(tw.Rain(rate_mm_per_h=10.0), effect_scene.scan_sensor()),
            "radar": tw.RadarAttenuation(tw.Rain(rate_mm_per_h=10.0), radar_effect_scene.SENSOR),
        }
        compose = tw.Compose(transforms, weather=tw.Rain(rate_mm_per_h=(1.0, 50.0)), history="weather")
        sample = {
            "image": camera_effect_scene.frame(1)[0],
            "depth": camera_effect_scene.depth(1)[0],
            "points": effect_scene.cloud(1)[0],
            "radar": radar_effect_scene.detections(1)[0],
        }
        return compose(sample, seed=SEED)

    return {"compose": together}


# ---- effects ---------------------------------------------------------------------------------------------------------


def _effects() -> dict[str, Case]:
    def camera(name: str) -> Any:
        transform = camera_effect_scene.rain_in_fog(effects=[camera_effect_scene.active(name)])
        mosaic = camera_effect_scene.frame()
        noise = transform.draw(mosaic, seed=SEED)
        return transform(mosaic, camera_effect_scene.depth(), noise, normal=camera_effect_scene.normals())

    def lidar(name: str) -> Any:
        transform = effect_scene.rain(effects=[effect_scene.active(name)])
        points = effect_scene.cloud()
        return transform.run(points, transform.draw(points, seed=SEED), directions=effect_scene.directions())

    def radar(name: str) -> Any:
        transform = radar_effect_scene.rain(effects=[radar_effect_scene.active(name)])
        points = radar_effect_scene.detections()
        return transform.run(points, transform.draw(points, seed=SEED), **radar_effect_scene.known())

    makers = {"camera": camera, "lidar": lidar, "radar": radar}
    return {
        f"effects/{name}": lambda name=name: makers[name.split(".")[0]](name)
        for name in EFFECTS
        if name.split(".")[0] in makers
    }


def _recipes() -> dict[str, Case]:
    def built(name: str) -> Any:
        transform = load_recipe(name)
        return {"class": type(transform).__name__, "buffers": transform.state_dict()}

    return {
        "recipes/transforms": lambda: {recipe.name: built(recipe.name) for recipe in list_recipes("transform")},
        "recipes/multi_sensor": lambda: {one.name: _without_path(one) for one in list_recipes("multi_sensor")},
        "recipes/suites": lambda: {one.name: _without_path(one) for one in list_recipes("suite")},
        "presets": lambda: [
            {name: repr(kind.preset(name)) for name in kind.presets()} for kind in (tw.Camera, tw.Lidar, tw.Radar)
        ],
    }


def _without_path(one: Any) -> str:
    """A recipe in words, without the place of its file and of those in it."""
    return re.sub(r"PosixPath\('[^']*'\)", "path", repr(one))


# ---- files -----------------------------------------------------------------------------------------------------------


def _files() -> dict[str, Case]:
    def points(suffix: str, encoding: str | None) -> Any:
        cloud = effect_scene.cloud(1)[0]
        if suffix == ".pcd.bin":  # with a ring
            cloud = torch.cat([cloud, torch.arange(len(cloud))[:, None] % 32], 1)
        return _through(suffix, lambda path: io.write_points(path, cloud, encoding=encoding), io.read_points)

    def image(suffix: str, picture: Tensor) -> Any:
        return _through(suffix, lambda path: io.write_image(path, picture), io.read_image)

    def radar(form: str) -> Any:
        rows = radar_effect_scene.detections(1)[0, :, :6]
        return _through(
            f".{form}",
            lambda path: io.write_radar(path, rows, format=form),
            lambda path: io.read_radar(path, radar_effect_scene.SENSOR, format=form),
        )

    def labels() -> Any:
        given = io.PointLabels(torch.arange(5), torch.arange(5) * 3)
        return _through(".label", lambda path: io.write_labels(path, given), lambda path: io.read_labels(path, 5))

    def boxes() -> Any:
        given = io.Boxes(
            torch.tensor([[10.0, 1.0, -1.0]]), torch.tensor([[4.0, 1.8, 1.5]]), torch.tensor([0.3]), ("Car",)
        )
        axes = torch.tensor([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]], dtype=torch.float64)
        return _through(
            ".txt",
            lambda path: io.write_kitti_boxes(path, given, axes),
            lambda path: io.read_kitti_boxes(path, axes),
        )

    def table() -> Any:
        columns = {"rate": [0.1, 1e-9, None], "name": ["a", 'b "c"', None]}
        return _through(".csv", lambda path: io.write_table(path, columns), io.read_table)

    def calibration() -> Any:
        text = "".join(f"P{k}: 700 0 600 {k} 0 700 180 0 0 0 1 0\n" for k in range(4))
        text += "R0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: 0 -1 0 0 0 0 -1 0 1 0 0 0\n"
        return _through(".txt", lambda path: path.write_text(text), io.read_kitti_calibration)

    colours = torch.arange(3 * 8 * 12, dtype=torch.uint8).reshape(3, 8, 12)
    mosaic = (torch.arange(96, dtype=torch.int32) * 680).to(torch.uint16).reshape(8, 12)
    found: dict[str, Case] = {}
    for suffix, encoding in (
        (".bin", None),
        (".pcd.bin", None),
        *((".pcd", one) for one in io.PCD_ENCODINGS),
        *((".ply", one) for one in io.PLY_ENCODINGS),
        (".csv", None),
        (".npz", None),
    ):
        name = f"files/points{suffix}" + (f"-{encoding}" if encoding else "")
        found[name] = lambda suffix=suffix, encoding=encoding: points(suffix, encoding)
    for suffix in (".png", ".tiff", ".npy", ".jpg"):
        found[f"files/colours{suffix}"] = lambda suffix=suffix: image(suffix, colours)
    for suffix in (".png", ".tiff", ".npy"):
        found[f"files/mosaic{suffix}"] = lambda suffix=suffix: image(suffix, mosaic)
    found |= {f"files/radar-{form}": lambda form=form: radar(form) for form in ("pcd", "npz", "csv")}
    found |= {
        "files/labels": labels,
        "files/boxes": boxes,
        "files/table": table,
        "files/calibration": calibration,
    }
    return found


def _through(suffix: str, write: Callable[[Path], Any], read: Callable[[Path], Any]) -> Any:
    """Bytes of a file and what is read from them; of an archive, which holds times, only the latter."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"file{suffix}"
        write(path)
        return {"bytes": None if suffix == ".npz" else path.read_bytes(), "read": read(path)}


# ---- graphs ----------------------------------------------------------------------------------------------------------


def _graphs() -> dict[str, Case]:
    def answers(transform: Any, size: dict[str, int], given: dict[str, Any]) -> Any:
        import onnxruntime

        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "graph.onnx"
            names = to_onnx(transform, path, **size)
            session = onnxruntime.InferenceSession(str(path))
            feed = draw_feed(session, **size, seed=SEED) | given
            wanted = {one.name: one for one in session.get_inputs()}
            feed = {name: feed[name] for name in wanted}
            return {"inputs": names, "outputs": session.run(None, feed)}

    def camera() -> Any:
        mosaic, depth = camera_effect_scene.frame(1), camera_effect_scene.depth(1)
        own = camera_effect_scene.camera()
        given = {"bayer": mosaic.numpy(), "depth": depth.numpy(), "mor_m": np.array([60.0], np.float32)}
        given |= {name: np.array(getattr(own, name), np.float32) for name in ("fx", "fy", "cx", "cy")}
        transform = camera_effect_scene.rain_in_fog(tw.Fog(mor_m=60.0))
        return answers(transform, {"height": mosaic.shape[-2], "width": mosaic.shape[-1]}, given)

    def lidar() -> Any:
        given = {"points": effect_scene.cloud(1).numpy(), "rate_mm_per_h": np.array([25.0], np.float32)}
        return answers(effect_scene.rain(), {"points": effect_scene.BEAMS}, given)

    def radar() -> Any:
        points = radar_effect_scene.detections(1)[..., :6].numpy()
        given = {"points": points, "rate_mm_per_h": np.array([25.0], np.float32)}
        return answers(radar_effect_scene.rain(), {"points": radar_effect_scene.TARGETS}, given)

    return {"graphs/camera": camera, "graphs/lidar": lidar, "graphs/radar": radar}


# ---- scores ----------------------------------------------------------------------------------------------------------


def _scores() -> dict[str, Case]:
    def images() -> Any:
        one = torch.rand(1, 3, 176, 176, generator=torch.Generator().manual_seed(SEED)).cumsum(-1) / 176.0
        other = (0.9 * one + 0.05).clamp(0.0, 1.0)
        return metrics.image_scores(other, one)

    def clouds() -> Any:
        one = effect_scene.cloud(1)[0, :, :3]
        one = one[one.square().sum(-1) > 0]
        other = one[::2] + 0.05
        return {
            "scores": metrics.cloud_scores(other, one),
            "shape": metrics.shape_signature_distance(other, one, seed=SEED),
            "counts": metrics.point_counts(one),
        }

    return {"scores/images": images, "scores/clouds": clouds}


# ---- studies ---------------------------------------------------------------------------------------------------------


def _studies() -> dict[str, Case]:
    def answer(study: Study, effects: list[str]) -> Any:
        found = find_gap(study, effects=effects, seed=SEED).to_dict()
        return {key: value for key, value in found.items() if key != "seconds"}

    def lidar() -> Any:
        hidden = [EFFECTS["lidar.window_loss"](loss_db=1.0)]
        study = tiny_study.tiny_study(hidden, seed=2, rows=16, columns=32, clear=4, frames=4)
        return answer(study, ["lidar.window_loss", "lidar.threshold_shift"])

    def radar() -> Any:
        hidden = [EFFECTS["radar.wet_radome"](loss_db=2.0)]
        return answer(tiny_radar_study.tiny_radar_study(hidden, seed=2), ["radar.wet_radome", "radar.noise_floor"])

    def camera() -> Any:
        hidden = [EFFECTS["camera.exposure_gain"](factor=1.03)]
        study = Study.from_arrays(**tiny_camera_study.values_of(hidden, seed=3))
        return answer(study, ["camera.exposure_gain", "camera.stray_light"])

    def link() -> Any:
        found = find_gap(tiny_link_study.tiny_link_study(constant_db=1.0), seed=SEED).to_dict()
        return {key: value for key, value in found.items() if key != "seconds"}

    return {"studies/lidar": lidar, "studies/radar": radar, "studies/camera": camera, "studies/link": link}
