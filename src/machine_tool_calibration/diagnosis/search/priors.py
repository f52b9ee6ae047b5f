# SPDX-License-Identifier: Apache-2.0
"""What a diagnosis believes before it sees the readings, and the few numbers by which it decides.

They are the only ones, beside the sizes that an effect may have (`model.effect_sizes`): verdicts, look-alikes and what
could have been found are read off the posterior.
"""

from __future__ import annotations

__all__ = [
    "ACCEPTED",
    "ALIKE",
    "BEYOND",
    "CONTRADICTED",
    "EFFECT",
    "FURTHER",
    "GOOD_ENOUGH",
    "GROSS",
    "LAW",
    "LEAST_GAIN",
    "LIKELY",
    "POSITIVE",
    "SELDOM",
    "SMALL",
    "STRUCTURE",
    "SURE",
    "THE_SAME",
]

EFFECT = 0.05
"""Prior probability that one effect of the catalogue is missing: with the twenty or so that a plan can show, that
something is missing and that nothing is are about even."""

STRUCTURE = 0.003
"""The same of a structure without a cause, of which many are tried: together they are as probable as one or two
effects."""

ACCEPTED = 0.5
"""Posterior probability from which an effect is named as missing: it is in the model more likely than not."""

FURTHER = 0.8
"""The same of an effect beside a surer one: where a law does not hold exactly, what it leaves looks like another
effect. Where the machine itself is read many are expected at once, and each counts like the first."""

SURE = 0.95
"""Posterior probability that something is missing from which it is said although no effect can be named."""

LIKELY = 0.2
"""Posterior probability from which an effect is called likely: what one would look at next."""

ALIKE = 0.9
"""Cosine between the signals of two effects outside the model from which they are look-alikes."""

THE_SAME = 0.98
"""Cosine from which a structure lies in the span of an effect, and is that effect: it would only share its
probability."""

GROSS, CONTRADICTED = 2.0, 1e-9
"""Weighted mean square from which the readings contradict the best model, and the chance of that: more than what does
not reproduce and a wrong declaration usually come to."""

POSITIVE = 10.0
"""Prior odds that a coefficient which is positive by its nature (a backlash) is so in the readings: a control may
compensate more than there is, and directions of approach may be recorded the wrong way round."""

GOOD_ENOUGH, SMALL = 1 / 3, 0.7
"""Share of the map's expanded uncertainty up to which what is left may move the map, and its size over the declared
uncertainty of a reading below which that does not matter: then the model is adequate. What is larger than the noise
never is."""

BEYOND = 2.0
"""Times the limits of its coefficients up to which an effect is tried: what is plausible is known to no better."""

SELDOM = 4.0
"""Prior odds against a size beyond what is usual, such as a dead path of metres on a small machine."""

LEAST_GAIN = 9.0
"""By how much an effect that is accepted lowers the weighted sum of squares at least, times the mean square that is
left: three standard uncertainties of one coefficient."""

LAW = 0.5
"""Share of a surer effect's signal below which another one that is the same but for a smooth function of time is what
that effect differs from its law by: a warm-up has more than one time constant."""
