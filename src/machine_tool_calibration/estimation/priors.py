# SPDX-License-Identifier: Apache-2.0
"""What is believed before any reading, and every number by which the engine decides.

The engine compares explanations of the readings by one evidence: effects of the catalogue, patterns without a cause,
what every model lacks a little, what does not reproduce, single gross errors, and noise. Numbers of the calculation
(rounding, memory, steps of a grid) stand where they are used and move no answer.
"""

import numpy as np

# --- noise ---

NOISE_DOF = (20.0, 2.0)
"""Prior degrees of freedom of the noise, of which the declared uncertainty is the size: a misfit of many readings
outweighs it; and where the declared uncertainty need not hold at all. What is published weighs both."""

CORRELATIONS = {0.0: 0.5} | dict.fromkeys(
    (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.93, 0.95, 0.97, 0.98, 0.99), 0.5 / 15.0
)
"""Correlations of noise from one reading of a setup to the next, with their probabilities: half that there is none."""

OWN_NOISE = 0.1
"""Probability that directions or setups have noise of their own: mostly one instrument reads all."""

# --- what does not reproduce (size in units of the noise) ---

ALL_REPRODUCES = 0.5
"""Probability that a family (runs, mountings) has no size at all: it keeps the power to find effects."""

IRREPRODUCIBILITY = 0.4
"""Scale of the half-Cauchy prior of its size otherwise: the long tail makes large spreads harmless; with a light one
every spread looks like a missing effect."""

SERIES = (1.0, 1.0, 0.7)
"""Sizes of the Legendre polynomials of degree 0 to 2 in the time of a run: what is slow is larger. A cubic costs every
spread more than it explains, so that an effect of few coefficients was more probable than it. In what is published an
offset that shows has a size of its own."""

DRIFT = (1.0, 0.7, 0.5, 0.5)
"""The same of degrees 1 to 4 in the time of a whole session, for what all of its runs share: of twice as many runs or
more, as fewer do not tell it from functions of their own."""

WELL_SEEN = 0.02
"""Share of what is seen best of a family, from which a combination of its functions says how large it is. A slope that
all runs have in common is the map's own but for a trace that jitter of their times leaves; what falls on a trace is a
misfit of the model, and would be a hundred times as large in the family (map 54 um off)."""

SEVERAL_RUNS = 4
"""Fewest runs or passes that say something of a spread between them where the machine's deviations are read directly:
the slopes and bows of fewer are the machine's own, unless they read enough places again."""

ENOUGH_REPEATS = 8
"""Degrees of freedom of repeats from which these alone say what does not reproduce, so that a lack of fit cannot."""

ENOUGH_PLACES = 8
"""Places beside the model's unknowns from which their means are looked at in place of their readings: of fewer, an
effect of several coefficients leaves nothing, whatever was read."""

# --- what every model lacks a little ---

IMPERFECTION_SIZES = {0.0: 0.5, 0.25: 0.2, 0.5: 0.2, 1.0: 0.1}
"""Sizes of smooth functions of place that no model has, in units of the noise, with their probabilities: no larger than
the readings scatter, since what is larger is an effect, or a structure to be named."""

LAW_SIZES = {0.0: 0.5, 1.0: 0.5}
"""Sizes of what the laws of effects in the model leave open, in their tolerances: a law holds exactly as probably as
not, as with effects that are looked for."""

# --- effects of the catalogue, and structures without a cause ---

EFFECT = 0.05
"""Probability that one usual effect of the catalogue is missing: with the twenty or so that a plan can show, that
something is missing and that nothing is are about even."""

STRUCTURE = 0.003
"""The same of a structure without a cause, of which many are tried: together they are as probable as one or two
effects."""

SCALE_STEP, SMALLEST_SIGNAL = 5.0, 2.0
"""The size of an effect is normal about zero with a standard deviation that is half of what is plausible, or smaller by
steps of this factor (or finer ones, `scale_step`), all equally probable, down to where its signal is this many standard
uncertainties: the prior spans the sizes that occur, so that an effect with wide limits is not at a disadvantage."""


def scale_step(coefficients: int) -> float:
    """Factor between the scales of an effect of so many coefficients, so that none is at a disadvantage by the grid.

    Halfway between two scales k coefficients have less evidence by about k h^2 / 4 in its logarithm, with h that of the
    step: one for two coefficients, and five for eight of them at the same step.
    """
    return float(SCALE_STEP ** (1.0 / np.ceil(np.sqrt(max(coefficients, 2) / 2.0))))


BEYOND = 2.0
"""Times the limits of its coefficients up to which an effect is tried: what is plausible is known to no better."""

SELDOM = 4.0
"""Odds against a size beyond what is usual, such as a dead path of metres on a small machine; and against an effect
that is a finer point of another (a lag behind the sensor, a squareness that changes with the temperature), or one of a
dozen of a kind (the reversals of angles and straightness): together such are no more probable than the usual ones."""

RARE, RARE_SIZE = 0.01, SCALE_STEP**2
"""Probability that an effect which was put into a model is larger than plausible, and its size then over half of that:
what the readings say clearly holds."""

POSITIVE = 10.0
"""Odds that a reversal is positive in the readings: a control may compensate more than there is, and directions of
approach may be recorded the wrong way round. What is positive by its nature, such as the growth of a screw, is no other
way: what looks like it was something else in each of four simulated sessions, and ruined the map."""

ANY_SIZE = 50.0
"""Half the size that a structure without a cause may have, in standard uncertainties of a reading."""

# --- gross errors (residuals in standard deviations of the noise) ---

GROSS_ERRORS, GROSS_ERRORS_DOF = 1.0, 100.0
"""One reading in a hundred has a gross error, known as well as from a hundred readings of which one had such."""

WIDTH = 10.0
"""Least width of gross errors: less is hardly distinguished from noise."""

TAILS = {3.0: 0.02, 4.0: 0.03, 6.0: 0.1, 10.0: 0.15, 20.0: 0.2, 1000.0: 0.5}
"""Degrees of freedom of the noise (Student) with their probabilities: the last is normal, 3 or 4 are rare."""

BULK = 0.95
"""Share of the readings whose distribution says what the noise is: gross errors have no say."""

SAME_EVIDENCE = 4.5
"""Difference in the logarithm of the evidence within which another set of gross errors may be true: 1 in 100."""

AS_DECLARED = 3.0
"""Declared standard uncertainties within which no reading has a gross error: U contains so much of any."""

SUSPECTED, SUSPECTED_BESIDE = 3.0, 4.0
"""Predicted residuals from which a reading is judged with others, at first and beside a set: few sound ones are."""

JUDGED = 0.02
"""A reading with less than this share of itself in its residual cannot be judged: that is left to curvature."""

OWN_SCATTER, TELLS_SCATTER = 2.0, 8
"""Scatter of the readings along one axis, over the least of one, from which they are judged by their own; and readings
from which it is told."""

SINGLE = 0.2
"""Share of the readings beyond which gross errors are no longer single, and none is set aside."""

CROWD, STRETCH, CROWDED, BROKEN = 8, 10, 0.33, 0.67
"""Gross errors, so many readings apart at most, from which a stretch by itself says whether they are single, and shares
of it: fewer come by chance; of more all are wrong, as with a broken beam. In between an instrument begins to fail."""

MISFIT = 1.1
"""Scatter over the declared uncertainty from which several wrong readings may hide each other (masking)."""

COURSE = 0.7
"""Scatter about the courses of the runs over the whole one, below which they are a pattern and no noise."""

NEIGHBOURS, AGREEING, QUIET, LEFT_OUT = 4, 3, 2.0, 8
"""Neighbours on each side of a reading in its run, how many of them must deviate, as one wrong one makes no course,
residuals within which they do not, and how many of a run are left out of its course at most, one after the other."""

FEW_UNKNOWNS = 0.1
"""Unknowns for each reading below which the model, such as a circle, is told by all readings and not by those of a
place: one repeat that is calm tells then that a stretch is none of the machine's."""

CURVED = 0.1
"""Share of a course within which it predicts a reading: curvature of a transient that decays within three readings."""

# --- what is accepted, refused and said ---

ACCEPTED = 0.5
"""Probability from which an effect is named as missing: it is in the model more likely than not."""

FURTHER = 0.65
"""The same of an effect beside a surer one: where a law does not hold exactly, what it leaves looks like another
effect. In imperfect worlds 1 of 25 single effects then gets a wrong second one (at 0.5 4 of 60), and both of two are
named in 49 of 60 perfect worlds (52; at 0.8 in 27 of 40 others). Where the machine itself is read many are expected at
once, and each counts like the first."""

MAY_BE = 0.02
"""The same from which the law of an effect is tried with its tolerance as well."""

LIKELY = 0.2
"""The same from which an effect is called likely: what one would look at next; and from which it is likely that nothing
is missing."""

SURE = 0.95
"""Probability that something is missing from which it is said although no effect can be named; and that one of two
effects is the one, from which they are distinguished, alike as they are."""

ALIKE, THE_SAME = 0.9, 0.98
"""Cosine between the signals of two effects outside the model from which they are look-alikes; and from which a
structure lies in the span of an effect, and is that effect."""

UNRELATED = 0.5
"""Probability that two effects are in together, over that if they were unrelated, below which they exchange it."""

AS_LIKELY = 0.7
"""Share of the likeliest look-alike's probability from which a commoner one, which the catalogue has before it, stands
for both: readings that do not distinguish them give them probabilities that differ by their priors' widths alone."""

OF_ONE_SCATTER, OF_THE_SCATTER_P = 0.6, 1e-4
"""Squares of an effect's size over its uncertainty by the scatter where it acts, over those by one scatter of all,
below which that matters; and their probability by chance from which it is no effect, where a hundred were tried."""

MOST_ALIKE, OF_FEW = 4, 0.8
"""Look-alikes of which one is named for all, and the share of their probability that so few have: more are no answer to
what is missing."""

LAW, SECOND_TIME_CONSTANT = 0.5, 1.0
"""Share of a surer effect's signal below which another one that is the same but for a smooth function of time is what
that effect differs from its law by; and the same where that effect has a time constant and the other none: slow parts
of a machine warm up by as much as quick ones, and a drift beside a warm-up of its size is the slow part of it."""

ABSORBED = 1e-4
"""Share of its squares outside the model below which an effect is absorbed: 1 % of its norm."""

LEAST_GAIN = 9.0
"""By how much an effect that is accepted lowers the weighted sum of squares at least, times the mean square that is
left: three standard uncertainties of one coefficient."""

CONTRADICTING = 3.0
"""Logarithm of the likelihood ratio of readings that were left out from which they speak against an effect: 1 in 20."""

SPOILT = 30.0
"""Growth of the map's uncertainty by an effect from which the map is no longer determined for any purpose."""

GOOD_ENOUGH, SMALL = 1 / 3, 0.7
"""Share of the map's expanded uncertainty up to which what is left may move the map, and its size over the declared
uncertainty of a reading below which that does not matter: then the model is adequate. What is larger than the noise
never is."""

CONTRADICTED, CONTRADICTED_P, MOST_OF_THE_EXCESS = 2.0, 1e-9, 0.5
"""Weighted mean square from which the readings contradict the best model, the probability of that, and the share of the
excess that effects must explain to be the cause all the same: more than what does not reproduce and a wrong declaration
usually come to. Of as much runs must be the cause to move a map where nothing was read again."""

AS_NOISY = 0.9
"""Share of the whole scatter from which that of repeats is as much: then the declared uncertainty is too small."""

STRUCTURE_P, LACK_OF_FIT_P = 0.02, 0.001
"""p-value below which a structure is named, and below which places that differ more than their repeats are."""

DETECTED = 0.8
"""Power with which the smallest size that is published would be found."""

SIZE_MARGIN = 2.0
"""Standard uncertainties by which a size may lie outside of what is tried for before it is called implausible."""

STANDS_OUT = 2.0
"""Standard uncertainties of a size beside the other effects, or the probability of that for several together, below
which an effect is not added: what it is said to be may be zero."""

NO_CHANCE = 1e-5
"""p-value from which an effect is added all the same. What does not reproduce has its published size from repeats
alone, which may leave room for the effect where the whole of the readings leaves none. In 400 simulated sessions three
of four right effects whose published size did not stand out had 1e-6 and less, eleven wrong ones 1e-4 and more."""

TAKEN_BACK = 2.0
"""What an effect with a time constant changes, over all that the model lacks, from which it is not added: the others
take back what it has too much, and none has its size by itself."""

NEARLY_ALL = 0.95
"""Share of what effects explain together from which those of them that can be added are all: what is left to the others
is no more than a law that holds to some tenths leaves of them."""

BURST, BESIDE_A_BURST, FAR_OUT = 12, 0.25, 5.0
"""Readings in a row of one burst at most, the share of it that the next ones are off by, and noises that it is far out:
a hand, a chip or a cable in the beam for a minute; what lasts longer is a course of the run."""

STEPS_ARE_RARE = 20.0
"""How much rarer than a wrong reading a step, or a bend too steep for the tables, is in one place of a machine."""

IN_A_ROW = 0.5
"""Share of a reading's own deviation that those next to it in its run have at least where they deviate alike."""
