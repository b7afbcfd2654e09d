"""Breaks of the camera: fog, streaks, blur, colour, tone."""

from __future__ import annotations

from tests.mutants.mutant import Mutant

CAMERA = "torchweather.camera.fog"
STREAKS = "torchweather.camera.particles.streaks"
MOSAIC_BLUR = "torchweather.camera.mosaic_blur"
BAYER = "torchweather.camera.bayer"
AIRLIGHT = "torchweather.camera.airlight"

MUTANTS = (
    Mutant(
        "pixels_of_the_shortest_exposure",
        "an HDR pixel is from the longest exposure that is not saturated",
        "torchweather.camera.hdr",
        "for number in reversed(range(len(frames) - 1)):",
        "for number in range(len(frames) - 1):",
        ("tests/camera/test_hdr.py::test_each_pixel_is_from_the_longest_exposure_that_is_not_saturated",),
    ),
    Mutant(
        "airlight_and_transmission_swapped",
        "fog leaves J t + A (1 - t)",
        CAMERA,
        "seen = torch.lerp(*ends, clear).flatten(2, 3)",
        "seen = torch.lerp(*ends, 1.0 - clear).flatten(2, 3)",
        ("tests/camera/test_fog_stage.py::test_the_sky_has_no_gradient_and_spoils_none",),
    ),
    Mutant(
        "lamp_light_falls_with_the_distance",
        "illuminance falls with the square of the distance",
        "torchweather.camera.night.lamp_light",
        "at_1_m = lamp.intensity_cd / distance_m.square()",
        "at_1_m = lamp.intensity_cd / distance_m",
        (
            (
                "tests/camera/night/test_lamp_light.py::test_once_scattered_light_is_the_lidars_backscatter_of_"
                "the_illuminance"
            ),
        ),
    ),
    Mutant(
        "lamp_veil_without_onward_scattering",
        "fog widens a low beam upward, by light scattered onward",
        "torchweather.camera.night.lamp_light",
        "lux = at_1_m * _through_fog(lamp.beam, azimuth, elevation, distance_m, fog)",
        "lux = direct",
        ("tests/camera/night/test_lamp_light.py::test_the_veil_of_headlamps_is_that_of_photons_traced_one_by_one",),
    ),
    Mutant(
        "lamps_of_a_frame_as_bright_as_saturation",
        "a lamp is brighter than the frame that it saturates",
        "torchweather.camera.night.stages",
        "excess[sample, :, rows, columns] = (light[:, None] - before).clamp_min(0.0)",
        "excess[sample, :, rows, columns] = (light[:, None] - before).clamp(0.0, 1.0)",
        ("tests/camera/night/test_night.py::test_a_lamp_glows_by_the_light_that_the_frame_does_not_show",),
    ),
    Mutant(
        "flakes_in_lamplight_without_their_depth",
        "each particle shows the illuminance at its own depth",
        "torchweather.camera.particles.population",
        "place = (sample, marks.u_px, marks.v_px, marks.depth_m, (size[0], size[1]))",
        "place = (sample, marks.u_px, marks.v_px, marks.depth_m * 2.0, (size[0], size[1]))",
        ("tests/camera/night/test_night.py::test_the_mean_light_of_flakes_is_that_of_each_slice_of_air",),
    ),
    Mutant(
        "forward_scattering_at_the_camera_alone",
        "light is scattered anywhere on its path, near the surface with little blur",
        "torchweather.atmosphere.forward_scattering",
        "mean_bessel = itj0y0(turns)[0] / turns",
        "mean_bessel = np.cos(turns)",
        ("tests/camera/test_multiple_scattering.py::test_the_transfer_is_that_of_photons_traced_one_by_one",),
    ),
    Mutant(
        "far_light_scattered_to_near_pixels_unweakened",
        "fog between two depths takes light away before it is scattered to the nearer one",
        "torchweather.camera.multiple_scattering",
        "weights[..., nearer] * weakened",
        "weights[..., nearer] * torch.ones_like(weakened)",
        ("tests/camera/test_multiple_scattering.py::test_a_street_in_fog_of_30_m_looks_as_photons_show_it",),
    ),
    Mutant(
        "scattered_light_added_to_the_airlight",
        "light scattered onward takes the place of airlight",
        "torchweather.camera.multiple_scattering",
        "light - place * phases(airlight, spacing)",
        "light - 0.0 * place * phases(airlight, spacing)",
        ("tests/camera/test_multiple_scattering.py::test_a_scene_as_bright_as_the_airlight_stays_so",),
    ),
    Mutant(
        "fog_extinction_of_the_depth_axis",
        "light fades along the ray, not along the optical axis",
        "torchweather.camera.rays",
        "per_depth = torch.sqrt(1 + x.square() + y.square())",
        "per_depth = torch.ones_like(x + y)",
        ("tests/camera/test_fog_stage.py::test_every_pixel_fades_along_its_ray_at_its_own_colours_extinction",),
    ),
    Mutant(
        "streak_blind_to_depth",
        "a streak hides only behind what is nearer",
        STREAKS,
        "self._each(self.frame.depth_m) < there",
        "self._each(self.frame.depth_m) > there",
        ("tests/camera/particles/test_streaks.py::test_area_is_conserved_at_any_width_and_speed",),
    ),
    Mutant(
        "rows_of_a_mark_begin_before_it",
        "the first row of a mark holds what lies above its lower edge",
        STREAKS,
        ".index_fill(-1, self.first, 0.0)\n        return share - before",
        "\n        return share - before",
        ("tests/camera/particles/test_deposit.py::test_marks_of_like_columns_add_up_to_those_on_one_footprint",),
    ),
    Mutant(
        "draws_stop_short_of_the_rate",
        "a draw at a rate holds every particle of that rate",
        "torchweather.camera.particles.population",
        "replace(one, level_limit=limit)",
        "replace(one, level_limit=0.1 * limit)",
        ("tests/camera/particles/test_draws_at_rate.py::test_a_call_draws_the_first_part_of_the_storm",),
    ),
    Mutant(
        "clear_samples_get_the_rain_of_others",
        "samples at rate 0 stay as they are beside others",
        "torchweather.camera.particles.veil",
        "signal = state.image.signal.index_copy(0, index, after.image.signal)",
        "signal = state.image.signal.index_copy(0, 0 * index, after.image.signal)",
        ("tests/camera/particles/test_draws_at_rate.py::test_samples_at_rate_0_stay_as_they_are_beside_others",),
    ),
    Mutant(
        "bytes_of_light_rounded_down",
        "a level begins half a step below it",
        "torchweather.camera.srgb_bytes",
        "(np.arange(1, LEVELS) - 0.5)",
        "(np.arange(1, LEVELS) - 0.4)",
        ("tests/camera/test_srgb_bytes.py::test_levels_are_the_nearest_of_the_transfer_function",),
    ),
    Mutant(
        "mosaic_blur_mixes_colours",
        "pixels of one colour of a mosaic lie two apart",
        MOSAIC_BLUR,
        "_blurring(variance, width)",
        "_blurring(variance_px2, width)",
        (
            (
                "tests/camera/test_mosaic_blur.py::test_a_blur_by_products_with_parts_of_its_band_matrix_is_"
                "the_convolution"
            ),
        ),
    ),
    Mutant(
        "bayer_pattern_red_and_blue_swapped",
        "RGGB starts with red",
        BAYER,
        '"RGGB": ((0, 1), (1, 2))',
        '"RGGB": ((2, 1), (1, 0))',
        ("tests/camera/test_bayer.py::test_pattern_name_reads_the_top_left_cell_in_rows",),
    ),
    Mutant(
        "phases_of_a_mosaic_in_columns",
        "phases go row by row through the cell",
        BAYER,
        "torch.movedim(cells, (-3, -1), (-4, -3))",
        "torch.movedim(cells, (-1, -3), (-4, -3))",
        ("tests/camera/test_bayer.py::test_planes_split_and_join_without_loss",),
    ),
    Mutant(
        "srgb_knee_dropped",
        "sRGB is linear near black",
        "torchweather.camera.tone",
        "12.92 * linear",
        "1.0 * linear",
        ("tests/camera/test_tone.py::test_srgb_gradient_is_finite_at_black",),
    ),
    Mutant(
        "near_mask_left_in_fog",
        "the bonnet lies before the fog",
        CAMERA,
        "clear, torch.ones_like(clear), state.by_cells(state.scene.near_mask[rows])",
        "clear, clear, state.by_cells(state.scene.near_mask[rows])",
        ("tests/camera/test_rgb_planes.py::test_no_weather_lies_in_front_of_the_own_vehicle",),
    ),
    Mutant(
        "blur_adds_light",
        "a blur keeps the light of the frame",
        MOSAIC_BLUR,
        "/ points_px.shape[1]",
        "/ (0.9 * points_px.shape[1])",
        (
            (
                "tests/camera/effects/test_effects_camera.py::test_ego_blur_of_parabolas_adds_the_variance_of_its_"
                "line_along_it_alone"
            ),
        ),
    ),
    Mutant(
        "grey_sky_weighed_evenly",
        "luminance weighs green most, as Rec. 709 does",
        AIRLIGHT,
        "REC709 = (0.2126, 0.7152, 0.0722)",
        "REC709 = (0.7152, 0.2126, 0.0722)",
        (("tests/camera/test_rgb_planes.py::test_airlight_is_the_grey_of_the_sky_above_the_horizon_not_of_all_sky"),),
    ),
    Mutant(
        "horizon_is_the_zenith",
        "fog takes the light of the sky at the horizon",
        AIRLIGHT,
        "torch.exp(((lowest - sine) / BAND_SINE).clamp_max(0.0))",
        "torch.exp((lowest * 0.0 - 0.0 * sine))",
        (("tests/camera/test_rgb_planes.py::test_airlight_is_the_grey_of_the_sky_above_the_horizon_not_of_all_sky"),),
    ),
    Mutant(
        "quantised_upwards",
        "levels are rounded to the nearest",
        CAMERA,
        "rounded = torch.round(state.image.signal.clamp(0, 1) * steps) / steps",
        "rounded = torch.ceil(state.image.signal.clamp(0, 1) * steps) / steps",
        ("tests/camera/test_quantise.py::test_a_signal_goes_to_the_nearest_of_its_levels",),
    ),
    Mutant(
        "saturation_not_clipped",
        "a sensor saturates at 1",
        CAMERA,
        "rounded = torch.round(state.image.signal.clamp(0, 1) * steps) / steps",
        "rounded = torch.round(state.image.signal * steps) / steps",
        ("tests/camera/test_quantise.py::test_a_signal_goes_to_the_nearest_of_its_levels",),
    ),
    Mutant(
        "disk_spread_as_a_square",
        "a disk's profile has 12 / 16 of the variance of a box",
        STREAKS,
        "BOX_OF_DISK = math.sqrt(12 / 16)",
        "BOX_OF_DISK = 1.0",
        ("tests/camera/particles/test_narrow_marks.py::test_spread_along_the_motion_is_that_of_a_disk",),
    ),
    Mutant(
        "marks_longer_by_three_percent",
        "a mark in the tables is as long as the particle's path during the exposure",
        "torchweather.camera.particles.tables",
        "length = speed * optics.exposure_s / footprint_m",
        "length = 1.03 * speed * optics.exposure_s / footprint_m",
        ("tests/camera/particles/test_particle_tables.py::test_the_variance_of_the_haze_is_that_of_its_marks",),
    ),
    Mutant(
        "marks_off_the_axis_as_large_as_on_it",
        "a sphere's image grows by 1 / cos(theta)",
        "torchweather.camera.particles.population",
        "    return torch.sqrt(1 + x.square() + y.square())",
        "    return torch.ones_like(x + y)",
        ("tests/camera/particles/test_off_axis.py::test_cover_at_the_corner_is_that_of_the_rays",),
    ),
    Mutant(
        "haze_off_the_axis_as_deep_as_on_it",
        "the haze's optical depth is that of the ray",
        "torchweather.camera.particles.haze",
        "mean, variance = on_axis * ray, variance * ray.square()",
        "mean = on_axis",
        ("tests/camera/particles/test_off_axis.py::test_cover_at_the_corner_is_that_of_the_rays",),
    ),
    Mutant(
        "flakes_lit_by_the_horizon_alone",
        "half of a flake's light comes from the ground",
        "torchweather.camera.flake_light",
        "    return (from_sky + from_ground) / 2",
        "    return from_sky",
        ("tests/camera/test_flake_light.py::test_flakes_before_asphalt_are_half_as_bright_as_the_horizon",),
    ),
    Mutant(
        "exposure_kept_over_the_whole_batch",
        "each frame has its own exposure",
        "torchweather.camera.exposure",
        "        return inside.flatten(1).mean(1)",
        "        return inside.mean().expand(len(inside))",
        ("tests/camera/test_exposure.py::test_each_frame_gets_its_mean_back",),
    ),
    Mutant(
        "haze_of_a_standing_vehicle",
        "the haze's streaks are as long as the vehicle's motion makes them",
        "torchweather.camera.particles.tables",
        "    moving = None if motion is None or motion.still else motion.rounded()",
        "    moving = None",
        ("tests/camera/particles/test_haze_in_motion.py::test_variance_and_correlation_are_those_of_single_streaks",),
    ),
    Mutant(
        "luminance_by_the_f_number_itself",
        "the light that a lens lets in goes with the square of its f-number",
        "torchweather.camera.luminance",
        "SATURATION_LX_S * self.f_number**2",
        "SATURATION_LX_S * self.f_number",
        ("tests/camera/test_luminance.py::test_a_metered_scene_has_the_same_signal_at_every_exposure",),
    ),
    Mutant(
        "air_that_does_not_radiate",
        "thermal fog is as warm as the air, not black",
        "torchweather.camera.thermal",
        "        seen = torch.lerp(of_air.expand_as(clear)",
        "        seen = torch.lerp(0.0 * of_air.expand_as(clear)",
        ("tests/camera/test_thermal.py::test_small_droplets_let_heat_through_and_large_ones_do_not",),
    ),
)
