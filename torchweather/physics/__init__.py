"""Physics as pure functions: particles, their optics, and what they take from a signal."""

from __future__ import annotations

from torchweather.core.moved import renamed
from torchweather.physics.binned_distribution import Binned
from torchweather.physics.d34 import Table13Row, table13
from torchweather.physics.extinction import (
    FLAKE_ALBEDO,
    Q_EFF,
    backscatter_per_m_sr,
    cross_section_per_m,
    effective_extinction_per_m,
    extinction_and_backscatter,
    extinction_per_m,
    lidar_ratio_sr,
    rain_q_back,
    single_scattering_albedo,
)
from torchweather.physics.fall_speed import (
    fall_speed_after_m_per_s,
    flake_fall_speed_m_per_s,
    rain_fall_speed_m_per_s,
    snow_fall_speed_m_per_s,
)
from torchweather.physics.flake_reflectivity import (
    FLAKE_COLUMN_KG_PER_M2,
    SNOW_PACK_REFLECTIVITY,
    flake_reflectivity,
)
from torchweather.physics.fog_distributions import (
    FOG,
    advection_fog,
    bernardin,
    default_fog,
    deirmendjian_fog,
    rehearse_fog,
    scaled_to_visibility,
)
from torchweather.physics.fresnel import SphereBudget, axial_q_back, normal_reflectance, sphere_budget
from torchweather.physics.interpolation import InterpolationTable
from torchweather.physics.mie import MieEfficiencies, mie_coefficients, mie_efficiencies
from torchweather.physics.phase_function import henyey_greenstein_per_sr, mie_phase_function_per_sr
from torchweather.physics.precipitation_rate import close_rate, precipitation_rate_mm_per_h, rain_rate_mm_per_h
from torchweather.physics.radar_attenuation import (
    RAIN_ATTENUATION_MODELS,
    SNOW_ATTENUATION_MODELS,
    fog_attenuation_coefficient_db_per_km_per_g_per_m3,
    fog_attenuation_db_per_km,
    rain_attenuation_db_per_km,
    snow_attenuation_db_per_km,
)
from torchweather.physics.radar_equation import (
    SPEED_OF_LIGHT_M_PER_S,
    radar_constant_db,
    received_power_dbm,
    target_rcs_dbsm,
    thermal_noise_dbm,
)
from torchweather.physics.radar_scattering import (
    DB_PER_KM,
    particle_attenuation_db_per_km,
    reflectivity_weighted_fall_speed,
    volume_reflectivity_m2_per_m3,
)
from torchweather.physics.rain_attenuation import (
    RainCoefficients,
    rain_attenuation_coefficients,
    rain_attenuation_p838_db_per_km,
)
from torchweather.physics.rain_distributions import (
    DEIRMENDJIAN_RAIN,
    JOSS,
    RAIN,
    deirmendjian_rain,
    joss_rain,
    marshall_palmer,
)
from torchweather.physics.refractive_index import (
    ice_permittivity_microwave,
    ice_refractive_index,
    ice_refractive_index_microwave,
    maxwell_garnett,
    snow_refractive_index_microwave,
    water_permittivity_microwave,
    water_refractive_index,
    water_refractive_index_25c,
    water_refractive_index_microwave,
    wet_snow_refractive_index_microwave,
)
from torchweather.physics.size_distributions import Exponential, Gamma, LogNormal, ModifiedGamma, SizeDistribution
from torchweather.physics.snow_distributions import (
    SNOW,
    brandes_snow,
    brandes_table4,
    gunn_marshall,
    sekhon_srivastava,
)
from torchweather.physics.snow_geometry import (
    equal_visibility_rain_rate,
    melted_diameter_mm,
    physical_diameter_mm,
    snow_bulk_density_g_per_cm3,
    wet_flake_diameter_mm,
)
from torchweather.physics.thermal_band import ThermalBand, planck_w_per_m2_sr_um
from torchweather.physics.visibility import (
    LIQUID_WATER_LAWS,
    extinction_from_mor,
    liquid_water_from_mor_g_per_m3,
    mor_from_extinction,
    mor_from_liquid_water_m,
)
from torchweather.physics.wet_cover import wet_cover_loss_db, wet_cover_series_db

__all__ = [
    "DB_PER_KM",
    "FLAKE_ALBEDO",
    "FLAKE_COLUMN_KG_PER_M2",
    "FOG",
    "JOSS",
    "LIQUID_WATER_LAWS",
    "Q_EFF",
    "RAIN",
    "RAIN_ATTENUATION_MODELS",
    "SNOW",
    "SNOW_ATTENUATION_MODELS",
    "SNOW_PACK_REFLECTIVITY",
    "SPEED_OF_LIGHT_M_PER_S",
    "Binned",
    "Exponential",
    "Gamma",
    "InterpolationTable",
    "LogNormal",
    "MieEfficiencies",
    "ModifiedGamma",
    "RainCoefficients",
    "SizeDistribution",
    "ThermalBand",
    "SphereBudget",
    "Table13Row",
    "advection_fog",
    "axial_q_back",
    "backscatter_per_m_sr",
    "bernardin",
    "brandes_snow",
    "brandes_table4",
    "close_rate",
    "cross_section_per_m",
    "default_fog",
    "deirmendjian_fog",
    "deirmendjian_rain",
    "effective_extinction_per_m",
    "equal_visibility_rain_rate",
    "extinction_and_backscatter",
    "extinction_from_mor",
    "extinction_per_m",
    "flake_fall_speed_m_per_s",
    "flake_reflectivity",
    "fog_attenuation_coefficient_db_per_km_per_g_per_m3",
    "fog_attenuation_db_per_km",
    "gunn_marshall",
    "henyey_greenstein_per_sr",
    "ice_permittivity_microwave",
    "ice_refractive_index",
    "ice_refractive_index_microwave",
    "joss_rain",
    "lidar_ratio_sr",
    "liquid_water_from_mor_g_per_m3",
    "marshall_palmer",
    "maxwell_garnett",
    "melted_diameter_mm",
    "mie_coefficients",
    "mie_efficiencies",
    "mie_phase_function_per_sr",
    "mor_from_extinction",
    "mor_from_liquid_water_m",
    "normal_reflectance",
    "particle_attenuation_db_per_km",
    "physical_diameter_mm",
    "planck_w_per_m2_sr_um",
    "precipitation_rate_mm_per_h",
    "radar_constant_db",
    "rain_attenuation_coefficients",
    "rain_attenuation_db_per_km",
    "rain_attenuation_p838_db_per_km",
    "fall_speed_after_m_per_s",
    "rain_fall_speed_m_per_s",
    "rain_q_back",
    "rain_rate_mm_per_h",
    "received_power_dbm",
    "reflectivity_weighted_fall_speed",
    "rehearse_fog",
    "scaled_to_visibility",
    "sekhon_srivastava",
    "single_scattering_albedo",
    "snow_attenuation_db_per_km",
    "snow_bulk_density_g_per_cm3",
    "snow_fall_speed_m_per_s",
    "snow_refractive_index_microwave",
    "sphere_budget",
    "table13",
    "target_rcs_dbsm",
    "thermal_noise_dbm",
    "volume_reflectivity_m2_per_m3",
    "water_permittivity_microwave",
    "water_refractive_index",
    "water_refractive_index_25c",
    "water_refractive_index_microwave",
    "wet_cover_loss_db",
    "wet_cover_series_db",
    "wet_flake_diameter_mm",
    "wet_snow_refractive_index_microwave",
    "DEIRMENDJIAN_RAIN",
]

__getattr__ = renamed(__name__, {"KnobTable": ("torchweather.physics.InterpolationTable", InterpolationTable)})
