"""Breaks of the files: axes, colours, units, labels, boxes, damage."""

from __future__ import annotations

from tests.mutants.mutant import Mutant

CARLA = "torchweather.datasets.carla"
LABELS = "torchweather.io.labels"
ARRAYS = "torchweather.io.arrays"

MUTANTS = (
    Mutant(
        "carla_picture_in_bgr",
        "CARLA's bytes are blue, green, red, alpha",
        CARLA,
        "[..., 2::-1].transpose(2, 0, 1)",
        "[..., :3].transpose(2, 0, 1)",
        ("tests/datasets/test_carla.py::test_the_buffer_may_be_taken_back_after_the_call",),
    ),
    Mutant(
        "carla_points_left_handed",
        "CARLA's y points to the right",
        CARLA,
        "points[:, 1] = 0.0 - points[:, 1]",
        "points[:, 1] = 0.0 + points[:, 1]",
        ("tests/datasets/test_carla.py::test_points_right_of_the_sensor_come_out_right_of_it",),
    ),
    Mutant(
        "carla_focal_of_the_whole_angle",
        "a focal length is half the width over the tangent of half the angle",
        CARLA,
        "math.tan(0.5 * math.radians(image.fov))",
        "math.tan(math.radians(image.fov))",
        ("tests/datasets/test_carla.py::test_the_camera_has_the_field_of_view_across",),
    ),
    Mutant(
        "carla_depth_bytes_reversed",
        "CARLA's depth has its lowest byte in red",
        CARLA,
        "for shift in (0, 8, 16)",
        "for shift in (16, 8, 0)",
        ("tests/datasets/test_carla.py::test_depth_goes_and_comes_back_to_the_step_of_the_code",),
    ),
    Mutant(
        "box_count_not_updated",
        "num_lidar_pts of a box counts the points that weather leaves",
        "torchweather.datasets.box_update",
        'new[count] = new[f"{sensor}_points_left"]',
        "new[count] = record[count]",
        ("tests/datasets/test_box_update.py::test_nuscenes_counts_are_replaced_and_the_rest_stays",),
    ),
    Mutant(
        "particles_counted_in_boxes",
        "a particle in a box is no point of the object",
        "torchweather.datasets.box_visibility",
        "left[begin : begin + step] = (seen & is_object[:, None]).sum(dim=0)",
        "left[begin : begin + step] = seen.sum(dim=0)",
        ("tests/datasets/test_boxes.py::test_nuscenes_annotations_in_the_global_frame",),
    ),
    Mutant(
        "falling_snow_label_not_written",
        "SemanticKITTI labels of new particles get the class of falling snow",
        LABELS,
        "new = torch.where(particle, torch.full_like(classes, particle_class), classes)",
        "new = classes",
        ("tests/io/test_labels.py::test_dropped_and_appended_rows_follow_their_source",),
    ),
    Mutant(
        "label_and_instance_swapped",
        "a label's low 16 bits are its class",
        LABELS,
        "return PointLabels(labels & _HIGHEST, labels >> 16)",
        "return PointLabels(labels >> 16, labels & _HIGHEST)",
        ("tests/io/test_labels.py::test_class_and_instance_share_32_bits",),
    ),
    Mutant(
        "pickles_of_an_archive_loaded",
        "an array file never runs code",
        ARRAYS,
        "read_array(file, allow_pickle=False)",
        "read_array(file, allow_pickle=True)",
        ("tests/io/test_npz_points.py::test_pickled_objects_are_never_loaded",),
    ),
    Mutant(
        "array_header_believed",
        "a header that promises more than the file holds is refused",
        ARRAYS,
        "if promised > available_bytes:",
        "if False:",
        ("tests/io/test_npz_points.py::test_an_array_that_promises_a_hundred_gigabytes_is_refused_at_once",),
    ),
    Mutant(
        "kitti_depth_in_255ths",
        "KITTI's depth is in 1/256 m",
        "torchweather.io.depth",
        '    "kitti": 1.0 / 256.0,',
        '    "kitti": 1.0 / 255.0,',
        ("tests/io/test_depth_files.py::test_sixteen_bit_png_needs_its_encoding",),
    ),
    Mutant(
        "nan_in_a_cloud_accepted",
        "a NaN beside finite coordinates is an error",
        "torchweather.io.point_cloud",
        "if bool(wrong.any()):",
        "if False:",
        ("tests/io/test_points.py::test_a_position_that_is_partly_no_number_is_refused",),
    ),
    Mutant(
        "lens_of_another_model_accepted",
        "a fisheye lens is refused",
        "torchweather.datasets.yaml_calibration",
        "if any(values) and (model",
        "if False and (model",
        ("tests/datasets/test_camera_files.py::test_other_files_are_refused_by_what_they_are",),
    ),
    Mutant(
        "exif_focal_of_film_width",
        "the 35 mm focal length is along the diagonal",
        "torchweather.io.exif",
        "focal = film_mm * math.hypot(width, height) / FILM_DIAGONAL_MM",
        "focal = film_mm * width / FILM_DIAGONAL_MM",
        ("tests/io/test_exif.py::test_phones_agree_by_their_diagonal",),
    ),
    Mutant(
        "write_is_not_atomic",
        "a file appears whole or not at all",
        "torchweather.core.atomic",
        "        yield unfinished\n        unfinished.replace(target)",
        "        yield target",
        ("tests/io/test_images.py::test_failed_write_of_a_new_file_leaves_none",),
    ),
)
