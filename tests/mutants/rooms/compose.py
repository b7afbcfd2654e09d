"""Breaks of what all sensors share: random streams, chains, recipes, data sets."""

from __future__ import annotations

from tests.mutants.mutant import Mutant

RANDOM = "torchweather.core.random"
YAML_FILE = "torchweather.core.yaml_file"
SCHEMA = "torchweather.core.schema"
DISTRIBUTIONS = "torchweather.core.distributions"
CHAIN = "torchweather.pipeline.chain"
RGB_PLANES = "torchweather.camera.rgb_planes"
WEATHER_DATASET = "torchweather.compose.weather_dataset"
WEATHER = "torchweather.atmosphere.weather"
TRANSFORM = "torchweather.pipeline.sensor_transform"

MUTANTS = (
    Mutant(
        "all_samples_share_one_stream",
        "each sample of a batch has its own random stream",
        RANDOM,
        "return [int(seed) + row for row in range(number)]",
        "return [int(seed) for row in range(number)]",
        ("tests/core/test_random.py::test_seeds_come_as_integers_in_row_major_order",),
    ),
    Mutant(
        "stage_name_not_in_the_stream",
        "each stage and variate has its own random stream",
        RANDOM,
        'digest = hashlib.blake2b(stream.encode("utf-8", "surrogatepass"), digest_size=8).digest()',
        'digest = hashlib.blake2b(b"", digest_size=8).digest()',
        ("tests/core/test_random.py::test_another_seed_stage_or_variate_gives_unrelated_numbers",),
    ),
    Mutant(
        "epoch_not_in_the_seed",
        "another epoch draws other weather",
        RANDOM,
        "/{_whole(epoch, 'epoch')}/",
        "/{0}/",
        ("tests/compose/test_weather_dataset.py::test_the_weather_is_another_one_for_each_sample_and_epoch",),
    ),
    Mutant(
        "log_uniform_is_uniform",
        "a log-uniform law has its median at the geometric mean",
        DISTRIBUTIONS,
        "return float(self.low * (self.high / self.low) ** u)",
        "return float(self.low + u * (self.high - self.low))",
        ("tests/core/test_distributions.py::test_shares_of_the_probability_become_values",),
    ),
    Mutant(
        "weights_of_a_choice_ignored",
        "a choice follows its weights",
        DISTRIBUTIONS,
        "weights = self.weights or (1.0,)",
        "weights = (1.0,)",
        ("tests/core/test_distributions.py::test_shares_of_the_probability_become_values",),
    ),
    Mutant(
        "nuisances_share_one_stream",
        "each nuisance parameter has its own random stream",
        TRANSFORM,
        'f"nuisance.{name}").random()',
        '"nuisance").random()',
        ("tests/pipeline/test_nuisances.py::test_draws_follow_their_law_and_are_independent_of_each_other",),
    ),
    Mutant(
        "world_of_each_sensor",
        "sensors of a sample share the airlight that was drawn",
        TRANSFORM,
        'OF_THE_WORLD = ("airlight", ',
        "OF_THE_WORLD = (",
        ("tests/pipeline/test_nuisances.py::test_sensors_share_what_is_of_the_world_and_not_what_is_their_own",),
    ),
    Mutant(
        "chain_file_of_pickles",
        "arrays of a chain file never hold pickles",
        "torchweather.core.archives",
        "np.lib.format.read_array(file, allow_pickle=False)",
        "np.lib.format.read_array(file, allow_pickle=True)",
        ("tests/pipeline/test_chain.py::test_pickled_arrays_are_refused",),
    ),
    Mutant(
        "chain_insert_after_is_before",
        "a stage inserted after another comes after it",
        CHAIN,
        (
            "            if known == before:\n                ordered[new_name] = stage\n            "
            "ordered[known] = present\n            if known == after:"
        ),
        (
            "            if known == after:\n                ordered[new_name] = stage\n            "
            "ordered[known] = present\n            if known == before:"
        ),
        ("tests/pipeline/test_chain.py::test_stages_are_put_in_where_asked",),
    ),
    Mutant(
        "yaml_makes_objects",
        "YAML of a user is data: its tags make no objects",
        YAML_FILE,
        "if tag not in PLAIN[type(node)]:",
        "if False:",
        ("tests/core/test_yaml_readers.py::test_a_hostile_value_is_refused_with_file_and_key",),
    ),
    Mutant(
        "yaml_key_twice_counts_last",
        "a key that stands twice is refused",
        YAML_FILE,
        "if key in own:",
        "if False:",
        ("tests/core/test_yaml_readers.py::test_a_hostile_file_is_refused_with_key_or_line",),
    ),
    Mutant(
        "yaml_of_any_depth",
        "nesting ends before the stack does",
        YAML_FILE,
        "MAX_DEPTH = 50",
        "MAX_DEPTH = 10_000",
        ("tests/core/test_yaml_readers.py::test_a_hostile_value_is_refused_with_file_and_key",),
    ),
    Mutant(
        "yaml_integer_of_any_length",
        "an integer has 64 bits at most",
        YAML_FILE,
        "MAX_INTEGER = 2**64",
        "MAX_INTEGER = 2**640",
        ("tests/core/test_yaml_readers.py::test_a_hostile_value_is_refused_with_file_and_key",),
    ),
    Mutant(
        "yaml_nan_is_a_number",
        "NaN is refused by the reader",
        YAML_FILE,
        "(math.isnan(value) and not self.nan)",
        "False",
        ("tests/core/test_yaml_readers.py::test_a_value_of_the_wrong_type_is_refused_with_file_and_key",),
    ),
    Mutant(
        "yaml_alias_of_itself",
        "an alias that holds itself is refused",
        YAML_FILE,
        "if id(node) in self.open:",
        "if False:",
        ("tests/core/test_yaml_readers.py::test_a_hostile_value_is_refused_with_file_and_key",),
    ),
    Mutant(
        "unknown_keys_pass",
        "an unknown key is refused with the nearest",
        SCHEMA,
        "if name not in names:",
        "if False:",
        ("tests/core/test_yaml_readers.py::test_a_misspelt_key_is_refused_with_the_nearest",),
    ),
    Mutant(
        "wrong_values_pass",
        "a value that does not fit its key is refused",
        SCHEMA,
        "if key.fits(value) or (key.null and value is None):",
        "if True:",
        ("tests/recipes/test_recipe_files.py::test_what_is_wrong_is_refused_with_file_and_key",),
    ),
    Mutant(
        "severities_may_get_lighter",
        "severities of a suite get heavier",
        "torchweather.recipes.suite",
        "after.value < before.value if after.knob in FALLS",
        "after.value > before.value if after.knob in FALLS",
        ("tests/recipes/test_recipes.py::test_a_severity_is_the_same_weather_for_all_sensors_and_gets_heavier",),
    ),
    Mutant(
        "suite_before_transform",
        "a short name means a transform first",
        "torchweather.recipes.files",
        'KINDS = ("transform", "multi_sensor", "suite")',
        'KINDS = ("suite", "multi_sensor", "transform")',
        ("tests/recipes/test_recipes.py::test_a_recipe_is_found_by_its_short_name_and_its_path",),
    ),
    Mutant(
        "untouched_pixels_re_encoded",
        "pixels without weather keep their value bit by bit",
        RGB_PLANES,
        "return torch.where(after == before, rgb, seen.to(rgb.dtype))",
        "return seen.to(rgb.dtype)",
        ("tests/camera/test_rgb_planes.py::test_no_weather_lies_in_front_of_the_own_vehicle",),
    ),
    Mutant(
        "random_weather_ignores_the_picture",
        "pictures of one seed get different weather",
        "torchweather.compose.random_weather",
        "zlib.crc32(pixels.tobytes())",
        "0",
        (
            (
                "tests/compose/test_random_weather.py::test_a_seed_of_the_transform_makes_the_weather_a_"
                "function_of_the_picture"
            ),
        ),
    ),
    Mutant(
        "dataset_epoch_ignored",
        "another epoch gives a sample other weather",
        WEATHER_DATASET,
        "sample_seed(self.seed, int(index), int(self._epoch))",
        "sample_seed(self.seed, int(index), 0)",
        ("tests/compose/test_weather_dataset.py::test_the_weather_is_another_one_for_each_sample_and_epoch",),
    ),
    Mutant(
        "dataset_index_ignored",
        "each sample of a data set has its own seed",
        WEATHER_DATASET,
        "sample_seed(self.seed, int(index), int(self._epoch))",
        "sample_seed(self.seed, 0, int(self._epoch))",
        ("tests/compose/test_weather_dataset.py::test_labels_follow_with_what_happened_to_the_points",),
    ),
    Mutant(
        "completed_beams_kept_for_another_cloud",
        "beams found for one cloud do not serve another",
        "torchweather.lidar.beams",
        "if alike and kept is not None and torch.equal(kept, points):",
        "if alike and kept is not None:",
        (
            (
                "tests/lidar/sweep/test_scan_completion.py::test_a_draw_and_its_call_find_the_beams_once_and_"
                "changed_points_anew"
            ),
        ),
    ),
    Mutant(
        "untouched_picture_re_encoded",
        "a picture without weather comes back bit by bit",
        "torchweather.camera.through_mosaic",
        "unlike = torch.ones_like(after, dtype=torch.bool) if before is None else after != before",
        "unlike = torch.ones_like(after, dtype=torch.bool)",
        ("tests/camera/test_rgb_values.py::test_a_picture_whose_mosaic_did_not_change_comes_back_bit_for_bit",),
    ),
    Mutant(
        "planes_not_linearised",
        "sRGB is decoded before light is added",
        RGB_PLANES,
        "return srgb_decode(levels)[rgb.int()]",
        "return levels[rgb.int()]",
        ("tests/camera/test_rgb_values.py::test_planes_are_linear_in_light",),
    ),
    Mutant(
        "white_beyond_one_accepted",
        "a float picture lies in 0 to 1",
        RGB_PLANES,
        "if not (low >= 0.0 and high <= 1.0):",
        "if False:",
        ("tests/camera/test_rgb_values.py::test_float_pictures_outside_0_to_1_are_refused",),
    ),
    Mutant(
        "mixture_draw_of_one_stream",
        "each part of a weather is drawn from its own stream",
        WEATHER,
        'f"weather.{self.kind}.{name}"',
        'f"weather.{name}"',
        ("tests/atmosphere/test_weather_draws.py::test_parts_of_a_mixture_are_drawn_apart",),
    ),
    Mutant(
        "densest_fog_is_the_clearest",
        "the densest fog has the shortest visibility",
        WEATHER,
        '"mor_m": min',
        '"mor_m": max',
        ("tests/atmosphere/test_weather_draws.py::test_the_densest_weather_of_a_law",),
    ),
    Mutant(
        "samples_are_never_left_clear",
        "with p below 1 some samples of a batch stay clear",
        "torchweather.pipeline.at_call",
        'wet = [p >= 1.0 or float(keyed_stream(seed, "weather.p").random()) < p for seed in seeds]',
        "wet = [True for seed in seeds]",
        ("tests/pipeline/test_at_call.py::test_the_share_of_samples_in_weather_is_p",),
    ),
    Mutant(
        "one_rate_for_the_whole_batch",
        "each sample of a call has a rate of its own",
        "torchweather.pipeline.at_call",
        "drawn = [weather.drawn(seed) for seed in seeds]",
        "drawn = [weather.drawn(seeds[0]) for seed in seeds]",
        ("tests/contract/test_transforms.py::test_each_sample_gets_a_rate_of_its_own_the_same_in_any_batch",),
    ),
    Mutant(
        "change_after_the_first_call_unseen",
        "a chain that was changed is not built anew without a word",
        "torchweather.pipeline.sensor_transform",
        "changed = self.as_built.changed(self.chain)",
        'changed = ""',
        ("tests/pipeline/test_at_call.py::test_a_change_after_the_first_call_is_noticed_too",),
    ),
    Mutant(
        "catalogue_not_loaded",
        "an effect is known by its name in a fresh process",
        "torchweather.pipeline.effect",
        "    load_catalogue()\n",
        "",
        ("tests/pipeline/test_catalogue_in_a_fresh_process.py::test_an_effect_is_built_from_its_dictionary",),
    ),
    Mutant(
        "rgb_flag_for_a_lidar",
        "a recipe of a LiDAR is refused the flag rgb",
        "torchweather.recipes.options",
        '"lidar": (), "radar": ()}',
        '"lidar": ("rgb",), "radar": ()}',
        ("tests/recipes/test_recipe_files.py::test_what_is_wrong_is_refused_with_file_and_key",),
    ),
    Mutant(
        "directions_saved_in_a_recipe",
        "what belongs to the data is refused in a recipe",
        "torchweather.lidar.sensor",
        'data_fields: ClassVar[tuple[str, ...]] = ("directions",)',
        "data_fields: ClassVar[tuple[str, ...]] = ()",
        ("tests/recipes/test_recipes.py::test_what_a_recipe_cannot_hold_is_refused_and_leaves_no_file",),
    ),
    Mutant(
        "streams_salted",
        "the numbers of a seed and a stream are the same in every release",
        "torchweather.core.random",
        'digest = hashlib.blake2b(stream.encode("utf-8", "surrogatepass"), digest_size=8).digest()',
        'digest = hashlib.blake2b(stream.encode() + b"salt", digest_size=8).digest()',
        ("tests/contract/test_golden_draws.py::test_every_stream_of_a_transform_draws_its_golden_numbers",),
    ),
    Mutant(
        "seeds_of_samples_salted",
        "the seed of a sample is the same in every release",
        "torchweather.core.random",
        "hashlib.blake2b(content, digest_size=8)",
        'hashlib.blake2b(content + b"salt", digest_size=8)',
        ("tests/contract/test_golden_draws.py::test_seeds_of_samples_and_parts_are_pinned",),
    ),
    Mutant(
        "noise_not_checked",
        "noise with NaN, infinity or numbers outside its law is refused",
        "torchweather.core.noise",
        "if not (low <= least and most <= high and math.isfinite(least) and math.isfinite(most)):",
        "if False:",
        ("tests/contract/test_noise.py::test_a_number_that_is_none_is_refused",),
    ),
    Mutant(
        "stage_writes_undeclared",
        "an effect changes the fields that it declares and no other",
        "torchweather.lidar.effects.air",
        'writes: ClassVar[tuple[str, ...]] = ("receiver.extra_divergence_rad",)',
        'writes: ClassVar[tuple[str, ...]] = ("returns.signal",)',
        ("tests/contract/test_stage_fields.py::test_a_stage_reads_and_writes_what_it_declares",),
    ),
    Mutant(
        "snow_beyond_its_law",
        "snow of a law that was fitted to 10 mm/h is refused above",
        "torchweather.atmosphere.weather",
        "if above.numel() and self.size_distribution in self.not_beyond_fit and not self.close_rate:",
        "if False:",
        ("tests/atmosphere/test_weather.py::test_snow_beyond_its_law_is_refused_with_the_range",),
    ),
)
