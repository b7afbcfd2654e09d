"""Breaks of the camera's depth: projection, holes, sky, the own bonnet."""

from __future__ import annotations

from tests.mutants.mutant import Mutant

FILL = "torchweather.camera.depth.fill"

MUTANTS = (
    Mutant(
        "flat_ground_forgets_the_height",
        "ground depth grows with the camera's height",
        "torchweather.camera.depth.ground",
        "metres / torch.where(fall > 0, fall, 1.0)",
        "1.0 / torch.where(fall > 0, fall, 1.0)",
        (
            (
                "tests/camera/depth/test_sources.py::test_ground_is_flat_in_the_world_under_pitch_roll_and_"
                "lens_distortion"
            ),
        ),
    ),
    Mutant(
        "guessed_ground_ends_where_the_guess_ends_it",
        "ground of a guess ends as softly as its walls are known",
        "torchweather.camera.depth.street_walls",
        "torch.special.ndtr(step / _DEPTH_LOG_STD)",
        "(step > 0).to(step)",
        (
            (
                "tests/camera/depth/test_scene_prior.py::test_the_ground_of_a_guess_is_as_probable_as_walls_drawn_at_"
                "other_distances_leave_it"
            ),
        ),
    ),
    Mutant(
        "guessed_ground_runs_through_boxes",
        "objects of a guess hide the ground",
        "torchweather.camera.depth.scene_prior",
        "ground = ground * (depth >= _OF_OBJECT * plain)",
        "ground = ground * 1.0",
        (
            (
                "tests/camera/depth/test_scene_prior.py::test_the_ground_of_a_guess_ends_along_the_edges_of_the_picture_"
                "and_at_boxes"
            ),
        ),
    ),
    Mutant(
        "points_projected_from_behind",
        "points behind the camera do not appear in the picture",
        "torchweather.camera.depth.projection",
        "in_front = depth > _NEAREST_POINT_M",
        "in_front = depth > -1e9",
        ("tests/camera/depth/test_sources.py::test_points_behind_beside_and_without_return_are_not_seen",),
    ),
    Mutant(
        "far_point_hides_the_near_one",
        "of two points in one pixel the nearer one is seen",
        "torchweather.camera.depth.points",
        '"amin")',
        '"amax")',
        ("tests/camera/depth/test_sources.py::test_hole_takes_the_depth_of_the_nearest_point",),
    ),
    Mutant(
        "depth_interpolated_in_depth",
        "a plane is linear in inverse depth, not in depth",
        FILL,
        "filled[hole_row, hole_column] = 1.0 / (share / points_xyz[corner[triangle], 2]).sum(-1)",
        "filled[hole_row, hole_column] = (share * points_xyz[corner[triangle], 2]).sum(-1)",
        ("tests/camera/depth/test_sources.py::test_road_between_the_rings_is_a_plane",),
    ),
    Mutant(
        "sky_painted_over_the_skyline",
        "sky lies above the topmost return of a column",
        FILL,
        "sky = (np.arange(height)[:, None] < top) & ~goes_on",
        "sky = (np.arange(height)[:, None] < top + 20) & ~goes_on",
        ("tests/camera/depth/test_sources.py::test_scan_of_a_wall_fills_the_picture_up_to_the_top_beam",),
    ),
    Mutant(
        "bonnet_mask_upside_down",
        "the near mask covers what lies below the bonnet's edge",
        "torchweather.camera.depth.near_mask",
        "mask[0] = (0.5 * (row - edge_row) + 0.5)",
        "mask[0] = (0.5 * (edge_row - row) + 0.5)",
        ("tests/camera/depth/test_near_mask.py::test_a_bonnet_is_found_within_two_rows",),
    ),
    Mutant(
        "sparse_map_stays_clear",
        "0 m is no depth",
        "torchweather.camera.depth.source",
        "not least_of(depth_m) > 0",
        "not least_of(depth_m) >= 0",
        ("tests/camera/depth/test_sparse_depth.py::test_zeros_are_counted_and_sky_on_the_road_is_warned_of",),
    ),
)
