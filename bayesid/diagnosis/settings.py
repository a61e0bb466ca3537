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
    #: Shorter segments tell no frequencies apart [s]: they are 0.25 Hz apart then. A measured noise has to reach down to the
    #: lowest that fits into one.
    shortest_segment: float = 2.0
    #: Time in which a recording's weight rises from nothing at both ends [s]. Derived: a taper this long leaks less than 1e-6
    #: of a constant into the band (see `bayesid.diagnosis.spectra.taper`).
    ramp: float = 0.5
    #: A joint rests while it is slower than this share of its highest speed. Set by looking at cases.
    rest_share: float = 0.005
    #: What is over in this time is one event [s]: a joint's stop, friction's kick where it reverses, a tap.
    moment: float = 0.1

    # -- noise

    #: Relative error of any model, of numbers written with four to five digits and of samples not quite at the same time.
    accuracy: float = 1e-4
    #: Frequencies pooled on each side for the encoders' share. Set by looking at cases.
    pooled_frequencies: int = 6
    #: Degrees of freedom from which on a scatter is known, its standard deviation to 13 %: of one band of a noise's spectrum, of
    #: how readings scatter from window to window.
    enough: float = 30.0
    #: A measured noise is known with so many degrees of freedom: its power to 13 %.
    spectrum_freedom: float = 120.0
    #: How much wider each band of it is in ratio.
    band_growth: float = 1.15
    #: Ratio of measured to white noise power, in the median of windows, from which on noise is coloured. Set by looking at cases.
    coloured_ratio: float = 2.0
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
    #: An effect contains another if its columns leave no more than this share of the other's in amplitude. Set by looking at
    #: cases.
    contained_share: float = 0.05
    #: Share of a squared residual, of evidence or of energy that is nearly all of it: what is left is less than a third of it in
    #: root mean square, and may be what a model is inexact by. A part that is less than the rest, a tenth, is not worth a word.
    nearly_all: float = 0.9
    #: Share that is most of it: what is left is no more than half of it in root mean square.
    most: float = 0.75
    #: More unrelated effects at once are taken for surrogates: set by looking at cases.
    likely_effects: int = 2
    #: Neighbouring frequencies whose residuals may depend on each other. Set by looking at cases.
    grouped_frequencies: int = 10

    # -- verdict

    #: Probability of the interval about zero that an effect's values have to leave, and of all intervals that reports state; a
    #: change of a link is a possible body unless its distance to one is as improbable as what lies outside.
    interval: float = 0.95
    #: Time that the bootstrap takes for independent of the next [s].
    bootstrap_block: float = 1.5

    # -- where

    #: Level of significance over everything that was looked at: one false alarm in a thousand recordings.
    level: float = 0.001
    #: Windows in which residuals are looked at [s]; short events stand out of half of one on either side.
    window: float = 1.0


#: The thresholds as they stand.
DEFAULT = Settings()
