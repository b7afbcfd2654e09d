"""Breaks of the augmentation of data sets."""

from __future__ import annotations

from tests.mutants.mutant import Mutant

PATHS = "torchweather.datasets.augment.paths"
MANIFEST = "torchweather.datasets.augment.manifest"

MUTANTS = (
    Mutant(
        "path_outside_the_folder_read",
        "a manifest leads to no file outside its folder",
        PATHS,
        'if not relative or pure.is_absolute() or ".." in pure.parts or "\\\\" in relative:',
        "if not relative:",
        ("tests/datasets/augment/test_augment.py::test_a_path_outside_the_root_is_refused",),
    ),
    Mutant(
        "links_out_of_the_folder_followed",
        "a link out of the data set is refused",
        PATHS,
        'inside(root, relative, f"{path}: a link")',
        "pass",
        ("tests/datasets/augment/test_augment.py::test_a_path_outside_the_root_is_refused",),
    ),
    Mutant(
        "truncated_output_counts_as_done",
        "a run resumes only over outputs of the recorded size",
        MANIFEST,
        "if not path.is_file() or path.stat().st_size != size:",
        "if not path.is_file():",
        ("tests/datasets/augment/test_augment.py::test_what_is_done_is_not_done_again",),
    ),
    Mutant(
        "two_runs_in_one_folder",
        "a folder is locked by its run",
        MANIFEST,
        "fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)",
        "fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)",
        ("tests/datasets/augment/test_augment.py::test_a_manifest_that_is_none_and_a_folder_in_use_are_refused",),
    ),
    Mutant(
        "two_outputs_of_one_name",
        "two files of a data set are never written to one",
        "torchweather.datasets.augment.layouts",
        "if twice:",
        "if False:",
        ("tests/datasets/augment/test_layouts.py::test_two_files_are_never_written_to_one",),
    ),
    Mutant(
        "nuscenes_labels_carried_along",
        "nuScenes' labels of points follow the points",
        "torchweather.datasets.augment.nuscenes",
        "            if path in there:\n                found.append(path)",
        "            pass",
        ("tests/datasets/augment/test_point_labels.py::test_nuscenes_labels_are_written_anew",),
    ),
    Mutant(
        "tracking_boxes_of_the_first_frame",
        "boxes of the tracking kit are those of the frame",
        "torchweather.datasets.augment.kitti",
        "box_frame=int(number) if",
        "box_frame=0 if",
        ("tests/datasets/augment/test_kitti_layouts.py::test_boxes_of_a_tracking_sequence_are_counted_frame_by_frame",),
    ),
    Mutant(
        "calibration_of_the_first_sequence",
        "each sequence of the tracking kit has a calibration of its own",
        "torchweather.datasets.augment.kitti",
        'found = [f"{self.split}{CALIBRATION}/{self.sequence}.txt"]',
        'found = [f"{self.split}{CALIBRATION}/0001.txt"]',
        ("tests/datasets/augment/test_kitti_layouts.py::test_a_kit_is_done_with_its_own_calibration",),
    ),
)
