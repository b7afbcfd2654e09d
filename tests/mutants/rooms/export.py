"""Breaks of the ONNX export."""

from __future__ import annotations

from tests.mutants.mutant import Mutant

PICTURE = "torchweather.export.picture"
FEED = "torchweather.export.feed"
LIDAR_GRAPH = "torchweather.export.lidar_graph"

MUTANTS = (
    Mutant(
        "a_choice_takes_the_other_side",
        "a choice by a constant gives what the constant chooses",
        "torchweather.export.tidying",
        "taken = node.inputs[1 if bool(choice.reshape(-1)[0]) else 2]",
        "taken = node.inputs[2 if bool(choice.reshape(-1)[0]) else 1]",
        ("tests/export/test_tidying.py::test_a_simpler_graph_gives_the_same_numbers[a choice that is made]",),
    ),
    Mutant(
        "any_number_leaves_an_operand",
        "an operand is left as it is by 1 where it is multiplied, by 0 where it is added",
        "torchweather.export.tidying",
        "bool((constant == number).all())",
        "bool((constant >= number).all())",
        ("tests/export/test_tidying.py::test_a_simpler_graph_gives_the_same_numbers[another number beside it]",),
    ),
    Mutant(
        "changed_in_place_while_read",
        "an operation in place is replaced only where nothing else reads its input",
        "torchweather.export.decomposing",
        "or len(changed.users) != 1",
        "or len(changed.users) < 1",
        ("tests/export/test_decomposing.py::test_what_is_changed_in_place_and_read_is_left_to_torch[shared]",),
    ),
    Mutant(
        "picture_in_bgr_to_rgb_detector",
        "a detector gets the colour order that it declares",
        PICTURE,
        'ordered = rgb if self.colour == "RGB" else rgb.flip(-3)',
        "ordered = rgb",
        ("tests/export/test_export_fuse.py::test_a_picture_is_normalised_as_the_detector_wants_it",),
    ),
    Mutant(
        "picture_mean_added",
        "a detector's picture is normalised by mean and deviation",
        PICTURE,
        "scaled = (ordered * self.scale - self.mean) / self.std",
        "scaled = (ordered * self.scale - self.mean) * self.std",
        ("tests/export/test_export_fuse.py::test_a_picture_is_normalised_as_the_detector_wants_it",),
    ),
    Mutant(
        "feed_ignores_the_seed",
        "the noise of a graph follows its seed",
        FEED,
        "feed.update(draw_variates(seeds, stage, own, sizes))",
        "feed.update(draw_variates([0] * len(seeds), stage, own, sizes))",
        ("tests/export/test_export_radar.py::test_draw_feed_gives_the_numbers_of_draw_bit_for_bit[fog]",),
    ),
    Mutant(
        "feed_at_half_the_rate",
        "a feed at the rate holds every point that the rate shows",
        FEED,
        "place = (math.log(rate)",
        "place = (math.log(rate / 2)",
        (
            (
                "tests/export/test_export.py::"
                "test_a_feed_at_the_rate_is_the_first_part_of_the_whole_feed_and_gives_the_same"
            ),
        ),
    ),
    Mutant(
        "odd_mosaic_fed",
        "a mosaic has whole cells",
        FEED,
        "if height < 2 or width < 2 or height % 2 or width % 2:",
        "if height < 2 or width < 2:",
        ("tests/export/test_export.py::test_a_feed_for_a_size_that_is_no_mosaic_is_refused",),
    ),
    Mutant(
        "dropping_points_exported",
        "lost points cannot be dropped in a graph",
        LIDAR_GRAPH,
        'if transform.lost == "drop":',
        "if False:",
        ("tests/export/test_export_lidar.py::test_what_changes_the_number_of_points_is_refused",),
    ),
    Mutant(
        "beams_appended_in_a_graph",
        "a graph appends no beams",
        LIDAR_GRAPH,
        "if transform.complete_scan:",
        "if False:",
        ("tests/export/test_export_lidar.py::test_what_changes_the_number_of_points_is_refused",),
    ),
    Mutant(
        "radar_intensities_of_the_graph_fixed",
        "a rate is an input of the graph",
        "torchweather.export.radar_graph",
        'found[inputs[part.kind]].append(f"_stages.{name}.parts.{part.kind}.{part.intensity_name}")',
        "pass",
        (
            (
                "tests/export/test_export_radar.py::"
                "test_onnxruntime_gives_what_torch_gives_for_other_lists_and_intensities[3x301-fog]"
            ),
        ),
    ),
    Mutant(
        "weather_units_not_in_the_graph",
        "a graph states the units of its inputs",
        "torchweather.export.metadata",
        "UNITS_KEY: json.dumps({name: units[name] for name in traceable.inputs}),",
        "UNITS_KEY: json.dumps({}),",
        ("tests/export/test_export_fuse.py::test_the_properties_say_version_equations_and_units",),
    ),
    Mutant(
        "near_mask_not_in_the_graph",
        "the own vehicle's mask is an input of the graph",
        "torchweather.export.camera_graph",
        'near_mask=named_shares.get("near_mask"),',
        "near_mask=None,",
        (
            (
                "tests/export/test_export_rgb.py::test_onnxruntime_gives_what_torch_gives_at_other_sizes_and_"
                "intensities[1-fog of a mosaic]"
            ),
        ),
    ),
)
