"""Effects that hardly show in a measurement, and what would show them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from machine_tool_calibration.diagnosis.diagnose import Diagnosis
from machine_tool_calibration.diagnosis.findings import smallest_signal
from machine_tool_calibration.diagnosis.priors import EFFECT
from machine_tool_calibration.planning.advice import Visibility
from machine_tool_calibration.planning.option import Option
from machine_tool_calibration.planning.sensing import Assumed, Sensed

__all__ = ["visibilities"]

# Share of its norm outside the model below which an effect is hardly visible.
_HARDLY = 0.1
# A measurement is worth proposing for an effect if it shows one this much smaller.
_WORTH = 0.5
_MANY = 3


def visibilities(
    diagnosis: Diagnosis, now: Sensed, seen: Sequence[tuple[Option, Sensed]], assumed: Mapping[str, Assumed]
) -> list[Visibility]:
    """For effects that hardly show or not at all: the measurement that shows the smallest size of them."""
    fit = diagnosis.fits[-1]
    variance = max(fit.reduced_chi_square, 1e-12)
    observations = fit.assembly.models[0].observations
    out = []
    for r in diagnosis.look.findings:
        name = r.name
        if name not in now.place or (r.rank and now.share(name) > _HARDLY):
            continue
        coefficients = assumed[name].effect.coefficients_for(observations, assumed[name].shape)
        before = now.information(name)
        if len(coefficients) > _MANY:
            continue
        best: tuple[float, Option, int] | None = None
        for option, sensed in seen:
            if name not in sensed.place:
                continue
            after = sensed.information(name)[: len(before)]
            k = int(np.argmax(after))
            # A measurement that is more trouble must be worth it.
            if after[k] > 0 and (best is None or after[k] > 1.3 * best[0]):
                best = (float(after[k]), option, k)
        if best is None:
            continue
        information, option, k = best
        limit = max(abs(coefficients[k].low), abs(coefficients[k].high)) / 2.0
        strength = np.array([information * limit**2 / variance])
        needed = smallest_signal(strength, float(strength[0]), -np.log(EFFECT)) ** 2 * variance
        smallest = r.detectable.get(coefficients[k].name)
        if smallest is not None and before[k] > 0:
            needed = smallest**2 * float(before[k])
        after_size = float(np.sqrt(needed / information))
        possible = max(abs(coefficients[k].low), abs(coefficients[k].high))
        if after_size > possible or (smallest is not None and after_size > _WORTH * smallest):
            continue
        unit, words = coefficients[k].unit, option.words
        out.append(
            Visibility(
                name, coefficients[k].name, unit, smallest, after_size, option.kind, words, option.seconds, option.aside
            )
        )
    return out
