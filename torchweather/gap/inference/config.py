"""Numbers of the method that finds missing effects: thresholds, sizes of simulated samples, steps."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["METHOD", "InferenceConfig"]


@dataclass(frozen=True)
class InferenceConfig:
    """Numbers of the method, each with its unit and what it bounds.

    Where no other source is named, a number was set on development studies of the bench (``benchmarks/gap_bench``);
    no sealed study took part. Bins and units of a sensor's statistics stand beside them, in ``gap/sensors``.
    """

    # ---- Global test ----
    null_draws: int = 1000  # draws of the null distribution of the largest delta chi-square
    departures: int = 4  # patterns that are looked at; the chance of an alarm is that of any of them
    places_looked_at: int = 2  # in azimuth, where the measurement departs most, for effects with a place
    refined_share: float = 0.25  # of the largest delta chi-square, from which a whole response curve is simulated

    # ---- Forward selection ----
    alarm_p: float = 2e-4  # p value of the global test below which something is missing
    # The same where nothing explains the alarm on held-out conditions. A pattern that all conditions share needs only
    # alarm_p: a few counts do not make one by chance.
    sure_alarm_p: float = 1e-6
    max_effects: int = 3  # named at most
    min_entries: int = 30  # statistics that count, over all conditions
    residual_p: float = 1e-4  # p value of one statistic below which its residual is no noise
    residual_gap: float = 1.5  # held-out gap over its floor above which something else is missing
    # Of the square of the held-out gap over its floor, left, above which the selection counts as nothing found.
    # On development studies effects of the catalogue, also of another form, left at most 0.16 of it; of others two
    # wrong names left 0.197, those with a rest 0.24 and more.
    unexplained_share: float = 0.18
    # Of the held-out excess, that is left by effects whose form alone may differ. On development studies the glow of
    # fog, of another form than the stage's, left 0.07; what the catalogue does not have left 0.13 or more.
    repaired_share: float = 0.1
    least_excess: float = 1.1  # floors, from which a held-out gap is more than the noise of that score
    # Of what an added effect gains, that must lie where those found do nothing: of one that patches another form of the
    # first effect, little does.
    fresh_share: float = 0.25
    unexplained_gap: float = 10.0  # held-out gap over its floor above which the selection counts as nothing found

    # ---- Fits of candidates ----
    # Pairs of effects that are scored within the bounds of the nuisances, the best ones without them; and fitted.
    pairs_screened: int = 60
    pairs_refitted: int = 4
    left_by_noise: float = 0.1  # probability of a misfit as large, from which one effect leaves a pair nothing
    reweightings: int = 3  # fits that are repeated with the scatter at their own result
    refit_share: float = 0.5  # of the largest delta chi-square, from which a candidate is fitted
    threshold_amplitude: float = 0.3  # of a response below which an effect with a threshold stays below it
    least_amplitude: float = 0.02  # of a response, at which a fit starts
    parameter_penalty: float = 5.0  # chi-square that one more parameter must gain: 97 % of one degree of freedom

    # ---- Likelihood: simulated frames, derivatives, fit of the nuisances ----
    pool_frames: int = 48  # of each condition, for the scatter
    screen_frames: int = 6  # of each condition, for a response or a derivative; the first of the pool
    probe_frames: int = 16  # of each condition, for a cost
    probe_draws: int = 32  # of the vector of statistics, for a cost
    kept_frames: int = 8192  # reduced, of all points; some 10 kB each
    intensity_grid_sd: tuple[float, ...] = (-2.0, -1.0, 0.0, 1.0, 2.0)  # starts of intensities, in their recorded sd
    intensity_halvings_sd: tuple[float, ...] = (0.5, 0.25, 0.125)  # to either side of the best of these
    systematic_step_sd: float = 2.0  # of a derivative by a systematic: a smaller step changes too few particles
    angle_step_rad: float = 0.025  # least step of a derivative by an angle: about one column
    derivative_step: float = 0.05  # over the typical size of a parameter
    # Decrease behind a step over the one that a linear simulator promises, from which the step is doubled: the least of
    # a parabola is then a quarter beyond it, 1 / (2 - 1.2).
    doubled_from: float = 1.2
    max_iterations: int = 10  # Gauss-Newton steps of a fit
    nuisance_rounds: int = 10  # Gauss-Newton steps of the nuisances alone
    # Of the decrease that responses to nuisances promise beside a weak effect, up to which they are kept.
    kept_while_gained: float = 0.5
    converged_chi2: float = 3.0  # gain below which one more of those steps is not worth its frames
    unmodelled_share: float = 0.5  # scatter of a statistic that no parameter gives, over its change by the effect
    nuisance_bound_sd: float = 4.0  # standard deviations by which a nuisance may move

    # ---- Distribution of the statistics of simulated frames ----
    distribution_draws: int = 256  # of the vector of statistics from the pool
    # Into which the elements of a frame are divided. Correlations come from as many portions as there are of all frames
    # that start from different clear ones: 1,024. With 384 of them, from three clear frames, what they make independent
    # had 1.1 to 1.5 of its variance.
    portions: int = 128
    portioned_frames: int = 8  # of each condition
    frames_for_spread: int = 3  # least number; two frames differ alike in either order, which has no scatter
    shrinkage: float = 0.1  # of correlations towards zero
    whitening_folds: int = 10  # of the portions, of which each is whitened with the others' correlations

    # ---- Response templates and starts of fits ----
    template_amplitudes: tuple[float, float] = (0.0, 1.35)  # between which a response is scaled
    start_steps: tuple[float, ...] = (0.03, 0.25, 1.0, 3.0)  # strengths over the typical size of a parameter
    # The same for effects that act within their parameter: a wide step would pass over them.
    start_steps_of_cuts: tuple[float, ...] = tuple(0.15 * 1.2**step for step in range(16))
    start_steps_far: tuple[float, ...] = (4.0, 2.0, 1.0, 0.5, 0.25, 0.125)  # where the identity is infinite
    location_frames: int = 6  # of each condition, for one trial of the location search
    location_widths_rad: tuple[float, ...] = (0.03, 0.1, 0.3)
    location_range_shares: tuple[float, ...] = (0.76, 0.87, 1.0, 1.15, 1.32)  # a cell of the map is an octave deep

    # ---- Residual tests, held-out conditions, clear air ----
    sensitive_rms: float = 1.0  # change of a statistic, in its scatter, from which it counts as sensitive
    floor_draws: int = 200  # of the gap that noise alone makes
    clear_frames_min: int = 4  # for a test of clear air
    clear_splits: int = 400  # of the clear frames into halves

    # ---- Scatter of statistics ----
    # Of what clear frames see in a bin, that must be seen in weather for a mean of it: of fewer, two codes of one
    # physics differed by up to five times the scatter (3 of 894 beams), of 35 % by three times.
    mostly_seen_share: float = 0.5
    jeffreys_events: float = 0.5  # events that a prior of a rate stands for (Jeffreys 1946)
    counting_prior_frames: float = 5.0  # that the law of counting weighs beside what simulated frames show
    # Degrees of freedom that the noise of elements tells of the variance of a spread, at most: in null studies what it
    # says scatters about the truth by 0.4 in its logarithm.
    element_law_degrees: float = 10.0
    # Elements over those whose noise was looked at, in other weather, from which it is that of independent ones.
    more_elements: float = 2.0
    unseen_events: float = 0.5  # of independent elements, taken for granted where a statistic shows none
    # Standard deviations that one event more is at most, however alike simulated frames are: what the deviance of a
    # Poisson law says of one event where 0.05 were expected.
    one_event_sd: float = 2.2
    known_degrees: float = 1e6  # of freedom of a scatter, from which it counts as known
    # Noise that simulated frames do not show of an entry, over what they show, up to which they tell its form.
    lacking_over_shown: float = 4.0
    well_may_be_sd: float = 2.0  # standard deviations of an estimated variance above it, where it is small
    quantiles: int = 2000  # of a distribution, over which a mean is taken
    most_unsure: float = 1.0  # relative variance of an estimated variance, up to which it is allowed for
    least_level: float = 0.05  # expected square of an entry, below which it is not taken
    log_spread_error: float = 0.03  # relative error of a modelled standard deviation
    # The same for particles whose range the model may misplace: the largest of several readings scatters less than
    # one, by as much as a receiver makes them independent (18 % were found).
    log_read_spread_error: float = 0.2
    persistence_rel_error: float = 0.01  # of a persistent pattern of dense weather
    linear_step: float = 1e-4  # of a departure, within which entries are linear
    weather_mean_rel_error: float = 0.005  # of the change of a mean by weather: two codes of one physics differ so
    # Degrees of freedom of whole frames, below which frames that are alike by chance make no steady sensor.
    few_degrees: int = 4
    frame_noise_p: float = 1e-4  # probability that the noise of whole frames exceeds its stated bound: below alarm_p

    # ---- Formulas of a departure over an axis ----
    formula_points: int = 16  # at which a formula is averaged within a bin
    formula_singular_share: float = 1e-6  # least singular value of the terms over the largest
    formula_criterion_gap: float = 2.0  # difference of the information criterion that decides nothing
    formula_max_frequencies: int = 8  # of a sine
    formula_open_bin_ratio: float = 3.0  # width of an end bin over its neighbour's, from which it has no end


METHOD = InferenceConfig()
"""The numbers in use."""
