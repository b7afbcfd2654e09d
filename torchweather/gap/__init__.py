"""Gap between simulation and measurement: the study, the search for the missing effect, and the repaired model."""

from torchweather.core.moved import moved
from torchweather.gap.diagnosis import Finding, diagnose
from torchweather.gap.find import find_gap
from torchweather.gap.gap_report import GapReport
from torchweather.gap.study.folders import study_from_folders, study_from_kitti
from torchweather.gap.study.simulation import simulate
from torchweather.gap.study.study import Condition, Frame, Frames, Study, StudyScene

__all__ = [
    "Condition",
    "Finding",
    "Frame",
    "Frames",
    "GapReport",
    "Study",
    "StudyScene",
    "diagnose",
    "find_gap",
    "simulate",
    "study_from_folders",
    "study_from_kitti",
]

__getattr__ = moved(__name__, {"torchweather.evaluation.validation": ("Validation", "validate")})
