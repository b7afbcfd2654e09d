"""Breaks of the augmentation of data sets."""

from __future__ import annotations

from tests.mutants.mutant import Mutant

PATHS = "torchweather.datasets.augment.paths"
MANIFEST = "torchweather.datasets.augment.manifest"
WHAT_STANDS = "tests/datasets/augment/test_what_stands.py"

MUTANTS = (
    Mutant(
        "depth_of_every_frame",
        "depth is found only where a weather was drawn",
        "torchweather.datasets.augment.work",
        "if draw.weather is not None or any(map(compose.clear_through_mosaic, files)):",
        "if True:",
        ("tests/datasets/augment/test_content.py::test_depth_is_found_only_for_frames_with_a_weather",),
    ),
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
        "    if not path.resolve().is_relative_to(root.resolve()):\n        raise TorchweatherError(\n",
        "    if False:\n        raise TorchweatherError(\n",
        ("tests/datasets/augment/test_augment.py::test_a_path_outside_the_root_is_refused",),
    ),
    Mutant(
        "changed_output_counts_as_done",
        "a run resumes only over outputs of the recorded bytes",
        MANIFEST,
        "if (verify or [found.st_mtime_ns] != changed_ns) and file_sha256(path) != sha256:",
        "if verify and file_sha256(path) != sha256:",
        (WHAT_STANDS + "::test_an_output_of_other_bytes_is_done_again",),
    ),
    Mutant(
        "verify_looks_at_times_alone",
        "--verify compares hashes",
        MANIFEST,
        "if (verify or [found.st_mtime_ns] != changed_ns) and file_sha256(path) != sha256:",
        "if [found.st_mtime_ns] != changed_ns and file_sha256(path) != sha256:",
        (WHAT_STANDS + "::test_verify_finds_other_bytes_of_the_same_size_and_time",),
    ),
    Mutant(
        "rebuilt_without_a_look_at_the_files",
        "a rebuilt manifest holds rows whose outputs have their hashes",
        MANIFEST,
        "if row.status == DONE and self._confirmed(row)]",
        "if row.status == DONE]",
        (WHAT_STANDS + "::test_a_damaged_manifest_is_rebuilt_from_rows_whose_files_have_their_hashes",),
    ),
    Mutant(
        "prune_deletes_unasked",
        "results without a source are deleted on request alone",
        "torchweather.datasets.augment.run",
        "            if prune:\n",
        "            if True:\n",
        (WHAT_STANDS + "::test_results_without_a_source_are_reported_and_pruned",),
    ),
    Mutant(
        "name_before_the_bytes",
        "a file is on the disk before its name is",
        "torchweather.core.atomic",
        "        _to_disk(unfinished)  # before its name is: after a power cut the name would hold an empty file\n",
        "",
        ("tests/core/test_atomic.py::test_the_file_is_synced_under_its_temporary_name_and_the_folder_after",),
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
