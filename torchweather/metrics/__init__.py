"""Scores of images and point clouds against a reference, and their trends in weather."""

from torchweather.metrics.bayer import BayerScore, bayer_scores
from torchweather.metrics.box_overlap import bev_iou, box_iou
from torchweather.metrics.cloud_scores import CLOUD_SCORES, chamfer_distance, cloud_scores
from torchweather.metrics.clouds import Region
from torchweather.metrics.correlation import Correlation, MetricCorrelation, correlate
from torchweather.metrics.d34_claim import D34_CLAIM
from torchweather.metrics.detection import AveragePrecision, average_precision
from torchweather.metrics.double_validation import double_validation
from torchweather.metrics.image_scores import IMAGE_SCORES, image_scores
from torchweather.metrics.point_counts import point_counts
from torchweather.metrics.score import CloudScore, ImageScore, ScoreFacts
from torchweather.metrics.shape_signature import sdm, shape_signature_distance
from torchweather.metrics.trends import expected_trends

__all__ = [
    "CLOUD_SCORES",
    "D34_CLAIM",
    "IMAGE_SCORES",
    "AveragePrecision",
    "BayerScore",
    "CloudScore",
    "Correlation",
    "ImageScore",
    "MetricCorrelation",
    "Region",
    "ScoreFacts",
    "average_precision",
    "bayer_scores",
    "bev_iou",
    "box_iou",
    "chamfer_distance",
    "cloud_scores",
    "correlate",
    "double_validation",
    "expected_trends",
    "image_scores",
    "point_counts",
    "sdm",
    "shape_signature_distance",
]
