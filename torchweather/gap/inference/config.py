"""Numbers of the method that finds missing effects: thresholds of a verdict, limits of what a scatter is known to,
sizes of samples and steps of searches."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["METHOD", "NUMERICS", "SCATTER", "InferenceConfig", "NumericalConfig", "ScatterConfig"]


@dataclass(frozen=True)
class InferenceConfig:
    """Thresholds that decide a verdict, at most twenty.

    Where no other source is named, a number was set on development studies of the bench (``benchmarks/gap_bench``);
    no sealed study took part.
    """

    # ---- Is anything missing? ----
    min_entries: int = 30  # statistics that count, over all conditions, below which a study is refused
    alarm_p: float = 2e-4  # p value of the global test below which something is missing
    # The same where nothing explains the alarm on held-out conditions. A pattern that all conditions share needs only
    # alarm_p: a few counts do not make one by chance.
    sure_alarm_p: float = 1e-6
    residual_p: float = 1e-4  # p value of one statistic below which its residual is no noise
    # Probability of a misfit as large, from which one effect leaves a pair nothing, and a held-out gap is no remainder.
    left_by_noise: float = 0.1

    # ---- Does an effect earn its place? ----
    parameter_penalty: float = 5.0  # chi-square that one more parameter must gain: 97 % of one degree of freedom
    # Standard deviation of the error of an effect's form, over what it does: of a condition, and of a statistic along
    # an axis; and of an entry by itself (``form_error.py``). On development studies noise gains 20. With both, false
    # second names gained 4 at most beside wet surfaces of another law, 22 and 29 beside an extent of the fog (held-out
    # conditions refused them); true ones 25 to 434.
    form_share: float = 0.2
    form_entry_share: float = 0.1
    # By which an added effect must lower the misfit of held-out conditions, two standard deviations, however much it
    # explains elsewhere; an alarm is beyond noise already: they must not speak against its effect. One that explains
    # more than ``sure_gain`` they may, by so much of the remainder: where they hardly show it.
    held_gain: float = 4.0
    sure_gain: float = 50.0
    held_loss_share: float = 0.1

    # ---- Named, with a rest, or unknown? ----
    rest_share: float = 0.01  # of what departs, that is left where noise leaves none, from which there is a rest
    unknown_share: float = 0.25  # and from which the effects found explain too little
    residual_gap: float = 1.5  # held-out gap over its floor above which something else is missing, if it is no noise
    unexplained_gap: float = 10.0  # and above which the selection counts as nothing found
    # Of the square of the held-out gap over its floor, left, above which the selection counts as nothing found.
    # On development studies effects of the catalogue, also of another form, left at most 0.16 of it; of others two
    # wrong names left 0.197, those with a rest 0.24 and more.
    unexplained_share: float = 0.18
    # Of the held-out excess, that is left by effects whose form alone may differ. On development studies the glow of
    # fog, of another form than the stage's, left 0.07; what the catalogue does not have left 0.13 or more.
    repaired_share: float = 0.1
    least_excess: float = 1.1  # floors, from which a held-out gap is more than the noise of that score


@dataclass(frozen=True)
class ScatterConfig:
    """Limits to which the scatter of a statistic, and the model of a sensor, are known. They widen what noise is said
    to make; none of them is an answer."""

    # ---- Counts ----
    jeffreys_events: float = 0.5  # events that a prior of a rate stands for (Jeffreys 1946)
    counting_prior_frames: float = 5.0  # that the law of counting weighs beside what simulated frames show
    unseen_events: float = 0.5  # of independent elements, taken for granted where a statistic shows none
    # Standard deviations that one event more is at most, however alike simulated frames are: what the deviance of a
    # Poisson law says of one event where 0.05 were expected.
    one_event_sd: float = 2.2
    least_level: float = 0.05  # expected square of an entry, below which it is not taken

    # ---- Elements of a frame ----
    # Of what clear frames see in a bin, that must be seen in weather for a mean of it: of fewer, two codes of one
    # physics differed by up to five times the scatter (3 of 894 beams), of 35 % by three times.
    mostly_seen_share: float = 0.5
    # Degrees of freedom that the noise of elements tells of the variance of a spread, at most: in null studies what it
    # says scatters about the truth by 0.4 in its logarithm.
    element_law_degrees: float = 10.0
    # Elements over those whose noise was looked at, in other weather, from which it is that of independent ones.
    more_elements: float = 2.0
    shrinkage: float = 0.1  # of correlations towards zero

    # ---- A scatter that few frames tell ----
    frames_for_spread: int = 3  # least number; two frames differ alike in either order, which has no scatter
    known_degrees: float = 1e6  # of freedom of a scatter, from which it counts as known
    # Noise that simulated frames do not show of an entry, over what they show, up to which they tell its form.
    lacking_over_shown: float = 4.0
    well_may_be_sd: float = 2.0  # standard deviations of an estimated variance above it, where it is small
    most_unsure: float = 1.0  # relative variance of an estimated variance, up to which it is allowed for
    # Degrees of freedom of whole frames, below which frames that are alike by chance make no steady sensor.
    few_degrees: int = 4
    frame_noise_p: float = 1e-4  # probability that the noise of whole frames exceeds its stated bound: below alarm_p
    clear_frames_min: int = 4  # for a test of clear air

    # ---- Models of sensors ----
    weather_mean_rel_error: float = 0.005  # of the change of a mean by weather: two codes of one physics differ so
    log_spread_error: float = 0.03  # relative error of a modelled standard deviation
    # The same for particles whose range the model may misplace: the largest of several readings scatters less than
    # one, by as much as a receiver makes them independent (18 % were found).
    log_read_spread_error: float = 0.2
    persistence_rel_error: float = 0.01  # of a persistent pattern of dense weather
    unmodelled_share: float = 0.5  # scatter of a statistic that no parameter gives, over its change by the effect
    nuisance_bound_sd: float = 4.0  # standard deviations by which a nuisance may move


@dataclass(frozen=True)
class NumericalConfig:
    """Sizes of samples and steps of searches: they set the cost and the accuracy of an answer."""

    # ---- Global test ----
    null_draws: int = 1000  # draws of the null distribution of the largest delta chi-square
    departures: int = 4  # patterns that are looked at; the chance of an alarm is that of any of them
    places_looked_at: int = 2  # in azimuth, where the measurement departs most, for effects with a place
    refined_share: float = 0.25  # of the largest delta chi-square, from which a whole response curve is simulated

    # ---- Which candidates are fitted ----
    max_effects: int = 3  # named at most
    refitted: int = 4  # effects alone that are fitted; the best ones by their responses
    added_refitted: int = 2  # effects on top of others
    hidden_refitted: int = 1  # effects whose response a sensor's open uncertainties may have taken up
    rest_refitted: int = 5  # effects fitted from where those uncertainties stand at rest
    # Pairs of effects that are scored within the bounds of the nuisances, the best ones without them; and fitted.
    pairs_screened: int = 60
    pairs_refitted: int = 4
    refit_share: float = 0.5  # of the largest delta chi-square, from which a candidate is fitted
    rival_chi2: float = 40.0  # misfit over the best one's, up to which a first fit is refined
    reweightings: int = 3  # fits that are repeated with the scatter at their own result

    # ---- Fits of candidates ----
    threshold_amplitude: float = 0.3  # of a response below which an effect with a threshold stays below it
    least_amplitude: float = 0.02  # of a response, at which a fit starts
    first_fit_steps: int = 2
    fitted_better_share: float = 0.1  # of a misfit, by which effects are fitted better, from which a round begins again
    # Of a response, squared, that nuisances leave, below which they are fitted anew beside the effect; and where what
    # is left open stands ``far_sd`` off.
    shadowed_shares: tuple[float, float] = (0.1, 0.5)
    far_sd: float = 2.0
    profile_rounds: int = 2  # of such a fit of the nuisances;
    profiled_beside: int = 2  # of how many effects, the ones with the largest gains
    form_orders: int = 4  # polynomials of the error of a form, as many as an axis has bins at most
    form_least_square: float = 1e-3  # of a column of it, below which it is noise of a simulated mean
    valley_steps: int = 5  # by which a valley is followed to stronger effects,
    valley_factor: float = 1.4  # and what each multiplies by

    # ---- Likelihood: simulated frames, derivatives, fit of the nuisances ----
    pool_frames: int = 48  # of each condition, for the scatter
    screen_frames: int = 6  # of each condition, for a response or a derivative; the first of the pool
    probe_frames: int = 16  # of each condition, for a cost
    probe_draws: int = 32  # of the vector of statistics, for a cost
    kept_frames: int = 8192  # reduced, of all points; some 10 kB each
    intensity_grid_sd: tuple[float, ...] = (-2.0, -1.0, 0.0, 1.0, 2.0)  # starts of intensities, in their recorded sd
    intensity_halvings_sd: tuple[float, ...] = (0.5, 0.25, 0.125)  # to either side of the best of these
    intensity_step_sd: float = 0.5  # of a derivative by the weather's intensity,
    least_intensity_step: float = 0.005  # at least so much of its logarithm
    systematic_step_sd: float = 2.0  # of a derivative by a systematic: a smaller step changes too few particles
    angle_step_rad: float = 0.025  # least step of a derivative by an angle: about one column
    derivative_step: float = 0.05  # over the typical size of a parameter,
    weak_step_share: float = 0.5  # at most of a weak parameter's departure from its identity,
    least_step_share: float = 2e-3  # at least of the typical size
    step_shares: tuple[float, ...] = (1.0, 0.4, 0.15)  # of a step, until one helps;
    longest_step: float = 32.0  # and how far one is doubled
    # Decrease behind a step over the one that a linear simulator promises, from which the step is doubled: the least of
    # a parabola is then a quarter beyond it, 1 / (2 - 1.2).
    doubled_from: float = 1.2
    max_iterations: int = 10  # Gauss-Newton steps of a fit
    nuisance_rounds: int = 10  # Gauss-Newton steps of the nuisances alone
    # Of the decrease that responses to nuisances promise beside a weak effect, up to which they are kept.
    kept_while_gained: float = 0.5
    converged_chi2: float = 3.0  # gain below which one more of those steps is not worth its frames
    stalled_chi2: float = 0.5  # of the cost, below which a step does not count,
    stalled_share: float = 1e-3  # and its share

    # ---- Distribution of the statistics of simulated frames ----
    distribution_draws: int = 256  # of the vector of statistics from the pool
    # Into which the elements of a frame are divided. Correlations come from as many portions as there are of all frames
    # that start from different clear ones: 1,024. With 384 of them, from three clear frames, what they make independent
    # had 1.1 to 1.5 of its variance.
    portions: int = 128
    portioned_frames: int = 8  # of each condition
    whitening_folds: int = 10  # of the portions, of which each is whitened with the others' correlations
    quantiles: int = 2000  # of a distribution, over which a mean is taken
    linear_step: float = 1e-4  # of a departure, within which entries are linear

    # ---- Response templates and starts of fits ----
    template_amplitudes: tuple[float, float] = (0.0, 1.35)  # between which a response is scaled
    start_steps: tuple[float, ...] = (0.03, 0.25, 1.0, 3.0)  # strengths over the typical size of a parameter
    # The same for effects that act within their parameter: a wide step would pass over them.
    start_steps_of_cuts: tuple[float, ...] = tuple(0.15 * 1.2**step for step in range(16))
    start_steps_far: tuple[float, ...] = (4.0, 2.0, 1.0, 0.5, 0.25, 0.125)  # where the identity is infinite
    location_frames: int = 6  # of each condition, for one trial of the location search
    location_widths_rad: tuple[float, ...] = (0.03, 0.1, 0.3)
    location_range_shares: tuple[float, ...] = (0.76, 0.87, 1.0, 1.15, 1.32)  # a cell of the map is an octave deep
    location_halvings: int = 5  # of steps,
    standing_halvings: int = 3  # more of what has a range as well,
    location_passes: int = 2  # passes of each

    # ---- Held-out conditions, clear air ----
    floor_draws: int = 200  # of the gap that noise alone makes
    clear_splits: int = 400  # of the clear frames into halves

    # ---- Formulas of a departure over an axis ----
    # A formula describes a curve where a chi2 as large has this probability at least, or where it leaves no more than
    # this of the square of the curve: beams do not fill bins evenly, and no law of nature is asked for.
    formula_fits_p: float = 1e-3
    formula_leaves_share: float = 0.1
    formula_points: int = 16  # at which a formula is averaged within a bin
    formula_singular_share: float = 1e-6  # least singular value of the terms over the largest
    formula_criterion_gap: float = 2.0  # difference of the information criterion that decides nothing
    formula_max_frequencies: int = 8  # of a sine
    formula_open_bin_ratio: float = 3.0  # width of an end bin over its neighbour's, from which it has no end


METHOD, SCATTER, NUMERICS = InferenceConfig(), ScatterConfig(), NumericalConfig()
"""The numbers in use."""
