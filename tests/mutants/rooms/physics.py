"""Breaks of the pure physics: units, exponents, radius and diameter."""

from __future__ import annotations

from tests.mutants.mutant import Mutant

PRECIPITATION_RATE = "torchweather.physics.precipitation_rate"
FALL_SPEED = "torchweather.physics.fall_speed"
EXTINCTION = "torchweather.physics.extinction"
MIE = "torchweather.physics.mie"
REFRACTIVE_INDEX = "torchweather.physics.refractive_index"

MUTANTS = (
    Mutant(
        "phase_function_of_one_polarisation",
        "unpolarised light is the mean of both amplitudes",
        MIE,
        "0.5 * (_squared(a_pi + b_tau) + _squared(a_tau + b_pi))",
        "_squared(a_tau + b_pi)",
        ("tests/physics/test_phase_function.py::test_the_smallest_spheres_scatter_as_rayleigh_has_it",),
    ),
    Mutant(
        "rain_rate_in_metres_per_second",
        "a rain rate is mm/h, not m/s: the factor 3.6e-3 is dropped",
        PRECIPITATION_RATE,
        "MM_PER_H = 3.6e-3",
        "MM_PER_H = 1.0e-3",
        ("tests/physics/test_precipitation_rate.py::test_mean_fall_speed_that_table_4_would_need",),
    ),
    Mutant(
        "raindrop_volume_of_a_radius",
        "the volume of a drop is pi/6 of its diameter cubed: 4/3 pi belongs to a radius",
        PRECIPITATION_RATE,
        "water_mm3 = math.pi / 6.0 * diameter**3",
        "water_mm3 = 4.0 * math.pi / 3.0 * diameter**3",
        ("tests/physics/test_precipitation_rate.py::test_mean_fall_speed_that_table_4_would_need",),
    ),
    Mutant(
        "snow_speed_law_fed_with_millimetres",
        "Langleben's law takes the melted diameter in cm",
        FALL_SPEED,
        "2.07 * (0.1 * melted) ** 0.31",
        "2.07 * melted**0.31",
        ("tests/physics/test_fall_speed.py::test_power_laws_are_as_stated",),
    ),
    Mutant(
        "large_drops_accelerate",
        "drops above 5.8 mm hold the speed measured by Gunn and Kinzer",
        FALL_SPEED,
        "LARGEST_M_PER_S = 9.17",
        "LARGEST_M_PER_S = 9.65",
        ("tests/physics/test_fall_speed.py::test_large_drops_hold_the_measured_maximum",),
    ),
    Mutant(
        "visibility_at_two_percent_contrast",
        "the meteorological optical range leaves 5 % contrast, not 2 %",
        "torchweather.physics.visibility",
        "MOR_CONTRAST = 0.05",
        "MOR_CONTRAST = 0.02",
        ("tests/physics/test_visibility.py::test_fog_at_visibility_distance_leaves_five_percent_contrast",),
    ),
    Mutant(
        "extinction_of_a_diameter_as_radius",
        "the cross section of a sphere is pi/4 of its diameter squared",
        EXTINCTION,
        "weight = 0.25 * math.pi * PER_M_PER_MM2_M3",
        "weight = math.pi * PER_M_PER_MM2_M3",
        ("tests/physics/test_extinction.py::test_extinction_of_the_fogs_cut_to_the_sizes_of_d34",),
    ),
    Mutant(
        "backscatter_not_per_steradian",
        "a backscatter coefficient is per steradian: the 4 pi is dropped",
        EXTINCTION,
        "return q_back / (4.0 * math.pi) * cross_section_per_m(distribution)",
        "return q_back * cross_section_per_m(distribution)",
        ("tests/physics/test_extinction.py::test_backscatter_of_snow_is_a_lambertian_disk",),
    ),
    Mutant(
        "effective_efficiency_not_halved",
        "Q_eff of 2 leaves the extinction of wave optics as it is",
        EXTINCTION,
        "return extinction * (0.5 * q_eff)",
        "return extinction * q_eff",
        ("tests/physics/test_extinction.py::test_effective_extinction_leaves_out_the_forward_lobe",),
    ),
    Mutant(
        "mie_backscatter_without_alternating_sign",
        "the Mie series alternates in sign towards the source",
        MIE,
        "sign = np.where(n % 2 == 0, weight, -weight)",
        "sign = weight",
        ("tests/physics/test_mie.py::test_bohren_huffman_appendix_a",),
    ),
    Mutant(
        "mie_asymmetry_not_normalised",
        "the asymmetry parameter is a mean over scattered light",
        MIE,
        "/ np.where(q_sca > 0, q_sca, 1.0)",
        "/ 1.0",
        ("tests/physics/test_mie.py::test_wiscombe_1979_printed_cases",),
    ),
    Mutant(
        "radar_equation_with_4_pi_squared",
        "the radar equation has (4 pi) cubed",
        "torchweather.physics.radar_equation",
        "- 30.0 * math.log10(4.0 * math.pi)",
        "- 20.0 * math.log10(4.0 * math.pi)",
        ("tests/radar/fmcw/test_fmcw_oracles.py::test_the_radar_equation",),
    ),
    Mutant(
        "snow_denser_than_ice",
        "a flake is never denser than solid ice",
        "torchweather.physics.snow_geometry",
        ".clamp_max(ICE_DENSITY_G_PER_CM3)",
        "",
        ("tests/physics/test_snow_geometry.py::test_snow_is_never_denser_than_ice_and_the_largest_flake_is_20_mm",),
    ),
    Mutant(
        "fresnel_reflectance_of_amplitude",
        "reflected power is the amplitude ratio squared",
        "torchweather.physics.fresnel",
        "return ((m - 1.0) / (m + 1.0)).abs() ** 2",
        "return ((m - 1.0) / (m + 1.0)).abs()",
        ("tests/physics/test_fresnel.py::test_normal_reflectance_of_water",),
    ),
    Mutant(
        "wet_cover_never_dries",
        "a film of water dries exponentially after the rain",
        "torchweather.physics.wet_cover",
        "- age_min.to(rain_mm_per_h) / dry",
        "- 0.0 * dry",
        ("tests/physics/test_wet_cover.py::test_after_one_drying_time_one_over_e_is_left",),
    ),
    Mutant(
        "snow_mixture_without_two",
        "Maxwell Garnett's rule has 1 + 2 y in its numerator",
        REFRACTIVE_INDEX,
        "around * (1.0 + 2.0 * y) / (1.0 - y)",
        "around * (1.0 + y) / (1.0 - y)",
        ("tests/physics/test_wet_snow.py::test_index_runs_from_dry_snow_to_water_at_the_melting_point",),
    ),
    Mutant(
        "celsius_taken_as_kelvin",
        "Debye's law takes 300 K over the absolute temperature",
        REFRACTIVE_INDEX,
        "theta = 300.0 / (t + KELVIN_AT_0_C)\n",
        "theta = 300.0 / (t + 300.0)\n",
        ("tests/physics/test_refractive_index.py::test_millimetre_wave_water_is_the_double_debye_model",),
    ),
    Mutant(
        "flake_as_bright_as_a_pack",
        "a flake is a thin layer of grains",
        "torchweather.physics.flake_reflectivity",
        "    fall = torch.tanh(k * tau / 2)",
        "    fall = torch.ones_like(tau)",
        ("tests/physics/test_flake_reflectivity.py::test_table_of_physics_10_3",),
    ),
    Mutant(
        "grains_that_absorb_nothing",
        "ice absorbs at 1550 nm",
        "torchweather.physics.flake_reflectivity",
        "    lengthened = (n**3 - (n**2 - 1) ** 1.5) / n",
        "    lengthened = 0.0 * n",
        ("tests/physics/test_flake_reflectivity.py::test_photons_through_a_layer_of_grains",),
    ),
    Mutant(
        "half_the_energy_of_a_fall",
        "a fall from rest gives v^2 = 2 g h before drag counts",
        FALL_SPEED,
        "-2.0 * STANDARD_GRAVITY_M_PER_S2",
        "-STANDARD_GRAVITY_M_PER_S2",
        ("tests/physics/test_fall_speed.py::test_a_drop_from_rest_falls_as_newton_says",),
    ),
    Mutant(
        "gamma_rain_of_one_mode",
        "rain L peaks at a radius of 70 um",
        "torchweather.physics.rain_distributions",
        '"deirmendjian-rain-l": (2.0, 70.0)',
        '"deirmendjian-rain-l": (2.0, 50.0)',
        (
            "tests/physics/test_named_families.py::"
            "test_deirmendjian_rain_has_the_printed_shape_and_carries_the_rate[rain-l-49757000.0-15.1186]",
        ),
    ),
)
