"""Simulation against measurement: the study of clear and measured frames, what it lacks, how far the two are apart."""

from torchweather.gap.adapters import study_from_folders, study_from_kitti
from torchweather.gap.diagnosis import Finding, diagnose
from torchweather.gap.simulation import simulate
from torchweather.gap.study import Condition, Frame, Frames, Study, StudyScene
from torchweather.gap.validation import Validation, validate

__all__ = [
    "Condition",
    "Finding",
    "Frame",
    "Frames",
    "Study",
    "StudyScene",
    "Validation",
    "diagnose",
    "simulate",
    "study_from_folders",
    "study_from_kitti",
    "validate",
]
