"""All thresholds of a diagnosis in one place: odds, probabilities, shares and physical sizes, each with its reason.

"Seen" means: on simulated recordings of an independent plant (case_studies/blind_naming) and the public recordings of
docs/studies/benchmarks, before the sets that are published were made. ``tests/studies/diagnosis_settings.py`` moves each by 30 %
either way on fresh sets, docs/studies/diagnosis-settings is its table. It moves likewise what limits computing and decides
nothing: numbers of steps, rounds, draws and listed rows stand beside the function that uses them, as do limits of rounding.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """Thresholds of a diagnosis; the comments say where each comes from."""

    # -- odds, as log evidence

    #: That an effect has to bring: the odds of one among a hundred, times a thousand, log(1e5) = 11.5, rounded up.
    accept: float = 12.0
    #: Rivals within this cannot be told apart: odds of 20 to 1, log(20) = 3.0.
    rival: float = 3.0
    #: More unrelated effects at once are taken for surrogates: with one chance in three for each, three at once are no more
    #: likely than one that the library lacks (`outside_library`).
    likely_effects: int = 2

    # -- probabilities

    #: Of the interval about zero that an effect's values have to leave, and of all intervals that reports state; a change of a
    #: link is a possible body unless its distance to one is as improbable as what lies outside.
    interval: float = 0.95
    #: Of a false alarm in all that is looked at for where model and data disagree: one in a thousand recordings.
    level: float = 0.001
    #: Of a name that is wrong although no other effect of the library comes near: what acts is not in it. Seen: 6 of 156 names
    #: in blind sets in which one recording of ten has an effect that the library lacks.
    outside_library: float = 0.04
    #: Standard deviations by which an effect stands out: the physicists' convention, one in two million.
    detected: float = 5.0

    # -- shares

    #: Nearly all of a squared residual, of evidence or of energy: what is left is less than a third of it in root mean square,
    #: and may be what a model is inexact by. A part that is less than the rest, a tenth, is not worth a word.
    nearly_all: float = 0.9
    #: Most of it: what is left is no more than half of it in root mean square.
    most: float = 0.75

    # -- noise

    #: Mean square of whitened residuals above which something is left that no effect found explains: 1.2 times the noise in
    #: root mean square. Seen.
    unexplained: float = 1.45
    #: Mean square of residuals, with everything the library has, from which on what is left stands in for the noise, so that
    #: names can still be told from it: fourteen times the noise in root mean square. Seen.
    hopeless: float = 200.0
    #: Relative error of any model, of numbers written with four to five digits and of samples not quite at the same time.
    accuracy: float = 1e-4
    #: Ratio of measured to white noise power, in the median of windows, from which on noise is coloured: colour adds more than
    #: the white noise itself.
    coloured_ratio: float = 2.0
    #: Degrees of freedom from which on a scatter is known, its standard deviation to 13 %: of one band of a noise's spectrum, of
    #: how readings scatter from window to window.
    enough: float = 30.0
    #: Neighbouring frequencies whose residuals may depend on each other; over as many the encoders' share of noise is pooled.
    #: Seen.
    neighbours: int = 10

    # -- frequencies, times and speeds

    #: Highest frequency compared [Hz]; above, encoders' errors drown most of what is left. Seen.
    band: float = 10.0
    #: Positions are smoothed at least this loosely [Hz]: what their noise does above the motion is weighed, not cut. Seen.
    smoothing_bandwidth: float = 12.0
    #: Shorter segments tell no frequencies apart [s]: they are 0.25 Hz apart then. A measured noise has to reach down to the
    #: lowest that fits into one.
    shortest_segment: float = 2.0
    #: Time in which a recording's weight rises from nothing at both ends [s]. Derived: a taper this long leaks less than 1e-6
    #: of a constant into the band (see `bayesid.diagnosis.spectra.taper`).
    ramp: float = 0.5
    #: Time after which readings are taken for independent [s]: of windows in which residuals are looked at, of blocks that the
    #: bootstrap draws. Short events stand out of half of one on either side.
    window: float = 1.0
    #: What is over in this time is one event [s]: a joint's stop, friction's kick where it reverses, a tap.
    moment: float = 0.1
    #: Between samples closer than this where in a sample's time friction reverses makes no difference [s]. Seen.
    short_step: float = 0.0025
    #: A joint rests while it is slower than this share of its highest speed. Seen.
    rest_share: float = 0.005


#: The thresholds as they stand.
DEFAULT = Settings()
