"""Weather in the samples of OpenPCDet, mmdetection3d and Hugging Face datasets, in the shapes that they document."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from torchweather.atmosphere.weather import Fog
from torchweather.compose import Compose
from torchweather.datasets.adapters import HuggingFaceAdapter, Mmdet3dAdapter, OpenPcdetAdapter
from torchweather.sensors import Camera, Lidar
from torchweather.transforms import AsBayer, BayerFog, LidarFog

HEIGHT, WIDTH = 6, 8
CAMERA = Camera.from_intrinsics(fx=8.0, fy=8.0, cx=3.5, cy=2.5, width=WIDTH, height=HEIGHT)


class Weather:
    """A transform of samples by named keys, as Compose is one; every call with the same seed."""

    def __init__(self, mor_m: float = 40.0) -> None:
        self.lidar = LidarFog(Fog(mor_m=mor_m), Lidar.preset("velodyne-hdl-64e", intensity_unit="reflectivity"))
        self.camera = AsBayer(BayerFog(Fog(mor_m=mor_m), CAMERA, airlight=(0.9, 0.5, 0.1)))

    def __call__(self, sample: dict[str, Any]) -> dict[str, Any]:
        found = dict(sample)
        if "points" in sample:
            found["points"] = self.lidar(sample["points"], self.lidar.draw(sample["points"], seed=3))
        for key in ("img", "image"):
            if key in sample:
                found[key] = self.camera(sample[key], sample["depth"])
        return {**found, "weather": "fog"}


class Points:
    """What mmdetection3d's BasePoints is to us."""

    def __init__(self, tensor: torch.Tensor, points_dim: int, attribute_dims: dict[str, int] | None = None) -> None:
        self.tensor, self.points_dim, self.attribute_dims = tensor, points_dim, attribute_dims


def cloud(columns: int = 4) -> np.ndarray:
    generator = np.random.default_rng(0)
    points = generator.uniform(5.0, 60.0, (50, columns)).astype(np.float32)
    points[:, 3] = generator.uniform(0.05, 0.6, 50)
    points[7, :3] = 0.0  # no return
    return points


def in_weather(points: np.ndarray) -> np.ndarray:
    found = Weather()({"points": torch.from_numpy(points.copy())})["points"].numpy()
    return found[(found[:, :3] != 0).any(1)]


def picture() -> np.ndarray:
    return np.random.default_rng(1).integers(0, 256, (HEIGHT, WIDTH, 3)).astype(np.uint8)  # red, green, blue


def foggy(rgb: np.ndarray, depth_m: float = 30.0) -> np.ndarray:
    sample = {
        "image": torch.from_numpy(rgb.transpose(2, 0, 1).copy()),
        "depth": torch.full((1, HEIGHT, WIDTH), depth_m),
    }
    return Weather()(sample)["image"].numpy().transpose(1, 2, 0)


def test_openpcdet_keeps_its_keys_dtypes_and_columns() -> None:
    before = cloud(5)
    data = {
        "frame_id": "000007",
        "points": before.copy(),
        "gt_boxes": np.ones((2, 8), np.float32),
        "gt_names": np.array(["Car", "Van"]),
        "use_lead_xyz": True,
    }
    found = OpenPcdetAdapter(Weather())(data)
    assert list(found) == [*data, "weather"]
    assert type(found["points"]) is np.ndarray
    assert found["points"].dtype == np.float32
    np.testing.assert_array_equal(found["points"], in_weather(before))
    assert 0 < len(found["points"]) < 50  # fog of 40 m takes some, and none stands at the sensor
    np.testing.assert_array_equal(data["points"], before)
    for key in ("gt_boxes", "gt_names", "use_lead_xyz"):
        assert found[key] is data[key]
    assert len(OpenPcdetAdapter(Weather(), drop_lost=False)(data)["points"]) == 50


def test_points_lost_as_nan_are_left_out_and_the_array_is_not_the_transforms_to_change() -> None:
    def in_place(sample: dict[str, Any]) -> dict[str, Any]:
        sample["points"][:10, :3] = torch.nan
        return sample

    data = {"points": cloud()}
    np.testing.assert_array_equal(OpenPcdetAdapter(in_place)(data)["points"], cloud()[10:])
    np.testing.assert_array_equal(data["points"], cloud())


def test_openpcdet_with_images_and_depth_maps() -> None:
    rgb = picture()
    depth = np.full((HEIGHT, WIDTH), 30.0, np.float32)
    data = {"image": rgb.astype(np.float32) / 255, "depth": depth}
    found = OpenPcdetAdapter(Weather(), clouds=(), images=["image"], depths=["depth"])(data)
    assert found["image"].shape == (HEIGHT, WIDTH, 3)
    # 8 bits against floats: half a step.
    np.testing.assert_allclose(found["image"], foggy(rgb) / 255, atol=0.501 / 255)
    assert found["depth"] is depth


def test_mmdet3d_points_stay_of_their_class_with_their_attributes() -> None:
    before = cloud(5)
    points = Points(torch.from_numpy(before.copy()), 5, {"time": 4})
    boxes = object()
    found = Mmdet3dAdapter(Weather())({"points": points, "gt_bboxes_3d": boxes, "box_type_3d": "LiDAR"})
    assert type(found["points"]) is Points
    assert (found["points"].points_dim, found["points"].attribute_dims) == (5, {"time": 4})
    np.testing.assert_array_equal(found["points"].tensor.numpy(), in_weather(before))
    assert found["gt_bboxes_3d"] is boxes
    assert torch.equal(points.tensor, torch.from_numpy(before))


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_mmdet3d_images_are_blue_green_red_up_to_255(dtype: type) -> None:
    rgb = picture()
    results = {"img": rgb[..., ::-1].astype(dtype), "depth": np.full((HEIGHT, WIDTH), 30.0, np.float32)}
    found = Mmdet3dAdapter(Weather(), clouds=(), images=("img",), depths=("depth",))(results)
    assert found["img"].dtype == dtype
    # The airlight is red: read as blue, green, red the image would turn blue.
    np.testing.assert_allclose(found["img"][..., ::-1], foggy(rgb), atol=0.501 if dtype is np.float32 else 0)


def test_an_image_of_floats_that_nothing_changes_comes_back_bit_for_bit() -> None:
    results = {"img": np.arange(256, dtype=np.float32).reshape(16, 16, 1).repeat(3, 2)}
    found = Mmdet3dAdapter(dict, clouds=(), images=("img",))(results)
    np.testing.assert_array_equal(found["img"], results["img"])


def test_mmdet3d_refuses_labels_of_points_and_lists_of_views() -> None:
    points = Points(torch.from_numpy(cloud()), 4)
    with pytest.raises(ValueError, match=r"pts_semantic_mask labels every point.*merge_kind"):
        Mmdet3dAdapter(Weather())({"points": points, "pts_semantic_mask": np.zeros(50)})
    with pytest.raises(TypeError, match="Views of several cameras"):
        Mmdet3dAdapter(Weather(), clouds=(), images=("img",))({"img": [picture(), picture()]})


@pytest.mark.parametrize("drop_lost", [True, False])
@pytest.mark.parametrize("as_array", [True, False])
def test_mmdet3d_labels_follow_the_points(drop_lost: bool, as_array: bool) -> None:
    points = torch.from_numpy(cloud())
    semantic, instance = np.arange(50) % 16, np.arange(50) + 1000
    if not as_array:
        semantic, instance = torch.from_numpy(semantic), torch.from_numpy(instance)
    lidar = LidarFog(Fog(mor_m=300.0), Lidar.preset("velodyne-hdl-64e", intensity_unit="reflectivity"))
    compose = Compose({"points": lidar}, seed=3, sample_key="sample_idx")
    results = {
        "points": Points(points, 4),
        "sample_idx": 5,
        "pts_semantic_mask": semantic,
        "pts_instance_mask": instance,
    }
    results["eval_ann_info"] = {"pts_semantic_mask": semantic, "other": 1}
    adapter = Mmdet3dAdapter(compose, drop_lost=drop_lost, particle_class=30, lost_class=31)
    found = adapter(results)
    _, what = compose.run({**results, "points": points})
    kind, source = what["points"].kind, what["points"].source
    assert set(kind.tolist()) == {0, 1, 2}, kind.bincount()
    kept = torch.ones(50, dtype=torch.bool) if not drop_lost else kind != 2
    wanted = torch.where(kind == 1, 30, torch.where(kind == 2, 31, source % 16))[kept].tolist()
    assert found["pts_semantic_mask"].tolist() == wanted
    assert found["pts_instance_mask"].tolist() == torch.where(kind == 0, source + 1000, 0)[kept].tolist()
    assert len(found["points"].tensor) == len(wanted)
    assert found["eval_ann_info"]["pts_semantic_mask"].tolist() == wanted
    assert found["eval_ann_info"]["other"] == 1
    assert type(found["pts_semantic_mask"]) is type(semantic)
    assert semantic.tolist() == results["eval_ann_info"]["pts_semantic_mask"].tolist() == (np.arange(50) % 16).tolist()
    clear = Mmdet3dAdapter(Compose({"points": lidar}, p=0.0), drop_lost=drop_lost, particle_class=30)(results)
    assert clear["pts_semantic_mask"].tolist() == [k % 16 for k in range(50) if not drop_lost or k != 7]
    with pytest.raises(ValueError, match="must label 50 points; got 49"):
        adapter({**results, "pts_semantic_mask": semantic[:49]})


def test_hugging_face_rows_are_pictures_arrays_and_nested_lists() -> None:
    rgb, grey = picture(), np.full((HEIGHT, WIDTH), 9, np.uint16)
    points = [cloud().tolist(), cloud()[:20].tolist()]
    depth = np.full((HEIGHT, WIDTH), 30.0).tolist()
    batch = {"image": [Image.fromarray(rgb)] * 2, "points": points, "depth": [depth] * 2, "label": [3, 4]}
    adapter = HuggingFaceAdapter(Weather(), images=("image",), depths=("depth",))
    found = adapter(batch)
    assert list(found) == [*batch, "weather"]
    assert found["label"] == [3, 4]
    for row in range(2):
        np.testing.assert_array_equal(found["image"][row].numpy().transpose(1, 2, 0), foggy(rgb))
        np.testing.assert_array_equal(found["points"][row].numpy(), in_weather(np.array(points[row], np.float32)))
    # A raw frame stays one channel of 16 bits, any other picture becomes red, green, blue.
    for raw, shape, kept in (
        (Image.fromarray(grey), (1, HEIGHT, WIDTH), torch.uint16),
        (Image.fromarray(rgb).convert("P"), (3, HEIGHT, WIDTH), torch.uint8),
    ):
        (one,) = HuggingFaceAdapter(dict, clouds=(), images=("raw",))({"raw": [raw]})["raw"]
        assert (tuple(one.shape), one.dtype) == (shape, kept)
    assert adapter({key: [] for key in batch}) == {key: [] for key in batch}


def test_adapters_pickle_for_workers_and_name_what_is_missing() -> None:
    for kind in (OpenPcdetAdapter, Mmdet3dAdapter, HuggingFaceAdapter):
        again = pickle.loads(pickle.dumps(kind(Weather(), images=("img",))))
        assert again.images == ("img",)
        with pytest.raises(ValueError, match=r"expected the key 'points'; the sample has point.*Did you mean 'point'"):
            again({"point": 1})
        with pytest.raises(TypeError, match="clouds must be a sequence of keys"):
            kind(Weather(), clouds="points")
