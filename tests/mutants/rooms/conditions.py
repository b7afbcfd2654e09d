"""Breaks of water and snow on things."""

from __future__ import annotations

from tests.mutants.mutant import Mutant

CONDITIONS = "tests/atmosphere/test_conditions.py"
WINDOW_FILM = "torchweather.physics.window_film"

MUTANTS = (
    Mutant(
        "more_flakes_as_fast_as_before",
        "snow of less visibility at one rate falls as much slower as it is denser",
        "torchweather.atmosphere.weather",
        "speed if self.visibility_spread == 1.0 else speed / self.visibility_spread",
        "speed",
        ("tests/atmosphere/test_visibility_spread.py::test_as_much_water_reaches_the_ground",),
    ),
    Mutant(
        "road_slope_as_a_ratio",
        "the factor of the depth on the road goes with the slope in per cent",
        "torchweather.physics.road_water",
        "flow / slope**of_slope",
        "flow / (slope / 100.0) ** of_slope",
        ("tests/physics/test_road_water.py::test_depth_is_that_of_the_law_in_inches",),
    ),
    Mutant(
        "rain_on_a_driven_window_without_its_speed",
        "an upright window is hit by the rain that it drives into",
        WINDOW_FILM,
        "rain * level + MM_PER_H * water * speed * torch.sin(tilt)",
        "rain * level + MM_PER_H * water * speed * torch.cos(tilt)",
        ("tests/physics/test_window_film.py::test_rain_on_a_driven_plane_is_that_of_drops",),
    ),
    Mutant(
        "layers_in_the_wrong_order",
        "the matrix of a layer multiplies those in front of it from the right",
        WINDOW_FILM,
        "a * cosine + b * sine * m,\n            a * sine / m + b * cosine,",
        "a * cosine + c * sine / m,\n            a * sine / m + b * cosine,",
        ("tests/physics/test_window_film.py::test_layers_are_waves_that_go_to_and_fro",),
    ),
    Mutant(
        "water_on_roofs",
        "the road lies near the ground: a roof is none",
        "torchweather.camera.surfaces",
        "torch.where(state.scene.depth_m < FARTHEST_M, near * level, 0.0)",
        "torch.where(state.scene.depth_m < FARTHEST_M, level, 0.0)",
        (f"{CONDITIONS}::test_only_level_ground_is_road",),
    ),
    Mutant(
        "puddles_of_each_sensor_alone",
        "puddles belong to the road: all sensors of a sample see the same",
        "torchweather.pipeline.road_water",
        "of_the_air: ClassVar[bool] = True",
        "of_the_air: ClassVar[bool] = False",
        (f"{CONDITIONS}::test_one_condition_for_all_sensors_of_a_sample",),
    ),
    Mutant(
        "an_effect_twice_in_silence",
        "an effect that is given and follows from a condition is refused",
        "torchweather.pipeline.conditions",
        "if effect.id in ids:",
        "if effect.id in ():",
        (f"{CONDITIONS}::test_an_effect_given_twice_names_both",),
    ),
    Mutant(
        "snow_on_walls",
        "snow slides off what is steep",
        "torchweather.physics.snow_pack",
        "-torch.expm1(-depth_mm / ROUGHNESS_MM) * held",
        "-torch.expm1(-depth_mm / ROUGHNESS_MM) + 0.0 * held",
        ("tests/physics/test_snow_pack.py::test_snow_lies_on_what_is_level",),
    ),
    Mutant(
        "grains_of_snow_by_their_radius",
        "the law of the albedo takes the diameter of the grains",
        "torchweather.physics.snow_pack",
        "absorbed_per_m * 2e-6 * radius",
        "absorbed_per_m * 1e-6 * radius",
        ("tests/physics/test_snow_pack.py::test_albedo_is_that_of_photons",),
    ),
    Mutant(
        "snow_seen_face_on",
        "snow returns by the cosine of the incidence, as the reported intensities do",
        "torchweather.lidar.effects.surfaces",
        "white = white * state.scene.cos_incidence.abs().to(field)",
        "white = white * torch.ones_like(field)",
        (f"{CONDITIONS}::test_snow_on_the_road_returns_by_its_own_reflectivity",),
    ),
    Mutant(
        "spray_of_one_row_of_tyres",
        "a vehicle has tyres on both sides",
        "torchweather.physics.road_spray",
        "shape = sum(self._across(y_m, side) for side in (-0.5, 0.5))",
        "shape = sum(self._across(y_m, side) for side in (-0.5,))",
        ("tests/physics/test_road_spray.py::test_the_cloud_holds_the_water_that_the_tyres_lift",),
    ),
    Mutant(
        "spray_gates_of_a_whole_pulse",
        "the pulse covers half of its length in range",
        "torchweather.lidar.effects.road_spray",
        "gate_m = sensor.pulse_length_m",
        "gate_m = 2.0 * sensor.pulse_length_m",
        (f"{CONDITIONS}::test_a_lidar_loses_what_the_spray_hides_and_lists_its_gates",),
    ),
    Mutant(
        "billows_of_each_sensor_alone",
        "one cloud of spray stands before all sensors",
        "torchweather.lidar.effects.road_spray",
        "return (BILLOWS,)",
        "return ()",
        (f"{CONDITIONS}::test_billows_are_the_same_for_camera_and_lidar",),
    ),
    Mutant(
        "drops_that_turn_the_wrong_way",
        "a convex drop bends rays towards its axis: the scene stands upside down",
        "torchweather.camera.effects.refraction",
        "outward = [steep * u, steep * v]",
        "outward = [-steep * u, -steep * v]",
        ("tests/camera/effects/test_refracting_drops.py::test_the_scene_stands_upside_down_in_a_drop",),
    ),
    Mutant(
        "drops_of_another_colour",
        "each pixel of a mosaic shows the light of its own phase",
        "torchweather.camera.effects.refraction",
        "aside, down = columns.long() % 2, rows.long() % 2",
        "aside, down = 0 * columns.long(), 0 * rows.long()",
        ("tests/camera/effects/test_refracting_drops.py::test_a_mosaic_shows_the_light_of_its_own_colour",),
    ),
)
