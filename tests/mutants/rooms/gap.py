"""Breaks of the gap search: likelihood, correction, held-out data."""

from __future__ import annotations

from tests.mutants.mutant import Mutant

RESIDUAL = "torchweather.gap.inference.residual_tests"
EFFECT_SETS = "tests/gap/inference/test_effect_sets.py"
SELECTION = "tests/gap/inference/test_forward_selection.py"
RANDOM_EFFECTS = "torchweather.gap.statistics.frame_random_effects"
FORMULA = "torchweather.gap.statistics.formula"
CAMERA_FRAMES = "tests/gap/sensors/camera/test_camera_frames.py"
CLEAR_NOISE = "tests/gap/sensors/camera/test_clear_noise.py"

OF_SCENE = "tests/gap/sensors/lidar/test_lidar_scene.py"
DISTRIBUTION = "tests/gap/inference/test_simulated_distribution.py"
CALIBRATED = "tests/gap/inference/test_calibrated_scatter.py"
RADAR_FRAMES = "tests/gap/sensors/radar/test_radar_frames.py"
LIDAR_SCENE = "torchweather.gap.sensors.lidar.scene"
LIDAR_FRAMES = "tests/gap/sensors/lidar/test_lidar_frames.py"
GLOBAL_TEST = "tests/gap/inference/test_global_test.py"
CANDIDATES = "tests/gap/inference/test_candidate_fits.py"

MUTANTS = (
    Mutant(
        "beams_that_return_are_stable",
        "a beam that returns from several ranges in clear air sees no one surface",
        "torchweather.gap.sensors.lidar.stable_beams",
        "moved = int((always & ~one_range(range_m)).sum())",
        "moved = 0",
        ("tests/gap/test_diagnosis.py::test_a_scene_in_which_few_beams_see_one_surface",),
    ),
    Mutant(
        "chance_counts_as_a_rest",
        "noise leaves no excess beyond chance",
        RESIDUAL,
        "return float(max(over - np.sqrt(uneven / np.pi).sum(), 0.0))",
        "return float(over)",
        (
            (
                "tests/gap/inference/test_residual_tests.py::"
                "test_noise_leaves_no_excess_beyond_chance_and_a_departure_as_much_as_it_is"
            ),
        ),
    ),
    Mutant(
        "what_is_not_simulated_speaks_against_a_name",
        "what an effect does not simulate speaks not against it",
        "torchweather.gap.inference.forward_selection",
        "for one in (left, np.where(not_simulated, 0.0, left))",
        "for one in (left, left)",
        (f"{SELECTION}::test_what_an_effect_does_not_simulate_is_a_rest_and_no_reason_against_it",),
    ),
    Mutant(
        "particles_end_at_the_nearer_rendered_depth",
        "between two rendered depths particles are those of both",
        "torchweather.gap.sensors.camera.particles",
        "_between(log_reach, REACH_STEP),",
        "[(_between(log_reach, REACH_STEP)[0][0], 1.0)],",
        (
            (
                "tests/gap/sensors/camera/test_camera_frames.py::"
                "test_particles_that_end_between_two_rendered_depths_are_those_of_both"
            ),
        ),
    ),
    Mutant(
        "beams_chosen_by_the_noise_of_their_frame",
        "no beam of a bin counts because the frame that a simulated one starts from was read high",
        LIDAR_SCENE,
        "margin_db <= FLICKER_SD * noise_db + beyond",
        "margin_db <= FLICKER_SD * noise_db - 99.0",
        (f"{OF_SCENE}::test_no_beam_of_a_bin_is_chosen_by_the_noise_of_its_own_frame",),
    ),
    Mutant(
        "flicker_in_no_simulated_frame",
        "a surface at the threshold that one clear frame saw is there in frames simulated from it",
        LIDAR_SCENE,
        "empty = (count == 0) & open_beams(",
        "empty = (count == 0) & (count[-1:] == 0) & open_beams(",
        (f"{OF_SCENE}::test_a_surface_that_one_clear_frame_saw_is_something_new_beside_the_others",),
    ),
    Mutant(
        "particles_on_the_clock_of_no_frame",
        "the clock of a frame moves its particles as it does its objects",
        "torchweather.gap.sensors.lidar.frames",
        "FrameClock(late_m=scene.clock_m[row].clamp(-1.0, 1.0))",
        "FrameClock(late_m=0.0 * scene.clock_m[row])",
        ("tests/gap/sensors/lidar/test_lidar_systematics.py::test_the_clock_of_a_frame_moves_its_particles",),
    ),
    Mutant(
        "a_model_known_exactly",
        "the error of a model, alike in all conditions, is no alarm",
        RESIDUAL,
        "level = (self.noise + self.model) * self.used",
        "level = self.noise * self.used",
        ("tests/gap/inference/test_residual_tests.py::test_an_error_of_the_model_in_all_conditions_is_no_alarm",),
    ),
    Mutant(
        "a_model_known_better_in_common",
        "the error of a model is one departure in all conditions",
        RESIDUAL,
        "np.square((np.sqrt(self.model) * self.used).sum(0)) / number",
        "(self.model * self.used).sum(0) / number",
        ("tests/gap/inference/test_residual_tests.py::test_an_error_of_the_model_in_all_conditions_is_no_alarm",),
    ),
    Mutant(
        "noise_of_bins_that_were_empty",
        "bins that only other weather fills have the noise of their own elements",
        "torchweather.gap.inference.simulated_distribution",
        "more = _elements(pools[name], 1) > ",
        "more = _elements(pools[name], 1) < 0.0 * ",
        (f"{DISTRIBUTION}::test_bins_that_other_weather_fills_have_the_noise_of_their_own_elements",),
    ),
    Mutant(
        "frames_alike_by_chance_are_steady",
        "a few frames that are alike by chance make no steady clock",
        RANDOM_EFFECTS,
        "max(excess, well_may_be * noises[name])",
        "excess",
        (
            "tests/gap/statistics/test_frame_random_effects.py::test_two_frames_that_are_alike_by_chance_make_no_steady_clock",
        ),
    ),
    Mutant(
        "responses_never_kept",
        "responses to nuisances are kept beside a weak effect while steps gain what they promise",
        "torchweather.gap.inference.profiled_conditions",
        "if gained < kept_while_gained * promised:",
        "if gained < math.inf:",
        ("tests/gap/inference/test_likelihood.py::test_responses_are_kept_while_steps_gain_what_they_promise",),
    ),
    Mutant(
        "no_intensity_between_places_of_the_grid",
        "the weather's intensity is looked for between the places of a grid before a first step",
        "torchweather.gap.inference.profiled_conditions",
        "for sign in (-1.0, 1.0):",
        "for sign in ():",
        ("tests/gap/inference/test_likelihood.py::test_a_record_that_is_far_off_is_first_looked_for_on_a_grid",),
    ),
    Mutant(
        "half_the_degrees_of_freedom_of_counts",
        "a variance that is known to the relative variance v has 2 / v degrees of freedom",
        "torchweather.gap.inference.calibrated_scatter",
        "degrees_of_freedom[part] = 2.0 * (known + prior)",
        "degrees_of_freedom[part] = 0.5 * (known + prior)",
        (f"{CALIBRATED}::test_a_variance_of_counts_has_the_degrees_of_freedom_that_it_says",),
    ),
    Mutant(
        "scenes_with_one_error_of_their_noise",
        "each scene has clear frames, and so an error of its noise, of its own",
        "torchweather.gap.inference.degrees_of_freedom",
        "numbered[scene] * self.statistics + own for",
        "0 * numbered[scene] + own for",
        ("tests/gap/inference/test_degrees_of_freedom.py::test_scenes_have_clear_frames_of_their_own",),
    ),
    Mutant(
        "groups_with_one_error_of_all_scenes",
        "squares of a statistic know the noise of each scene by itself",
        RESIDUAL,
        "own = scenes == scene",
        "own = scenes >= scene",
        ("tests/gap/inference/test_residual_tests.py::test_each_scene_has_an_error_of_its_noise",),
    ),
    Mutant(
        "noise_of_few_elements_known_exactly",
        "noise that few elements make is no sure measure",
        "torchweather.gap.inference.simulated_distribution",
        "np.where(uneven > 0.0, found, np.inf)",
        "np.where(uneven > 0.0, np.inf, np.inf)",
        (f"{DISTRIBUTION}::test_a_sum_of_variances_has_degrees_of_freedom_as_drawn",),
    ),
    Mutant(
        "few_elements_that_never_differ",
        "means of few elements that only an effect brings are no surer than elements differ",
        "torchweather.gap.inference.calibrated_scatter",
        'by_law.least[part] ** 2 if group.kind == "mean" else 0.0',
        "0.0",
        (f"{CALIBRATED}::test_means_of_few_elements_are_no_surer_than_is_said",),
    ),
    Mutant(
        "forms_taken_as_exact",
        "an added effect must explain more than errors of the form of those found",
        "torchweather.gap.inference.form_error",
        "with_forms = nuisance.beside(np.stack(columns, 1)) if columns else nuisance",
        "with_forms = nuisance",
        (
            (
                "tests/gap/inference/test_form_error.py::"
                "test_another_form_of_the_effect_is_explained_and_what_acts_elsewhere_is_not"
            ),
        ),
    ),
    Mutant(
        "effects_fitted_as_if_their_form_were_exact",
        "an effect beside which another is judged is fitted with the error of its form",
        "torchweather.gap.inference.form_error",
        "wide = min(wide, seen, key=lambda fit: fit.misfit)",
        "pass",
        (
            (
                "tests/gap/inference/test_form_error.py::"
                "test_a_form_that_is_wrong_drags_nothing_where_its_error_is_fitted_beside"
            ),
        ),
    ),
    Mutant(
        "promise_of_one_step",
        "what a fit promises goes as far as the bounds of its parameters",
        "torchweather.gap.inference.likelihood",
        "fit.nuisance, fit.base, math.inf)",
        "fit.nuisance, fit.base)",
        (("tests/gap/inference/test_likelihood.py::test_what_a_fit_promises_is_about_what_it_leaves"),),
    ),
    Mutant(
        "rivals_left_out_by_what_they_leave_before_a_fit",
        "which rivals are fitted beside errors of forms follows from what they would leave behind it",
        "torchweather.gap.inference.forward_selection",
        "if kept and search.promised(seen) >",
        "if kept and seen.misfit >",
        (
            (
                "tests/gap/inference/test_forward_selection.py::"
                "test_what_would_lie_far_behind_is_not_fitted_beside_the_errors_of_forms"
            ),
        ),
    ),
    Mutant(
        "three_effects_named_whatever_they_leave",
        "as many effects as are searched for are no name where more is left than their forms explain",
        "torchweather.gap.inference.forward_selection",
        "if best.held_fit is None or len(best.fit.point.values) < NUMERICS.max_effects:",
        "if True:",
        (
            (
                "tests/gap/inference/test_forward_selection.py::"
                "test_as_many_effects_as_are_searched_for_are_no_answer_where_more_is_left_than_their_forms"
            ),
        ),
    ),
    Mutant(
        "rest_of_three_effects_compared_with_exact_forms",
        "what three effects leave is compared with the errors of their forms",
        "torchweather.gap.inference.forward_selection",
        "seen = held_out(held, beside_form_errors(held, best.held_fit, best.fit.point.values), seed)",
        "seen = held_out(held, best.held_fit, seed)",
        (
            (
                "tests/gap/inference/test_forward_selection.py::"
                "test_as_many_effects_as_are_searched_for_are_no_answer_where_more_is_left_than_their_forms"
            ),
        ),
    ),
    Mutant(
        "fog_stands_as_a_thing_does",
        "what returns from all columns alike is no thing that stands",
        "torchweather.gap.sensors.lidar.standing",
        "number -= torch.quantile(number, BACKGROUND)",
        "number -= 0.0",
        ("tests/gap/sensors/lidar/test_standing.py::test_a_thing_is_found_in_its_columns",),
    ),
    Mutant(
        "surfaces_of_clear_air_stand_anew",
        "what clear frames have does not stand anew",
        "torchweather.gap.sensors.lidar.standing",
        "stands = stays & ~there_before",
        "stands = stays",
        (
            "tests/gap/sensors/lidar/test_standing.py::test_nothing_stands_where_flakes_fall_or_the_clear_frames_have_it",
        ),
    ),
    Mutant(
        "a_part_of_a_wall_as_a_thing",
        "what reaches farther than is looked has no place",
        "torchweather.gap.sensors.lidar.standing",
        "if max(-left, right) > WITHIN_RAD - spacing_rad:",
        "if False:",
        ("tests/gap/sensors/lidar/test_standing.py::test_what_reaches_farther_than_is_looked_has_no_place",),
    ),
    Mutant(
        "things_looked_for_from_the_middle_of_a_cell",
        "a thin thing is looked for from its own column",
        "torchweather.gap.inference.location_search",
        "place = None if standing is None else standing(azimuth_rad, range_m)",
        "place = None",
        ("tests/gap/sensors/lidar/test_standing.py::test_a_thing_is_looked_for_from_where_it_stands_in_the_frames",),
    ),
    Mutant(
        "first_effects_left_where_they_were_fitted_first",
        "first effects that a second one leads to more are fitted before it is judged",
        "torchweather.gap.inference.forward_selection",
        "if best.fit.misfit - alone.misfit > max(threshold, NUMERICS.fitted_better_share * best.fit.misfit):",
        "if False:",
        (
            (
                "tests/gap/inference/test_forward_selection.py::"
                "test_first_effects_that_a_second_leads_to_more_are_fitted_before_it_is_judged"
            ),
        ),
    ),
    Mutant(
        "density_of_few_frames_without_its_curvature",
        "the densities of a few frames move a mean along its curvature as well",
        "torchweather.gap.inference.frame_density",
        "math.sqrt(0.5) * few * (high + low - 2.0 * middle)",
        "0.0 * (high + low - 2.0 * middle)",
        (("tests/gap/inference/test_frame_density.py::test_the_errors_of_a_mean_are_those_of_drawn_densities"),),
    ),
    Mutant(
        "banks_as_noise_of_each_mean",
        "what one density does to all means together is no noise of each",
        "torchweather.gap.inference.frame_density",
        "alone = np.where(layout.averages, least[name], np.where(counts, apart, own))",
        "alone = own",
        ("tests/gap/inference/test_frame_density.py::test_banks_widen_no_mean_and_are_a_nuisance",),
    ),
    Mutant(
        "no_nuisance_for_the_density_of_few_frames",
        "the mean of a few frames of different density is off as a record is",
        "torchweather.gap.inference.profiled_conditions",
        "fixed += [self._column(base, {number: error}) for error in errors]",
        "fixed += []",
        ("tests/gap/inference/test_frame_density.py::test_banks_widen_no_mean_and_are_a_nuisance",),
    ),
    Mutant(
        "differences_of_frames_with_a_normal_tail",
        "a variance over a few frames has the far tail of chi-square",
        "torchweather.gap.inference.calibrated_scatter",
        "far = chi2.isf(METHOD.residual_p, max(number - 1, 1)) / max(number - 1, 1)",
        "far = chi2.isf(0.01, max(number - 1, 1)) / max(number - 1, 1)",
        (
            (
                "tests/gap/inference/test_calibrated_scatter.py::"
                "test_a_difference_between_frames_is_as_unlikely_as_it_is_said"
            ),
        ),
    ),
    Mutant(
        "clear_frames_alike_by_chance_believed",
        "frames differ by the noise of their elements at least, however alike a few clear ones are",
        "torchweather.gap.inference.calibrated_scatter",
        "scatter = max(scatter, _by_elements(group.statistic, pool, number, elements))",
        "scatter = max(scatter, 0.0)",
        (
            (
                "tests/gap/inference/test_calibrated_scatter.py::"
                "test_clear_frames_that_are_alike_by_chance_have_the_noise_of_their_elements"
            ),
        ),
    ),
    Mutant(
        "form_of_the_added_effect_in_error",
        "the form of an added effect is not among those in error",
        "torchweather.gap.inference.forward_selection",
        "others = [name for name in one.fit.point.values if name != one.id]",
        "others = list(one.fit.point.values)",
        (("tests/gap/inference/test_forward_selection.py::test_an_added_effect_must_gain_what_noise_seldom_does"),),
    ),
    Mutant(
        "a_poor_first_fit_is_a_merit_of_the_second",
        "an added effect gains over the others fitted again",
        "torchweather.gap.inference.forward_selection",
        "if earns and alone.misfit - one.fit.misfit >= threshold * min(alone.misfit / best.fit.misfit, 1.0):",
        "if earns:",
        (f"{SELECTION}::test_an_added_effect_must_gain_what_noise_seldom_does",),
    ),
    Mutant(
        "forms_in_error_in_even_polynomials_alone",
        "a form may be in error along an axis in every order",
        "torchweather.gap.inference.form_error",
        "for order in range(min(NUMERICS.form_orders, group.bins)):",
        "for order in range(0, min(NUMERICS.form_orders, group.bins), 2):",
        ("tests/gap/inference/test_form_error.py::test_the_ways_of_a_form_are_those_of_the_page",),
    ),
    Mutant(
        "added_effects_ranked_by_exact_forms",
        "added effects are ranked where the forms of the others may be in error",
        "torchweather.gap.inference.forward_selection",
        "kept.sort(key=lambda one: one.misfit)",
        "kept.sort(key=lambda one: one.fit.misfit)",
        (
            (
                "tests/gap/inference/test_forward_selection.py::"
                "test_added_effects_are_compared_where_the_forms_of_the_others_may_be_in_error"
            ),
        ),
    ),
    Mutant(
        "objects_read_on_the_scale_of_particles",
        "a scale of the readings of particles is one of particles alone",
        "torchweather.gap.sensors.lidar.systematics",
        "int(PointKind.PARTICLE), scaled, signal)}",
        "int(PointKind.PARTICLE), scaled, scaled)}",
        ("tests/gap/sensors/lidar/test_lidar_systematics.py::test_particles_are_read_on_a_scale_of_their_own",),
    ),
    Mutant(
        "power_of_a_target_seen_once",
        "a target that one of two clear frames has tells of losses alone",
        "torchweather.gap.sensors.radar.sums",
        "valued = there & scene.known",
        "valued = there",
        (f"{RADAR_FRAMES}::test_a_target_that_one_clear_frame_has_tells_of_losses_alone",),
    ),
    Mutant(
        "class_says_nothing_of_two_clear_frames",
        "of two clear frames the class of a target says how it scatters",
        "torchweather.gap.sensors.radar.scene",
        "(1.0 - chance) * _median_spread(values, least) ** 2 + chance * FADING_SPREAD_DB**2",
        "_median_spread(values, least) ** 2 + 0.0 * chance",
        (f"{RADAR_FRAMES}::test_a_single_other_frame_tells_no_spread_of_a_target_but_its_class_may",),
    ),
    Mutant(
        "path_loss_taken_for_the_record",
        "a radar's path loss is named beside another effect",
        "torchweather.gap.sensors.radar.frames",
        "self.as_record: AbstractSet[str] = frozenset()",
        'self.as_record: AbstractSet[str] = {"radar.path_loss_scale"}',
        (f"{RADAR_FRAMES}::test_a_path_loss_is_named_beside_another_effect",),
    ),
    Mutant(
        "ghosts_counted_to_a_decibel",
        "which targets have a ghost is known to half of their number",
        "torchweather.gap.sensors.radar.forms",
        'unmodelled: ClassVar[tuple[str, ...]] = ("ghost_count", "clutter_count")',
        "unmodelled: ClassVar[tuple[str, ...]] = ()",
        (f"{RADAR_FRAMES}::test_the_number_of_ghosts_is_known_to_half_of_it",),
    ),
    Mutant(
        "second_paths_of_two_delays",
        "a second path of a radar is looked for in each octave of its delay",
        "torchweather.gap.sensors.radar.forms",
        '{"delay_m": (1.1, 2.3, 4.5, 9.0, 18.0)}',
        '{"delay_m": (5.0, 15.0)}',
        (f"{RADAR_FRAMES}::test_second_paths_are_tried_in_each_octave_of_their_delay",),
    ),
    Mutant(
        "maps_of_fog_known_exactly",
        "particles that a model misplaces move what stays in its place",
        "torchweather.gap.statistics.frame_statistics",
        "math.hypot(SCATTER.persistence_rel_error, misplaced)",
        "SCATTER.persistence_rel_error",
        ("tests/gap/statistics/test_frame_statistics.py::test_misplaced_particles_move_what_stays_in_its_place",),
    ),
    Mutant(
        "means_of_the_few_that_are_left",
        "a mean of the few beams of a bin that weather leaves is none of the bin",
        "torchweather.gap.inference.simulated_distribution",
        "pool.enough(number) & pool.mostly_seen(Pool(model.layout, model.clear(condition.scene)))",
        "pool.enough(number)",
        ("tests/gap/sensors/lidar/test_lidar_frames.py::test_intensities_of_a_bin_that_fog_hides_do_not_count",),
    ),
    Mutant(
        "near_fog_known_to_differ",
        "frames may be alike where the few near particles may lie beyond the edge",
        "torchweather.gap.statistics.frame_statistics",
        "share = min(misplaced * number / max(near, TINY), 1.0) if near > 0 else 0.0",
        "share = 0.0",
        (
            (
                "tests/gap/statistics/test_frame_statistics.py::"
                "test_frames_may_be_alike_where_few_particles_may_lie_beyond_an_edge"
            ),
        ),
    ),
    Mutant(
        "range_noise_of_a_logarithm",
        "the stage that copies a spread of range has it in metres",
        "torchweather.gap.inference.empirical_fit",
        "lambda entry: spread_of_log_square(entry) * clear[:, None]",
        "np.exp",
        ("tests/gap/inference/test_empirical_fit.py::test_noise_of_the_range_comes_back_as_a_stage_in_metres",),
    ),
    Mutant(
        "pairs_scored_without_bounds",
        "nuisances stay within their bounds beside a pair of effects",
        "torchweather.gap.inference.systematics",
        "[limits.high, bounds.high - nuisance.offset]",
        "[limits.high, bounds.high + np.inf]",
        (f"{EFFECT_SETS}::test_a_pair_that_needs_a_record_far_off_stays_behind_within_bounds",),
    ),
    Mutant(
        "pairs_from_where_the_record_was_led_to",
        "pairs of effects are fitted from rest",
        "torchweather.gap.inference.candidate_fits",
        "found.append((ParameterPoint({first.id: _start(first, amplitude)}), second, other))",
        "found.append((replace(base.point, values={first.id: _start(first, amplitude)}), second, other))",
        ("tests/gap/inference/test_forward_selection.py::test_pairs_start_from_rest_whatever_the_record_was_led_to",),
    ),
    Mutant(
        "steps_never_doubled",
        "a step is doubled where the least of the parabola lies beyond it",
        "torchweather.gap.inference.profiled_conditions",
        "cost - best[0] < NUMERICS.doubled_from * (cost - step.misfit)",
        "cost > best[0]",
        (f"{SELECTION}::test_a_step_is_doubled_only_where_the_least_lies_beyond_it",),
    ),
    Mutant(
        "lost_beams_repeat_by_chance",
        "a beam at the threshold that is lost in every frame is one event",
        "torchweather.gap.inference.calibrated_scatter",
        "(self.repeated[part] - 1.0)",
        "0.0",
        (f"{CALIBRATED}::test_a_beam_that_is_lost_in_every_frame_is_one_event_where_others_are",),
    ),
    Mutant(
        "beams_into_dark_sides_are_open",
        "a beam that ends at a dark side is not compared with flakes behind it",
        "torchweather.gap.sensors.lidar.open_beams",
        "torch.from_numpy(ends.end == BeamEnd.SKY)",
        "torch.from_numpy(ends.end != BeamEnd.GROUND)",
        ("tests/gap/sensors/lidar/test_open_beams.py::test_a_side_that_gives_no_return_ends_its_beams",),
    ),
    Mutant(
        "spread_of_intensities_by_squares",
        "one reading far out hardly widens the spread of intensities",
        "torchweather.gap.sensors.lidar.sums",
        "torch.log1p(away.square(), out=at[name])",
        "torch.square(away, out=at[name])",
        (
            (
                "tests/gap/sensors/lidar/test_lidar_frames.py::"
                "test_a_flake_right_before_a_surface_hardly_widens_the_spread_of_intensities"
            ),
        ),
    ),
    Mutant(
        "middle_of_intensities_by_the_mean",
        "one reading far out hardly moves the middle about which intensities spread",
        "torchweather.gap.sensors.lidar.sums",
        "return middle + mean((ratio - middle).clamp(-farthest, farthest))",
        "return middle",
        (
            (
                "tests/gap/sensors/lidar/test_lidar_frames.py::"
                "test_a_flake_right_before_a_surface_hardly_widens_the_spread_of_intensities"
            ),
        ),
    ),
    Mutant(
        "spread_of_log_squares_kept_with_the_means",
        "what means along other axes add to a spread that is a mean logarithm of squares is taken off in its unit",
        "torchweather.gap.inference.unknown",
        "return entry - mean_log_square(less * spread / unit)",
        "return entry - mean_log_square(less * spread)",
        ("tests/gap/test_gap_report.py::test_a_spread_that_a_ripple_makes_is_not_what_is_unknown",),
    ),
    Mutant(
        "compiled_sums_of_no_squares",
        "compiled sums of a LiDAR frame hold the squares of the range's residuals",
        "torchweather.gap.sensors.lidar.compiled_sums",
        "cells[cell, 7] += apart * apart",
        "cells[cell, 7] += apart",
        ("tests/gap/sensors/lidar/test_lidar_frames.py::test_compiled_sums_are_those_of_torch",),
    ),
    Mutant(
        "cells_lie_in_one_bin",
        "a beam counts in its bin of every axis",
        "torchweather.gap.sensors.lidar.compiled_sums",
        "for axis in range(bins.shape[0]):",
        "for axis in range(1):",
        ("tests/gap/sensors/lidar/test_lidar_frames.py::test_compiled_sums_are_those_of_torch",),
    ),
    Mutant(
        "compiled_particles_without_clusters",
        "compiled sums of a LiDAR frame count particles with a neighbour",
        "torchweather.gap.sensors.lidar.compiled_sums",
        "if _has_neighbour(range_m, beam, bins):",
        "if bins.columns < 0:",
        ("tests/gap/sensors/lidar/test_lidar_frames.py::test_compiled_sums_are_those_of_torch",),
    ),
    Mutant(
        "kept_frames_without_what_is_open",
        "frames that are kept are told apart by what the model leaves open",
        "torchweather.gap.inference.simulated_conditions",
        "(values, log_intensity, strengths, alike)",
        "(values, log_intensity, alike)",
        ("tests/gap/inference/test_likelihood.py::test_a_point_that_was_simulated_is_not_simulated_again",),
    ),
    Mutant(
        "ignored_parts_are_one_block",
        "a part that is ignored is the whole window of the check",
        "torchweather.gap.sensors.camera.scene_change",
        "masks[scene_id][row : row + SIDE_PX, column : column + SIDE_PX] = 1",
        "masks[scene_id][row : row + 1, column + SIDE_PX :] = 1",
        ("tests/gap/sensors/camera/test_camera_frames.py::test_the_names_in_the_error_answer_it",),
    ),
    Mutant(
        "mask_hides_nothing",
        "what a scene's mask leaves out is no change of the scene",
        "torchweather.gap.sensors.camera.scene_change",
        "if left_out is not None:",
        "if left_out is None and not scene:",
        (f"{CAMERA_FRAMES}::test_the_parts_that_changed_are_named_and_a_mask_answers_them",),
    ),
    Mutant(
        "named_effects_of_snow_not_searched",
        "an effect outside of the catalogue is searched for where it is named",
        "torchweather.gap.inference.effect_forms",
        "(effect.searched or name in named)",
        "effect.searched",
        (
            (
                "tests/gap/sensors/camera/test_camera_frames.py::test_water_and_snow_are_searched_for_where_they_are_"
                "named"
            ),
        ),
    ),
    Mutant(
        "the_whole_of_a_share_called_an_end",
        "a value that nothing exceeds is no end of the search",
        "torchweather.gap.gap_report",
        'if declared.unit != "1" or declared.high != 1:',
        "if declared.high != 0:",
        ("tests/gap/test_gap_report.py::test_an_end_that_nothing_exceeds_is_no_end_of_the_search",),
    ),
    Mutant(
        "partners_of_a_bound_as_sure_as_before",
        "a value on its bound lowers the confidence of the effects beside it",
        "torchweather.gap.gap_report",
        'RIGHT["named_and_rest"] / RIGHT[verdict]',
        "1.0",
        ("tests/gap/test_gap_report.py::test_a_value_on_its_bound_lowers_the_confidence_of_its_partner",),
    ),
    Mutant(
        "nepers_called_decibels",
        "a logarithm of an intensity is 4.34 dB",
        "torchweather.gap.natural_units",
        "DB_PER_NEPER = 10.0 / math.log(10.0)",
        "DB_PER_NEPER = 1.0",
        ("tests/gap/test_gap_report.py::test_a_curve_has_its_own_unit_beside_standard_deviations",),
    ),
    Mutant(
        "places_known_by_all_simulated_frames",
        "simulated frames know no more of a place than the clear frames that they start from",
        "torchweather.gap.places",
        "known_by = min(SIMULATED, clear)",
        "known_by = SIMULATED",
        ("tests/gap/test_places.py::test_chance_is_that_of_few_frames",),
    ),
    Mutant(
        "multiple_comparisons_not_corrected",
        "the least of many p-values is multiplied by their number",
        RESIDUAL,
        "return float(min(1.0, some.sum() * each.min()))",
        "return float(min(1.0, each.min()))",
        ("tests/gap/inference/test_residual_tests.py::test_what_conditions_have_in_common_is_not_drowned_in_each",),
    ),
    Mutant(
        "residuals_shared_by_conditions_not_scaled",
        "a pattern common to n conditions is their sum over the root of n",
        RESIDUAL,
        "/ np.sqrt(number)",
        "/ number",
        ("tests/gap/inference/test_residual_tests.py::test_what_conditions_have_in_common_is_not_drowned_in_each",),
    ),
    Mutant(
        "noise_of_held_out_data_is_a_rest",
        "a held-out gap that noise may well leave is none",
        "torchweather.gap.inference.forward_selection",
        "after.gap > METHOD.residual_gap * after.floor and after.p_value < METHOD.left_by_noise",
        "after.gap > METHOD.residual_gap * after.floor",
        (f"{SELECTION}::test_a_held_out_gap_that_noise_may_well_leave_is_none",),
    ),
    Mutant(
        "held_out_data_are_noise",
        "held-out conditions say how likely noise leaves as much",
        "torchweather.gap.inference.held_out",
        "p_value = min(test.p_value(apart), test.common_p_value(apart))",
        "p_value = 1.0",
        (f"{SELECTION}::test_held_out_conditions_say_how_likely_noise_leaves_as_much",),
    ),
    Mutant(
        "much_left_of_held_out_data_is_a_rest",
        "what leaves a fifth of the held-out square is not what is missing",
        "torchweather.gap.inference.forward_selection",
        "or far or (rest and over > METHOD.unexplained_share):",
        "or far:",
        (
            (
                "tests/gap/inference/test_forward_selection.py::"
                "test_effects_that_leave_held_out_conditions_far_off_are_not_what_is_missing"
            ),
        ),
    ),
    Mutant(
        "t_interval_taken_as_normal",
        "few degrees of freedom widen the noise of whole frames",
        RANDOM_EFFECTS,
        "/ stats.norm.isf(tail)) ** 2",
        "/ stats.norm.isf(tail)) ** 0",
        (
            (
                "tests/gap/statistics/test_frame_random_effects.py::"
                "test_a_scatter_known_from_few_frames_is_widened_as_student_has_it"
            ),
        ),
    ),
    Mutant(
        "sampling_noise_counted_as_frame_noise",
        "noise of whole frames is what exceeds the sampling noise",
        RANDOM_EFFECTS,
        "excess = float((even**2).sum()) - (number - 1) * variance",
        "excess = float((even**2).sum())",
        (
            (
                "tests/gap/statistics/test_frame_random_effects.py::"
                "test_the_noise_of_elements_is_nothing_that_whole_frames_do"
            ),
        ),
    ),
    Mutant(
        "visibility_taken_as_severity",
        "shorter visibility is more severe",
        "torchweather.gap.study.splits",
        'return 1.0 / intensity if weather.intensity_name == "mor_m" else intensity',
        "return intensity",
        (
            (
                "tests/gap/study/test_study.py::"
                "test_each_kind_of_weather_keeps_a_condition_to_fit_to_and_clear_air_is_fitted"
            ),
        ),
    ),
    Mutant(
        "p_value_of_clear_air_can_be_zero",
        "a permutation p-value counts the observed split",
        "torchweather.gap.inference.clear_air",
        "p_value = (1 + int(",
        "p_value = (0 + int(",
        ("tests/gap/inference/test_clear_air.py::test_frames_that_are_copies_do_not_differ",),
    ),
    Mutant(
        "formula_without_penalty",
        "a criterion charges each free parameter ln n",
        FORMULA,
        "chi2 + free * math.log(n) + 2.0 * math.log(form.choices)",
        "chi2",
        ("tests/gap/statistics/test_formula.py::test_noise_is_a_constant",),
    ),
    Mutant(
        "formula_at_bin_centres",
        "a formula is averaged over each bin",
        FORMULA,
        "share = (np.arange(NUMERICS.formula_points) + 0.5) / NUMERICS.formula_points",
        "share = 0.0 * (np.arange(NUMERICS.formula_points) + 0.5) / NUMERICS.formula_points",
        ("tests/gap/statistics/test_formula.py::test_bins_that_are_not_known_count_for_nothing",),
    ),
    Mutant(
        "held_out_links_fitted",
        "held-out links are not fitted to",
        "torchweather.gap.sensors.link.frames",
        "splits = {FIT: ~held, HOLDOUT: held}",
        "splits = {FIT: held, HOLDOUT: ~held}",
        ("tests/gap/sensors/link/test_link.py::test_links_that_are_held_out_are_not_fitted_to",),
    ),
    Mutant(
        "byte_order_in_the_hash",
        "the hash of a frame does not depend on the machine's byte order",
        "torchweather.gap.study.content_hash",
        'little = array.astype(array.dtype.newbyteorder("<"), copy=False)',
        "little = array",
        ("tests/gap/study/test_content_hash.py::test_byte_order_and_layout_in_memory_do_not_change_the_hash",),
    ),
    Mutant(
        "likelihood_without_variance_term",
        "a likelihood charges wider scatter by its logarithm",
        "torchweather.gap.inference.profiled_conditions",
        "total += 2.0 * float(np.log(wider[used]).sum())",
        "total += 0.0 * float(np.log(wider[used]).sum())",
        (
            (
                "tests/gap/inference/test_likelihood_variance.py::"
                "test_twice_the_scatter_costs_two_ln_two_an_entry_that_counts"
            ),
        ),
    ),
    Mutant(
        "frames_of_any_size_accepted",
        "the frames of a scene have the sizes of its geometry, the beams or the links",
        "torchweather.gap.study.checks",
        "return self if self.sizes else replace(self, sizes=sizes, sizes_from=name)",
        "return self",
        ("tests/gap/study/test_study.py::test_wrong_arrays_are_refused_with_name_unit_and_advice",),
    ),
    Mutant(
        "bounds_of_arrays_not_checked_above",
        "values of an array lie between the bounds of its rule",
        "torchweather.gap.study.checks",
        " & (values <= self.high)",
        "",
        ("tests/gap/study/test_study.py::test_wrong_arrays_are_refused_with_name_unit_and_advice",),
    ),
    Mutant(
        "links_split_by_condition",
        "every condition of links is fitted and held out, link by link",
        "torchweather.gap.study.study",
        'if "split" in self.links or one.split == split)',
        "if one.split == split)",
        ("tests/gap/study/test_study.py::test_fit_and_holdout_are_the_conditions_by_split",),
    ),
    Mutant(
        "clear_frames_known_without_error",
        "the error of a few clear frames is in the scatter",
        "torchweather.gap.inference.calibrated_scatter",
        "of_clear[part] = noise * told_by_clear[part] * passed[part] * number / clear",
        "of_clear[part] = 0.0 * noise",
        ("tests/gap/test_null_calibration.py::test_a_perfect_model_departs_by_what_is_stated",),
    ),
    Mutant(
        "an_event_counts_along_every_axis",
        "one event at an unseen place is one, along however many axes it is counted",
        "torchweather.gap.inference.events_along_axes",
        "found: Floats = seen * np.outer(known, known) + self.correlation * np.outer(unknown, unknown)",
        "found: Floats = seen * np.outer(known, known) + np.diag(unknown**2)",
        ("tests/gap/inference/test_events_along_axes.py::test_one_event_at_an_unseen_place_departs_once",),
    ),
    Mutant(
        "every_rare_event_is_two_sigma",
        "one event more counts by the deviance that it has",
        "torchweather.gap.inference.calibrated_scatter",
        "allowed = np.minimum(one_event_sd(expected) / np.sqrt(narrower), SCATTER.one_event_sd)",
        "allowed = np.full_like(expected, SCATTER.one_event_sd)",
        ("tests/gap/inference/test_calibrated_scatter.py::test_no_rare_count_departs_by_more_than_its_deviance",),
    ),
    Mutant(
        "nulls_keep_the_places_of_the_measurement",
        "a null is tried at the place where it departs most, as the measurement is",
        "torchweather.gap.inference.global_test",
        "best = np.stack([generator.permutation(one_place) for _ in range(places)]).max(0)",
        "best = one_place",
        ("tests/gap/inference/test_global_test.py::test_a_null_is_tried_at_the_best_of_its_places",),
    ),
    Mutant(
        "nulls_of_counts_are_normal",
        "the own noise of nulls is that of simulated frames",
        "torchweather.gap.inference.simulated_conditions",
        "elements = self.model.layout.by_elements",
        "elements = np.ones(self.model.layout.size, dtype=bool)",
        ("tests/gap/inference/test_likelihood.py::test_null_residuals_of_counts_go_together",),
    ),
    Mutant(
        "scatter_of_few_frames_taken_as_known",
        "squares over a scatter that few frames tell follow F",
        RESIDUAL,
        "known = unsure * SCATTER.known_degrees <= level",
        "known = unsure <= level",
        ("tests/gap/inference/test_residual_tests.py::test_a_scatter_that_few_frames_tell_is_no_sure_measure",),
    ),
    Mutant(
        "first_event_counts_as_normal_noise",
        "one event where hardly any is expected makes a square far above its mean",
        RESIDUAL,
        "0.5 * self.noise * rare * self.event",
        "0.0 * self.noise * rare * self.event",
        ("tests/gap/inference/test_residual_tests.py::test_first_events_are_no_miracle",),
    ),
    Mutant(
        "gain_taken_as_of_known_noise",
        "a gain over noise that few frames tell follows Student's law",
        "torchweather.gap.inference.degrees_of_freedom",
        "_scale(nu) * nu * np.log1p(np.asarray(square) / nu)",
        "_scale(nu) * np.asarray(square)",
        ("tests/gap/inference/test_degrees_of_freedom.py::test_a_square_is_as_unlikely_as_that_of_a_normal_number",),
    ),
    Mutant(
        "spread_by_few_clear_frames_alone",
        "the noise of elements tells of a spread what few clear frames do not",
        "torchweather.gap.inference.calibrated_scatter",
        "prior = np.where(law > TINY**2, of_spread.degrees_of_freedom, 0.0)",
        "prior = np.where(law > TINY**2, 0.0, 0.0)",
        ("tests/gap/inference/test_calibrated_scatter.py::test_few_clear_frames_do_not_make_a_spread_sure",),
    ),
    Mutant(
        "elements_believed_of_every_spread",
        "the noise of elements is believed as far as single bins keep to it",
        "torchweather.gap.inference.calibrated_scatter",
        "min(2.0 / max(beyond, 2.0 / most), most)",
        "most",
        ("tests/gap/inference/test_calibrated_scatter.py::test_elements_that_say_little_of_a_spread_are_not_believed",),
    ),
    Mutant(
        "every_empty_bin_may_hold_half_an_event",
        "what is still to come in empty bins is as much as was seen once",
        "torchweather.gap.statistics.counting",
        "return min((once + SCATTER.jeffreys_events) / max(never, 1), SCATTER.jeffreys_events)",
        "return SCATTER.jeffreys_events",
        (
            "tests/gap/statistics/test_counting.py::test_what_is_still_to_come_in_empty_bins_is_as_much_as_was_seen_once",
        ),
    ),
    Mutant(
        "as_many_portions_whatever_the_clear_frames",
        "the fewer clear frames, the more portions: correlations of many entries need a thousand of them",
        "torchweather.gap.inference.simulated_conditions",
        "max(NUMERICS.portioned_frames / max(clear, 1), 1.0)",
        "1.0",
        ("tests/gap/inference/test_likelihood.py::test_few_clear_frames_have_more_portions",),
    ),
    Mutant(
        "bins_without_events_count_as_noise",
        "a statistic has as many entries as hold its noise",
        RESIDUAL,
        "entries = level**2 / uneven",
        "entries = 4.0 * level**2 / uneven",
        ("tests/gap/inference/test_residual_tests.py::test_bins_without_events_make_no_statistic_of_many_entries",),
    ),
    Mutant(
        "frames_scatter_by_twice",
        "no scatter is made larger for safety",
        "torchweather.gap.inference.calibrated_scatter",
        "own[part] = np.maximum(noise, components.within[part])",
        "own[part] = 2.0 * np.maximum(noise, components.within[part])",
        ("tests/gap/test_null_calibration.py::test_a_perfect_model_departs_by_what_is_stated",),
    ),
    Mutant(
        "the_first_side_that_helps_is_taken",
        "a sector is moved to the better of both sides",
        "torchweather.gap.inference.location_search",
        "found, tried = min(((cost(one), one) for one in map(moved, ways)), key=lambda one: one[0])",
        "found, tried = next((c for c in ((cost(a), a) for a in map(moved, ways)) if c[0] < best), (best, point))",
        ("tests/gap/inference/test_likelihood.py::test_a_thing_is_found_on_the_better_side",),
    ),
    Mutant(
        "a_side_that_does_nothing_is_a_mirror",
        "a weak response is the other side's with its sign turned, where both sides do something",
        "torchweather.gap.inference.global_test",
        "if {id(grid), id(grid.mirror)} <= active and not grid.curved and",
        "if {id(grid)} <= active and not grid.curved and",
        (f"{GLOBAL_TEST}::test_a_side_that_does_nothing_is_no_mirror",),
    ),
    Mutant(
        "mirrored_responses_keep_their_sign",
        "a departure to the other side does the opposite",
        "torchweather.gap.inference.global_test",
        "response = -known[id(grid.mirror), place]",
        "response = known[id(grid.mirror), place]",
        (f"{GLOBAL_TEST}::test_first_responses_of_mirrored_and_idle_effects_need_no_frames",),
    ),
    Mutant(
        "fits_have_the_scatter_without_the_effect",
        "the first events of an effect are no miracles where it is fitted",
        "torchweather.gap.inference.candidate_fits",
        "fits.append(search.fit(start, nuisance, begun.base, NUMERICS.first_fit_steps))",
        "fits.append(search.fit(start, nuisance, base.base, NUMERICS.first_fit_steps))",
        (f"{CANDIDATES}::test_a_fit_has_the_scatter_of_its_start",),
    ),
    Mutant(
        "fits_begin_at_a_share_of_many_events",
        "a fit begins at a weaker point where a share of a strong response is too much",
        "torchweather.gap.inference.candidate_fits",
        "if amplitude < NUMERICS.threshold_amplitude and not grid.effect.cuts:",
        "if False:",
        (f"{CANDIDATES}::test_a_fit_begins_at_a_weaker_point_where_the_share_of_a_strong_response_is_too_much",),
    ),
    Mutant(
        "losses_are_averaged_over_beams",
        "the scatter of repeated losses goes with the repeats of a loss, not of a beam",
        "torchweather.gap.sensors.lidar.sums",
        "times.square().sum(1) / times.sum(1).clamp_min(1)",
        "times.sum(1) / (times > 0).sum(1).clamp_min(1)",
        (f"{LIDAR_FRAMES}::test_repeated_losses_are_those_of_a_plain_loop",),
    ),
    Mutant(
        "a_fit_may_end_worse_than_it_began",
        "no fit ends worse than it began",
        "torchweather.gap.inference.likelihood",
        "        if point == start:",
        "        if True:",
        ("tests/gap/inference/test_likelihood.py::test_no_fit_ends_worse_than_it_began",),
    ),
    Mutant(
        "draws_follow_the_thread_that_is_done_first",
        "the same seed gives the same search however conditions are scheduled",
        "torchweather.gap.inference.simulated_conditions",
        "return {name: found[name] for name in self._names}",
        "return found",
        ("tests/gap/inference/test_likelihood.py::test_the_order_in_which_conditions_are_done_changes_nothing",),
    ),
    Mutant(
        "priors_of_what_does_not_move_forgotten",
        "without the nuisances that do not move a step leaves the same misfit",
        "torchweather.gap.inference.systematics",
        "stay[:, -1] = -prior @ nuisance.offset[moving:]",
        "stay[:, -1] = 0.0",
        (("tests/gap/inference/test_systematics.py::test_without_nuisances_that_do_not_move_a_step_leaves_the_same"),),
    ),
    Mutant(
        "from_rest_with_nuisances_far_off",
        "where what is open has gone far, effects are compared with it near",
        "torchweather.gap.inference.candidate_fits",
        "low[opened], high[opened] = np.clip(low[opened], -far, far), np.clip(high[opened], -far, far)",
        "pass",
        (
            (
                "tests/gap/inference/test_candidate_fits.py::"
                "test_from_rest_nothing_stands_farther_than_it_may_and_by_no_more_than_two_of_its_units"
            ),
        ),
    ),
    Mutant(
        "simulated_readings_not_rounded",
        "a sensor rounds its readings once, after the weather",
        "torchweather.gap.sensors.lidar.frames",
        "return range_m, in_steps(intensity * scene.gain[row, None], scene.step)",
        "return range_m, intensity * scene.gain[row, None]",
        (("tests/gap/sensors/lidar/test_reading_steps.py::test_simulated_frames_have_the_steps_of_the_clear_ones"),),
    ),
    Mutant(
        "readings_within_steps_below_the_threshold",
        "what was detected lies above the threshold, also within its step",
        "torchweather.gap.sensors.lidar.reading_steps",
        "torch.maximum(first, (least.double() / step).clamp_max(1e9) / scale)",
        "first",
        ("tests/gap/sensors/lidar/test_reading_steps.py::test_what_was_detected_lies_above_the_threshold",),
    ),
    Mutant(
        "alternating_readings_lie_anywhere",
        "a level whose readings alternate lies near the edge of its step",
        "torchweather.gap.sensors.lidar.reading_steps",
        "fits += torch.where(seen[row], chance.clamp_min(1e-12).log(), 0.0)",
        "fits += 0.0",
        (("tests/gap/sensors/lidar/test_reading_steps.py::test_frames_put_back_are_as_they_may_have_been"),),
    ),
    Mutant(
        "scales_of_frames_lost_in_steps",
        "readings put back within their steps keep the scale of their frame",
        "torchweather.gap.sensors.lidar.reading_steps",
        "scale = _scales(place + 0.5, seen)[:, None]",
        "scale = torch.ones(len(place), 1)",
        ("tests/gap/sensors/lidar/test_reading_steps.py::test_the_scale_of_a_frame_is_kept",),
    ),
    Mutant(
        "what_steps_leave_open_forgotten",
        "where a reading lies within its step is one error of all conditions of a scene",
        "torchweather.gap.sensors.lidar.frames",
        "found[part] = (variance.sqrt() / number.clamp_min(1)).numpy()",
        "found[part] = 0.0",
        (
            (
                "tests/gap/sensors/lidar/test_reading_steps.py::"
                "test_what_steps_leave_open_is_an_error_of_mean_intensities"
            ),
        ),
    ),
    Mutant(
        "what_is_left_open_lost_in_the_scatter",
        "what clear frames leave open is in the scatter, once for a scene",
        "torchweather.gap.inference.calibrated_scatter",
        "clear=self.clear + more,",
        "clear=self.clear,",
        (
            (
                "tests/gap/inference/test_calibrated_scatter.py::"
                "test_what_clear_frames_leave_open_is_known_and_one_error_of_a_scene"
            ),
        ),
    ),
    Mutant(
        "recorded_frames_on_both_sides",
        "a recorded frame stands for clear air or is put into weather, never both",
        "torchweather.gap.study.hidden_sweeps",
        "return every[0::2], levels[1::2], step",
        "return every[0::2], levels[0::2], step",
        (("tests/gap/study/test_hidden_sweeps.py::test_frames_that_stand_for_clear_air_are_put_into_no_weather"),),
    ),
    Mutant(
        "noise_of_differences_taken_for_that_of_frames",
        "the mean difference of two normal numbers is 2 / sqrt(pi) of their standard deviation",
        "torchweather.gap.study.hidden_sweeps",
        "one_sd = 0.5 * math.sqrt(math.pi)",
        "one_sd = 1.0",
        (("tests/gap/study/test_hidden_sweeps.py::test_the_noise_of_consecutive_frames_is_measured_also_in_steps"),),
    ),
    Mutant(
        "nuisances_fitted_anew_beside_two_of_an_alarm",
        "beside all candidates of an alarm the nuisances are fitted anew",
        "torchweather.gap.inference.forward_selection",
        """        progress,
        number,
    )""",
        """        progress,
    )""",
        (f"{SELECTION}::test_beside_all_candidates_of_an_alarm_the_nuisances_are_fitted_anew",),
    ),
    Mutant(
        "clear_frames_noise_whole_in_fog",
        "fog lets through of the clear frames' noise what it lets through of the scene",
        "torchweather.gap.sensors.camera.clear_noise",
        "passed[part] = np.where(some, of_mean / np.where(some, of_frame, 1.0), 1.0)",
        "passed[part] = 1.0",
        (f"{CLEAR_NOISE}::test_fog_lets_the_clear_frames_noise_through_as_it_does_the_scene",),
    ),
    Mutant(
        "simulated_noise_as_in_clear_air",
        "a simulated frame's noise is compared with the mean of the others, of which fog leaves a part",
        "torchweather.gap.sensors.camera.clear_noise",
        '"log": (added * clear - seen + level)',
        '"log": (0.0 * added + clear)',
        (f"{CLEAR_NOISE}::test_own_noise_over_that_of_simulated_frames_is_as_drawn",),
    ),
    Mutant(
        "whitened_as_few_portions_tell",
        "entries that were made independent scatter as the folds of the portions show",
        "torchweather.gap.inference.simulated_distribution",
        "return cls(factor * np.sqrt(left))",
        "return cls(factor)",
        (
            (
                "tests/gap/inference/test_simulated_distribution.py::"
                "test_of_correlations_that_few_portions_tell_each_group_is_left_one"
            ),
        ),
    ),
    Mutant(
        "elements_as_a_sample_of_others",
        "folds are made of portions and frames together: the same elements are measured again",
        "torchweather.gap.inference.simulated_distribution",
        "len(apart) if clear >= len(apart) else 1",
        "1",
        (
            (
                "tests/gap/inference/test_simulated_distribution.py::"
                "test_elements_that_are_measured_again_are_no_sample_of_others"
            ),
        ),
    ),
    Mutant(
        "ghost_of_any_target_near",
        "a ghost is compared with the target that is nearest in direction and speed",
        "torchweather.gap.sensors.radar.sums",
        "np.lexsort((target[near], off[near], further[near]))",
        "np.lexsort((target[near], further[near]))",
        (
            (
                "tests/gap/sensors/radar/test_radar_frames.py::"
                "test_a_ghost_is_held_against_the_nearest_target_in_direction_and_speed"
            ),
        ),
    ),
    Mutant(
        "effects_that_do_nothing_named",
        "an effect that was led to its identity is none",
        "torchweather.gap.inference.forward_selection",
        "if nothing or found.misfit",
        "if found.misfit",
        (f"{SELECTION}::test_an_effect_that_was_led_to_where_it_does_nothing_goes",),
    ),
    Mutant(
        "repaired_conditions_called_unknown",
        "what leaves a tenth of the held-out excess is a name with a rest",
        "torchweather.gap.inference.forward_selection",
        "share = 0.0  # a rest",
        "share = share  # a rest",
        (f"{SELECTION}::test_what_repairs_held_out_conditions_is_a_name_of_another_form",),
    ),
    Mutant(
        "things_placed_by_bins_alone",
        "the map of returns tells where in a bin of azimuth a thing stands",
        "torchweather.gap.inference.location_search",
        "return misfit + _misfit_of_maps(search, tried, seen)",
        "return misfit",
        ("tests/gap/inference/test_likelihood.py::test_a_narrow_thing_is_found_within_a_bin_of_azimuth",),
    ),
    Mutant(
        "things_moved_within_their_bin",
        "steps of a fit leave the azimuth of a thing where the map has it",
        "torchweather.gap.inference.likelihood",
        "farthest = np.where(stays, 0.0, sizes",
        "farthest = np.where(stays, sizes, sizes",
        ("tests/gap/inference/test_likelihood.py::test_steps_of_a_fit_leave_a_thing_where_the_map_has_it",),
    ),
)
