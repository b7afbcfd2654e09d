"""Readers and writers of files: images, depth, points, radar detections and ADC cubes, labels, drops, tables."""

from __future__ import annotations

from torchweather.core.atomic import atomic_folder, atomic_write
from torchweather.core.moved import moved
from torchweather.io.adc import ADC_AXES, ADC_QUADRATURES, AdcCube, read_adc, write_adc
from torchweather.io.depth import DEPTH_ENCODINGS, read_depth
from torchweather.io.disdrometer import read_disdrometer
from torchweather.io.drop_spectrum import DropSpectrum, spectrum_from_counts, spectrum_from_drops
from torchweather.io.exif import ExifFocal, read_exif_focal
from torchweather.io.images import IMAGE_SUFFIXES, ImageInfo, read_image, write_image
from torchweather.io.label_columns import label_columns, with_labels_of
from torchweather.io.labels import (
    FALLING_SNOW,
    LABEL_FORMATS,
    LYING_SNOW,
    UNLABELLED,
    LabelFormat,
    PointLabels,
    label_format,
    merge_kind,
    read_labels,
    write_labels,
)
from torchweather.io.map_layout import MAP_LAYOUTS, MapLayout, map_layout
from torchweather.io.npz_points import NPZ_ENCODINGS
from torchweather.io.nuscenes_radar import NUSCENES_RADAR_STATES
from torchweather.io.ouster import OUSTER_INTENSITIES, OusterFrame, read_ouster
from torchweather.io.parsivel import parsivel_area_mm2, parsivel_edges_mm, parsivel_speeds_m_per_s
from torchweather.io.pcd import PCD_ENCODINGS
from torchweather.io.ply import PLY_ENCODINGS
from torchweather.io.point_cloud import INTENSITY_NAMES, PointCloud
from torchweather.io.points import POINT_FORMATS, POINT_SUFFIXES, read_points, write_points
from torchweather.io.power_maps import MAP_SUFFIXES, MapRecord, read_power_map, write_power_map
from torchweather.io.radar_points import RADAR_COLUMNS, RADAR_FORMATS, RadarPoints, read_radar, write_radar
from torchweather.io.ros_bags import RosBag, RosFrame, RosTopic
from torchweather.io.sensor_points import PointReading, read_sensor_points
from torchweather.io.sensor_pose import read_sensor_pose
from torchweather.io.tables import TABLE_SUFFIXES, read_table, write_table

__all__ = [
    "ADC_AXES",
    "ADC_QUADRATURES",
    "DEPTH_ENCODINGS",
    "FALLING_SNOW",
    "IMAGE_SUFFIXES",
    "INTENSITY_NAMES",
    "LABEL_FORMATS",
    "LYING_SNOW",
    "MAP_LAYOUTS",
    "MAP_SUFFIXES",
    "NPZ_ENCODINGS",
    "NUSCENES_RADAR_STATES",
    "OUSTER_INTENSITIES",
    "PCD_ENCODINGS",
    "PLY_ENCODINGS",
    "POINT_FORMATS",
    "POINT_SUFFIXES",
    "RADAR_COLUMNS",
    "RADAR_FORMATS",
    "TABLE_SUFFIXES",
    "UNLABELLED",
    "AdcCube",
    "DropSpectrum",
    "ExifFocal",
    "ImageInfo",
    "LabelFormat",
    "MapLayout",
    "MapRecord",
    "OusterFrame",
    "PointCloud",
    "PointLabels",
    "PointReading",
    "RadarPoints",
    "RosBag",
    "RosFrame",
    "RosTopic",
    "atomic_folder",
    "atomic_write",
    "label_columns",
    "label_format",
    "map_layout",
    "merge_kind",
    "parsivel_area_mm2",
    "parsivel_edges_mm",
    "parsivel_speeds_m_per_s",
    "read_adc",
    "read_depth",
    "read_disdrometer",
    "read_exif_focal",
    "read_image",
    "read_labels",
    "read_ouster",
    "read_points",
    "read_power_map",
    "read_radar",
    "read_sensor_points",
    "read_sensor_pose",
    "read_table",
    "spectrum_from_counts",
    "spectrum_from_drops",
    "with_labels_of",
    "write_adc",
    "write_image",
    "write_labels",
    "write_points",
    "write_power_map",
    "write_radar",
    "write_table",
]

__getattr__ = moved(__name__, ("torchweather.datasets", "torchweather.compose"))
