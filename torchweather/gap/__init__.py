"""Simulation against measurement: the study of clear and measured frames, what it lacks, how far the two are apart."""

from torchweather.gap.adapters import study_from_folders, study_from_kitti
from torchweather.gap.diagnosis import Finding, diagnose
from torchweather.gap.find import find_gap
from torchweather.gap.gap_report import GapReport
from torchweather.gap.simulation import simulate
from torchweather.gap.study import Condition, Frame, Frames, Study, StudyScene
from torchweather.gap.validation import Validation, validate

__all__ = [
    "Condition",
    "Finding",
    "Frame",
    "Frames",
    "GapReport",
    "Study",
    "StudyScene",
    "Validation",
    "diagnose",
    "find_gap",
    "simulate",
    "study_from_folders",
    "study_from_kitti",
    "validate",
]
