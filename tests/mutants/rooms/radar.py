"""Breaks of the radar: path, echo of the air, detection, maps."""

from __future__ import annotations

from tests.mutants.mutant import Mutant

VOLUME_CLUTTER = "torchweather.radar.clutter"
RADAR = "torchweather.radar.stages"
RANGE_DOPPLER = "torchweather.radar.fmcw.range_doppler"
BEAT_SIGNAL = "torchweather.radar.fmcw.beat_signal"
CFAR = "torchweather.radar.fmcw.cfar"

MUTANTS = (
    Mutant(
        "radar_attenuation_taken_one_way",
        "a radar wave passes the rain out and back",
        VOLUME_CLUTTER,
        "path_db = 2e-3 * state.air.attenuation_db_per_km[:, None] * range_m + state",
        "path_db = 1e-3 * state.air.attenuation_db_per_km[:, None] * range_m + state",
        (
            (
                "tests/radar/test_volume_clutter.py::test_powers_above_the_threshold_are_exponential_about_"
                "the_mean_of_the_cell"
            ),
        ),
    ),
    Mutant(
        "rain_echo_falls_as_a_point",
        "an echo of a volume falls with the square of the range: the cell grows",
        VOLUME_CLUTTER,
        "return GAUSSIAN_AREA * azimuth * elevation * radar.range_resolution_m * range_m.square()",
        "return GAUSSIAN_AREA * azimuth * elevation * radar.range_resolution_m * range_m",
        (
            (
                "tests/radar/test_volume_clutter.py::test_a_cell_of_heavy_rain_has_the_cross_section_of_"
                "the_worked_example"
            ),
        ),
    ),
    Mutant(
        "noise_and_detection_threshold_swapped",
        "a target is lost below the detection threshold, not below the noise",
        RADAR,
        "kind = state.returns.kind.masked_fill(above < 0, LOST)",
        "kind = state.returns.kind.masked_fill(snr < 0, LOST)",
        ("tests/radar/test_radar_stages.py::test_a_target_is_lost_below_the_floor_plus_the_detection_snr",),
    ),
    Mutant(
        "lost_radar_target_keeps_its_place",
        "a lost target leaves a row of zeros",
        RADAR,
        "points[..., :3].masked_fill(lost[..., None], 0.0)",
        "points[..., :3].masked_fill(lost[..., None], 1.0)",
        ("tests/radar/test_radar_stages.py::test_rows_leave_with_their_weakened_power_and_lost_ones_at_the_origin",),
    ),
    Mutant(
        "map_noise_without_window",
        "a window widens the noise bandwidth of a map",
        RANGE_DOPPLER,
        "return radar.noise_power_dbm + 10.0 * math.log10(bandwidth)",
        "return radar.noise_power_dbm",
        ("tests/radar/fmcw/test_range_doppler.py::test_noise_in_a_bin_is_that_of_the_samples_less_the_transforms",),
    ),
    Mutant(
        "doppler_bins_not_centred",
        "the speed axis is centred: half of the bins approach",
        RANGE_DOPPLER,
        (
            "turns = torch.remainder(doppler_bin - radar.chirps // 2 + 0.5 * radar.chirps, "
            "radar.chirps) - 0.5 * radar.chirps"
        ),
        "turns = torch.remainder(doppler_bin - radar.chirps // 2, radar.chirps)",
        ("tests/radar/fmcw/test_range_doppler.py::test_receding_targets_are_in_the_upper_half",),
    ),
    Mutant(
        "beat_frequency_of_one_way",
        "a beat frequency is of the way out and back",
        BEAT_SIGNAL,
        "per_metre = 2.0 * radar.slope_hz_per_s",
        "per_metre = 1.0 * radar.slope_hz_per_s",
        ("tests/radar/fmcw/test_beat_signal.py::test_the_stated_accuracy_holds_over_a_whole_frame",),
    ),
    Mutant(
        "received_amplitude_with_range",
        "received power falls with the fourth power of the range, amplitude with its square",
        BEAT_SIGNAL,
        "/ 20.0) / range_m.square()",
        "/ 20.0) / range_m",
        ("tests/radar/fmcw/test_beat_signal.py::test_the_stated_accuracy_holds_over_a_whole_frame",),
    ),
    Mutant(
        "cfar_threshold_without_neighbour_count",
        "the noise of a CFAR is a mean, not a sum",
        CFAR,
        "return total * (_column_factors(self, columns) / _column_cells(self, columns)).to(power)",
        "return total * _column_factors(self, columns).to(power)",
        ("tests/radar/fmcw/test_cfar.py::test_single_cells_are_judged_as_the_map_is",),
    ),
    Mutant(
        "cfar_guard_cells_in_training",
        "guard cells do not count as noise",
        CFAR,
        "(abs(doppler) > self.guard[0]) | (abs(columns) > self.guard[1])",
        "(abs(doppler) >= self.guard[0]) | (abs(columns) >= self.guard[1])",
        ("tests/radar/fmcw/test_cfar.py::test_cell_averaging_has_the_classical_factor",),
    ),
    Mutant(
        "window_not_normalised",
        "a window has unit sum: a tone keeps its power",
        "torchweather.radar.fmcw.windows",
        "return weights / weights.sum()",
        "return weights",
        ("tests/radar/fmcw/test_range_doppler.py::test_noise_in_a_bin_is_that_of_the_samples_less_the_transforms",),
    ),
    Mutant(
        "rain_echo_of_the_map_without_range",
        "volume echo of a map falls with the square of the range",
        "torchweather.radar.fmcw.volume_echo",
        "* radar.range_resolution_m / safe_m.square()",
        "* radar.range_resolution_m / safe_m",
        (
            (
                "tests/radar/fmcw/test_volume_echo.py::test_the_echo_falls_with_the_square_of_the_range_and_the_"
                "way_there_and_back"
            ),
        ),
    ),
    Mutant(
        "noise_floor_of_the_median",
        "the mean of exponential noise lies 1.6 dB above its median",
        "torchweather.radar.power_map.noise_floor",
        "return median_db - 10.0 * math.log10(float(special.gammaincinv(looks, 0.5)) / looks)",
        "return median_db",
        ("tests/radar/power_map/test_power_scale.py::test_a_map_of_bytes_read_by_its_noise_has_its_floor_at_0_db",),
    ),
    Mutant(
        "amplitude_map_read_as_power",
        "an amplitude is 20 log10",
        "torchweather.radar.power_map.scale",
        "return 20.0 * number.abs().log10()",
        "return 10.0 * number.abs().log10()",
        ("tests/radar/power_map/test_power_scale.py::test_powers_and_amplitudes",),
    ),
)
