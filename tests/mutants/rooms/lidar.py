"""Breaks of the LiDAR: way out and back, echoes, labels, intensity, frames, fits."""

from __future__ import annotations

from tests.mutants.mutant import Mutant

LIDAR = "torchweather.lidar.stages"
BEAM = "torchweather.lidar.beam"
INTENSITY = "torchweather.lidar.intensity"
CLOUD_FRAME = "torchweather.lidar.cloud_frame"
DOPPLER = "torchweather.lidar.doppler"
BEAM_PARTICLES = "torchweather.lidar.returns.beam_particles"
SENSOR = "torchweather.lidar.sensor"
NEAR_RESPONSE = "torchweather.lidar.sweep.near_response"
SENSOR_ORIGIN = "torchweather.lidar.sweep.sensor_origin"

MUTANTS = (
    Mutant(
        "faint_echoes_left_out_for_every_chain",
        "an effect that lowers the threshold sees the echoes below it",
        "torchweather.lidar.transform",
        "if is_exporting() or not {type(stage) for stage in stages.values()} <= LOOK_AT_DETECTED:",
        "if is_exporting():",
        ("tests/lidar/test_detected_echoes.py::test_a_stage_that_looks_at_faint_echoes_gets_them",),
    ),
    Mutant(
        "rows_of_lambda_counted_from_one",
        "the last row above an arrival is their number less one",
        "torchweather.lidar.returns.strongest",
        "row = (larger - 1).clamp(0, signals - 2)",
        "row = larger.clamp(0, signals - 2)",
        ("tests/lidar/test_detected_echoes.py::test_signals_on_the_nodes_are_those_of_the_bisection",),
    ),
    Mutant(
        "beams_with_a_second_particle_keep_their_object",
        "a beam with a particle above threshold has a choice",
        "torchweather.lidar.stages",
        "particles = echoes[1].signal >= threshold",
        "particles = echoes[1].signal > torch.inf",
        ("tests/lidar/test_detected_echoes.py::test_what_comes_out_is_that_of_all_echoes",),
    ),
    Mutant(
        "pixel_cone_as_wide_as_the_pixel",
        "the cone of a flash's pixel has its solid angle, not its width",
        SENSOR,
        "math.sqrt(4.0 / math.pi * math.radians(steps[0])",
        "math.sqrt(math.radians(steps[0])",
        ("tests/lidar/test_flash.py::test_pixels_see_the_drops_of_their_own_field",),
    ),
    Mutant(
        "vehicle_speed_added_to_particles",
        "a vehicle that drives towards a particle makes its radial speed smaller",
        DOPPLER,
        "measured = speed[..., echo] - ego",
        "measured = speed[..., echo] + ego",
        ("tests/lidar/test_doppler.py::test_wind_fall_and_the_vehicle_along_the_beam",),
    ),
    Mutant(
        "size_of_a_particle_without_the_others_of_its_pulse",
        "the echo of a drop has the smaller drops of its pulse in it",
        BEAM_PARTICLES,
        "return share + others.gather(1, at)",
        "return share",
        (("tests/lidar/test_doppler.py::test_fall_speeds_of_reported_particles_are_those_of_the_listed_ones"),),
    ),
    Mutant(
        "two_way_attenuation_taken_one_way",
        "light passes the weather out and back",
        LIDAR,
        "clear = torch.exp(-2.0 * extinction[:, None] * state.uniform_m)",
        "clear = torch.exp(-1.0 * extinction[:, None] * state.uniform_m)",
        ("tests/lidar/test_lidar_stages.py::test_an_object_at_half_the_attenuation_length_keeps_one_e_th",),
    ),
    Mutant(
        "signal_falls_with_range_once",
        "the signal of a surface falls with the square of the range",
        LIDAR,
        "* self.beam.near_response(range_m) / (math.pi * range_m.square())",
        "* self.beam.near_response(range_m) / (math.pi * range_m)",
        (
            (
                "tests/lidar/test_lidar_stages.py::test_the_near_range_response_dims_a_reflectivity_and_is_"
                "in_a_photon_count_already"
            ),
        ),
    ),
    Mutant(
        "calibration_ignores_near_response",
        "a near return's margin is divided by the near-range ramp",
        LIDAR,
        "ramp = self.beam.near_ramp(range_m)\n",
        "ramp = torch.ones_like(range_m)\n",
        (
            (
                "tests/lidar/test_near_returns.py::test_the_margin_has_the_sensors_mean_in_full_response_"
                "and_ends_at_a_grey_target_near"
            ),
        ),
    ),
    Mutant(
        "divergence_in_radians_taken_as_milliradians",
        "beam divergence is given in mrad",
        BEAM,
        '("divergence_rad", sensor.divergence_mrad * 1e-3)',
        '("divergence_rad", sensor.divergence_mrad)',
        ("tests/lidar/test_lidar_oracles.py::test_cone_has_the_oracle_s_volume",),
    ),
    Mutant(
        "near_ramp_not_clipped",
        "the near-range response is 1 beyond its ramp",
        BEAM,
        "return self._ramp(range_m).clamp(0.0, 1.0)",
        "return self._ramp(range_m).clamp_min(0.0)",
        ("tests/lidar/test_lidar_stages.py::test_what_was_detected_stands_on_the_threshold_times_its_margin",),
    ),
    Mutant(
        "dual_return_repeats_the_strongest",
        "the second return of dual mode is another echo than the first",
        LIDAR,
        "again = end.range_m == strongest.range_m",
        "again = torch.zeros_like(end.range_m, dtype=torch.bool)",
        ("tests/lidar/test_lidar_stages.py::test_an_echo_close_to_a_stronger_one_is_part_of_it",),
    ),
    Mutant(
        "last_return_is_the_first",
        "the return mode chooses between nearest and farthest echo",
        LIDAR,
        'power = -1.0 if self.return_mode == "first" else 1.0',
        "power = -1.0",
        ("tests/lidar/test_lidar_stages.py::test_an_echo_close_to_a_stronger_one_is_part_of_it",),
    ),
    Mutant(
        "echoes_of_one_pulse_not_merged",
        "echoes closer than the pulse merge into the stronger one",
        LIDAR,
        "absorbed = absorbed | (stronger",
        "absorbed = absorbed & (stronger",
        ("tests/lidar/test_lidar_stages.py::test_an_echo_close_to_a_stronger_one_is_part_of_it",),
    ),
    Mutant(
        "particle_label_not_written",
        "points of weather carry the label PARTICLE",
        LIDAR,
        "torch.full_like(more, PARTICLE, dtype=torch.int8)",
        "torch.full_like(more, OBJECT, dtype=torch.int8)",
        ("tests/lidar/test_lidar_cloud.py::test_one_point_and_beams_that_are_all_empty",),
    ),
    Mutant(
        "zero_weather_dims_intensity",
        "without weather every intensity stays as it came, bit by bit",
        INTENSITY,
        "return torch.where(gain == 1.0, intensity, dimmed)",
        "return dimmed",
        ("tests/lidar/test_intensity.py::test_gain_one_is_the_identity",),
    ),
    Mutant(
        "calibrated_bytes_above_100_linear",
        "Velodyne's scale is logarithmic above 100",
        INTENSITY,
        "_LOG_STEP = math.log(RETROREFLECTIVE_AT_255) / 155.0",
        "_LOG_STEP = math.log(RETROREFLECTIVE_AT_255) / 255.0",
        (
            (
                "tests/lidar/test_intensity.py::test_calibrated_bytes_are_linear_to_white_and_logarithmic_"
                "to_a_retroreflector"
            ),
        ),
    ),
    Mutant(
        "lambert_surface_without_pi",
        "a Lambertian surface returns its reflectivity over pi",
        INTENSITY,
        "intensity_of_reflectivity(math.pi * signal * range_m.square()",
        "intensity_of_reflectivity(signal * range_m.square()",
        ("tests/lidar/test_intensity.py::test_a_signal_goes_to_an_intensity_and_back",),
    ),
    Mutant(
        "range_noise_added_to_objects",
        "range noise belongs to new points; objects keep their measured place",
        LIDAR,
        "range_m = torch.where(particle, self._measured(range_m, noise), range_m)",
        "range_m = self._measured(range_m, noise)",
        ("tests/lidar/test_lidar_stages.py::test_range_noise_and_resolution_are_a_particles_only",),
    ),
    Mutant(
        "strongest_echo_always_at_the_object",
        "the place of the strongest echo is drawn between sensor and object",
        "torchweather.lidar.returns.strongest",
        "wanted = place * _lerp(cells, base + column, reach - column)",
        "wanted = _lerp(cells, base + column, reach - column)",
        ("tests/lidar/returns/test_strongest_returns.py::test_tabulated_solutions_are_those_of_the_bisection",),
    ),
    Mutant(
        "cloud_pose_not_rotated_back",
        "weather points return to the cloud's frame by the rotation of the sensor",
        CLOUD_FRAME,
        "wide = _turned(wide, lidar.rotation, back=True)",
        "wide = list(wide)",
        ("tests/lidar/test_lidar_frame.py::test_there_and_back_is_the_cloud",),
    ),
    Mutant(
        "cloud_pose_rotated_the_wrong_way",
        "the sensor frame is reached by the inverse rotation",
        CLOUD_FRAME,
        "local = _turned(local, lidar.rotation, back=False)",
        "local = _turned(local, lidar.rotation, back=True)",
        ("tests/lidar/test_lidar_frame.py::test_there_and_back_is_the_cloud",),
    ),
    Mutant(
        "unit_hint_reads_the_brightest_point",
        "a hint about the intensity unit looks at the bulk, not at one retroreflector",
        "torchweather.lidar.clouds",
        "BULK = 0.9",
        "BULK = 1.0",
        ("tests/lidar/test_lidar_units.py::test_a_few_points_above_eight_bits_do_not_make_photons",),
    ),
    Mutant(
        "near_response_fit_without_range_square",
        "the fit of the near response takes out the square of the range",
        NEAR_RESPONSE,
        "np.log(s[good] * r[good] ** 2 / rho[good])",
        "np.log(s[good] * r[good] / rho[good])",
        ("tests/lidar/sweep/test_sensor_fit.py::test_the_response_of_a_made_recording_is_found_within_its_intervals",),
    ),
    Mutant(
        "near_response_fit_at_white",
        "photons at the threshold are those of a 10 % target",
        NEAR_RESPONSE,
        "return 0.1 * self.photon_constant",
        "return self.photon_constant",
        ("tests/lidar/sweep/test_sensor_fit.py::test_a_response_becomes_that_of_the_sensor",),
    ),
    Mutant(
        "sensor_origin_forgets_height",
        "the sensor's height is part of its origin",
        SENSOR_ORIGIN,
        "return np.array([x, y, float(np.nanmedian(heights))])",
        "return np.array([x, y, 0.0])",
        ("tests/lidar/sweep/test_sensor_origin.py::test_the_place_is_found_from_rings_by_order_or_column",),
    ),
    Mutant(
        "sensor_frame_not_shifted",
        "a cloud's origin is not its sensor",
        CLOUD_FRAME,
        "column - offset if offset else column for column",
        "column for column",
        ("tests/lidar/test_lidar_frame.py::test_there_and_back_is_the_cloud",),
    ),
    Mutant(
        "empty_beam_moved",
        "a row of zeros stays a beam without return in the cloud's frame",
        CLOUD_FRAME,
        "torch.where(untouched, own, torch.where(there, moved.to(values), 0.0))",
        "torch.where(untouched, own, moved.to(values))",
        ("tests/lidar/test_lidar_frame.py::test_there_and_back_is_the_cloud",),
    ),
    Mutant(
        "ground_slope_reversed",
        "height above a sloping ground",
        "torchweather.lidar.sweep.ground",
        "- self.slope_x * xyz[..., 0] -",
        "+ self.slope_x * xyz[..., 0] -",
        ("tests/report/test_lidar_flat_figures.py::test_points_under_the_ground_are_those_counted_one_by_one",),
    ),
    Mutant(
        "sensor_origin_accepts_every_offset",
        "a sensor is apart only where the offset exceeds its error",
        SENSOR_ORIGIN,
        "_SURE * error_m)",
        "0.0)",
        ("tests/lidar/sweep/test_sensor_origin_evidence.py::test_weak_evidence_moves_no_sensor",),
    ),
    Mutant(
        "sensor_origin_spread_not_compared",
        "an offset counts only where the cones fit better from there",
        SENSOR_ORIGIN,
        "gains = self.spread_deg * _LEAST_GAIN < self.spread_at_zero_deg",
        "gains = True",
        ("tests/lidar/sweep/test_sensor_origin_evidence.py::test_weak_evidence_moves_no_sensor",),
    ),
    Mutant(
        "person_before_the_body_is_the_body",
        "a return nearer than the own vehicle's body is not the vehicle's",
        "torchweather.lidar.sweep.own_vehicle",
        "_MARGIN_M = 0.15",
        "_MARGIN_M = 1.5",
        ("tests/lidar/sweep/test_own_vehicle.py::test_a_person_in_front_of_the_body_is_no_part_of_it",),
    ),
    Mutant(
        "standing_still_shows_new_views",
        "sweeps of a vehicle that stands count as one view",
        "torchweather.lidar.sweep.own_vehicle",
        "weights: Numbers = 1.0 / alike.sum(0)",
        "weights: Numbers = np.ones(len(far))",
        ("tests/lidar/sweep/test_own_vehicle.py::test_a_person_beside_a_standing_car_is_not_in_the_mask",),
    ),
    Mutant(
        "mask_of_another_sensor_taken",
        "a mask of the own vehicle has the rings of its sensor",
        "torchweather.lidar.sweep.own_vehicle",
        "if rings != known:",
        "if False:",
        ("tests/lidar/test_lidar_own_vehicle.py::test_a_mask_of_another_sensor_is_refused",),
    ),
    Mutant(
        "frame_of_the_sweep_not_judged",
        "a sweep that is tilted or stands beside its sensor is refused",
        "torchweather.lidar.sweep.sweep_check",
        "            and self.frame.fits\n",
        "",
        ("tests/lidar/sweep/test_unfit_sweeps.py::test_an_unfit_sweep_is_refused_with_the_cause",),
    ),
    Mutant(
        "sweep_written_twice_completed",
        "a file that holds a sweep twice is refused",
        "torchweather.lidar.sweep.sweep_check",
        "_MOST_COPIES = 0.3",
        "_MOST_COPIES = 1.3",
        ("tests/lidar/sweep/test_unfit_sweeps.py::test_an_unfit_sweep_is_refused_with_the_cause",),
    ),
    Mutant(
        "runs_shorter_than_the_width",
        "a region of the own vehicle is at least its width wide",
        "torchweather.lidar.sweep.sweep_raster",
        "long = end - start >= width",
        "long = end - start >= 1",
        ("tests/lidar/sweep/test_beam_ends.py::test_long_runs_are_a_morphological_opening",),
    ),
    Mutant(
        "cloud_of_a_map_unnoticed",
        "a cloud out of the sensor's reach is noticed",
        "torchweather.lidar.frame_check",
        "if 2 * beyond > len(range_m):",
        "if False:",
        ("tests/cli/test_cli_point_files.py::test_a_cloud_of_a_map_is_noticed",),
    ),
    Mutant(
        "ground_at_the_sensors_height_unnoticed",
        "a cloud whose ground lies at the origin's height is noticed",
        "torchweather.lidar.frame_check",
        "if not _GROUND <= level <= 1.0 - _BELOW or below > _BELOW:",
        "if True:",
        (
            "tests/cli/test_cli_point_files.py::test_a_small_cloud_of_a_vehicle_whose_ground_is_at_the_origin_is_warned_of",
        ),
    ),
    Mutant(
        "echoes_of_a_pulse_do_not_add",
        "particles within one pulse add to the echo of the brightest",
        "torchweather.lidar.returns.beam_particles",
        "        self.pulse_length_m = 0.0 if published else sensor.pulse_length_m",
        "        self.pulse_length_m = 0.0",
        ("tests/lidar/returns/test_strongest_returns.py::test_echoes_of_one_pulse_add",),
    ),
    Mutant(
        "open_air_that_ends_early",
        "a beam into open air has particles up to the sensor's reach",
        "torchweather.lidar.open_air",
        "transform.sensor.max_range_m)",
        "0.05 * transform.sensor.max_range_m)",
        ("tests/lidar/test_open_air.py::test_the_share_is_that_of_drawn_sweeps",),
    ),
)
