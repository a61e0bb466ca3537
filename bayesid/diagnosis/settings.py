"""All thresholds of a diagnosis in one place, each with its derivation, its source, or "set by looking at cases".

Looking at cases means: on simulated recordings of an independent plant (case_studies/blind_naming) and the public recordings of
docs/studies/benchmarks, before the sets that are published were made. ``tests/studies/diagnosis_settings.py`` moves each of them
by 30 % either way on fresh sets, docs/studies/diagnosis-settings is its table. Limits of rounding stand where they are used.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """Thresholds of a diagnosis; the comments say where each comes from."""

    # -- what is compared

    #: Positions are smoothed at least this loosely [Hz]: what their noise does above the motion is weighed, not cut. Set by
    #: looking at cases.
    smoothing_bandwidth: float = 12.0
    #: Highest frequency compared [Hz]; above, encoders' errors drown most of what is left. Set by looking at cases.
    band: float = 10.0
    #: Share of the band clear of encoders' noise to which loads that are differentiated again are smoothed in fitted motions.
    #: Set by looking at cases: what is left of the noise makes estimates of a compliance too small.
    fitted_clear_share: float = 0.7
    #: Predictions are made at these rates [Hz]: six times `band`; twice that where friction reverses at once.
    smooth_rate: float = 60.0
    friction_rate: float = 120.0
    #: Shorter segments tell no frequencies apart [s]: they are 0.25 Hz apart then.
    shortest_segment: float = 2.0
    #: Prior relative standard deviation of links of which nothing is stated: so wide that it says nothing.
    unknown_rel_std: float = 100.0
    #: Time in which a recording's weight rises from nothing at both ends [s]. Derived: a taper this long leaks less than 1e-6
    #: of a constant into the band (see `bayesid.diagnosis.spectra.taper`).
    ramp: float = 0.5
    #: A joint rests while it is slower than this share of its highest speed, if that lasts this long [s]. Set by looking at
    #: cases.
    rest_share: float = 0.005
    rest_time: float = 0.1

    # -- noise

    #: Relative error of any model, of numbers written with four to five digits and of samples not quite at the same time.
    accuracy: float = 1e-4
    #: Repetitions of the encoders' rounding: a standard deviation to 20 % before pooling, to 6 % after.
    roundings: int = 12
    #: Frequencies pooled on each side for the encoders' share. Set by looking at cases.
    pooled_frequencies: int = 6
    #: Samples of a window whose high frequencies are taken for noise, and which quantile of windows counts as quiet. Set by
    #: looking at cases; what the quantile is worth of a chi-squared is taken back, so that neither biases white noise.
    quiet_window: int = 64
    quiet_quantile: float = 0.1
    #: Ratio of powers at two high frequencies above which noise is not white. Set by looking at cases.
    filtered_ratio: float = 8.0
    #: Steps that must be whole multiples before they count as an encoder's: twenty by chance have odds of 0.2**20.
    encoder_steps: int = 20
    #: A measured noise is known if it reaches down to this frequency [Hz] with so many degrees of freedom: its power to 13 %.
    spectrum_reach: float = 0.5
    spectrum_freedom: float = 120.0
    #: Degrees of freedom of one band of it, for a standard deviation to 13 %, and how much wider each is in ratio.
    band_freedom: float = 30.0
    band_growth: float = 1.15
    #: Of a power less the encoders' share no less than this is left: a difference of two estimates may be negative.
    least_noise_share: float = 0.05
    #: Ratio of measured to white noise power, in the median of windows this long [s], from which on noise is coloured. Set by
    #: looking at cases.
    coloured_ratio: float = 2.0
    colour_window: float = 1.0
    #: Mean square of residuals, with everything the library has, above which noise was measured wrongly. Set by looking at
    #: cases.
    hopeless: float = 200.0
    #: Between samples closer than this where in a sample's time friction reverses makes no difference [s]. Set by looking at
    #: cases.
    short_step: float = 0.0025

    # -- search

    #: Log evidence that an effect has to bring: the odds of one among a hundred, times a thousand, log(1e5) = 11.5, rounded
    #: up.
    accept: float = 12.0
    #: Times that evidence by the estimate and its covariance alone from which an effect is kept without a fit that leaves it
    #: out: the others would have to make up for nine tenths of it beyond what a linear model says.
    certain: float = 10.0
    #: Rivals within this log evidence cannot be told apart: odds of 20 to 1, log(20) = 3.0.
    rival: float = 3.0
    #: Share of names that are wrong although no other effect of the library comes near: what acts is not in it. Set by looking at
    #: cases, 6 of 156 names in blind sets in which one recording of ten has an effect that the library lacks.
    outside_library: float = 0.04
    #: Mean square of whitened residuals above which something is left that no effect found explains: 1.2 times the noise in
    #: root mean square. Set by looking at cases.
    unexplained: float = 1.45
    #: Standard deviations by which an effect stands out: the physicists' convention.
    detected: float = 5.0
    #: Families of effects sought; more would not be named. Set by looking at cases.
    most_families: int = 4
    #: Proposals fitted exactly in one round, in a round of exchanges, of one kind, and of kinds of which one alone is sought.
    #: Set by looking at cases: more found nothing else.
    fitted_proposals: int = 8
    exchanged_proposals: int = 4
    alike_proposals: int = 2
    single_proposals: int = 4
    #: Rounds of exchanges, and passes of names in part; most settle in the first. Families fitted at once in one round. Set by
    #: looking at cases.
    sweeps: int = 3
    families_at_once: int = 3
    #: An effect that leaves more than this share of an unexplained residual is a surrogate. Set by looking at cases.
    surrogate_share: float = 0.8
    #: An effect contains another if its columns leave no more than this share of the other's in amplitude. Set by looking at
    #: cases.
    contained_share: float = 0.05
    #: A model that explains this share of the residual may leave more than noise: no model of a drive is exact to a
    #: hundredth. Set by looking at cases.
    nearly_all: float = 0.95
    #: More unrelated effects at once are taken for surrogates: set by looking at cases.
    likely_effects: int = 2
    #: A change of a link is a possible body unless its distance to one has a smaller probability: the usual 5 %.
    possible_body: float = 0.05
    #: Gauss-Newton steps at most, of a start that is to be compared only, and the change of chi2, in units of its mean,
    #: below which a fit has settled.
    fit_steps: int = 15
    exchange_steps: int = 4
    settled_chi2: float = 0.02
    #: Exact fits race: after so many steps, those that have gained less than this share of the best one's gain are given up. Set
    #: by looking at cases.
    race_steps: int = 5
    race_share: float = 0.2
    #: Neighbouring frequencies whose residuals may depend on each other. Set by looking at cases.
    grouped_frequencies: int = 10

    # -- verdict

    #: Probability of the interval about zero that an effect's values have to leave: that of the intervals that reports state.
    interval: float = 0.95
    #: A contact that lasts for a larger share of a motion is no event in it: half.
    longest_contact: float = 0.5
    #: An effect must not make unseen motions worse by more than this share of their squared residual. Set by looking at
    #: cases.
    worse_share: float = 0.02
    #: Where the gap before is this many times the floor, it has to shrink. Set by looking at cases.
    room_ratio: float = 1.05
    #: Share that effects named in part must close: of the whole gap, or of that in the channels that they act in. Set by
    #: looking at cases.
    mostly_closed: float = 0.7
    #: Where so much of the gap on unseen motions is closed, what is left of it there is no sign of something unknown. Set by
    #: looking at cases.
    closed: float = 0.9
    #: Time that the bootstrap takes for independent of the next [s], and how often it draws.
    bootstrap_block: float = 1.5
    bootstrap_draws: int = 999
    #: A floor this many times the noise says that predictions of unseen motions are vague: their uncertainty exceeds the
    #: noise.
    vague_floor: float = 1.5
    #: From here on the slope of a drift is lost in its size at the start [s]: a day.
    late_start: float = 1e5
    #: Blocks into which the recordings are cut; one without which little is left carries the effect if its share is this many
    #: times that of evenly spread evidence, or this share of all. Set by looking at cases.
    blocks: int = 10
    uneven: float = 3.0
    carries_all: float = 0.9

    # -- description of what no effect explains

    #: Terms of a description at most: more would be a fit, not a description.
    description_terms: int = 3
    #: A term closes at least this share of what was left on motions that it was not chosen on; less is not worth a draft.
    worthwhile: float = 0.1
    #: Candidates whose numbers are adapted in each round, and candidates compared on the other half.
    description_adapted: int = 10
    description_compared: int = 40

    # -- where

    #: Level of significance over everything that was looked at: one false alarm in a thousand recordings.
    level: float = 0.001
    #: Windows [s], into how many each is divided, and the share of a window's excess that its parts must hold to stand for
    #: it. Set by looking at cases.
    window: float = 1.0
    window_parts: int = 4
    inside_share: float = 0.8
    #: Disagreements and short events listed.
    listed: int = 8
    listed_events: int = 6
    #: Windows of short events [s], no fewer samples than this, and how far around the usual level is sought [s].
    event_window: float = 0.05
    event_samples: int = 5
    event_around: float = 0.5
    #: An event is this many times the usual level, whatever its significance. Set by looking at cases.
    event_clear: float = 2.5
    #: Friction's kick at a reversal lasts this long [s]; a joint this many times faster than at rest moved. Set by looking at
    #: cases.
    kick_time: float = 0.12
    kick_speed: float = 10.0
    #: Windows and samples that it takes to know how readings scatter when nothing happens. Set by looking at cases.
    known_windows: int = 30
    least_samples: int = 64
    #: A rest that lasts this long is not looked at; marked windows closer than this are one event [s]. Set by looking at
    #: cases.
    event_rest: float = 0.25
    event_bridge: float = 0.15
    #: A tap has this share of its energy within this time [s], over a band this wide [Hz]. Set by looking at cases.
    tap_share: float = 0.8
    tap_time: float = 0.1
    tap_width: float = 20.0


#: The thresholds as they stand.
DEFAULT = Settings()
