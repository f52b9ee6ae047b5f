"""A comparison in plain words."""

from __future__ import annotations

import numpy as np
from scipy import special

from machine_tool_calibration.diagnosis.comparison import Comparison, JointComparison, Overall

__all__ = ["in_words", "joint_in_words"]

# Chances at which the fit is called worse, or better, than declared, and repeats speak against the model.
_LEVEL, _TOO_GOOD, _LACK = 0.01, 0.999, 0.003
# Chance below which it fits only nearly.
_NEARLY = 0.05
# Share of the misfit that repeats must show to be called as large.
_NOISE = 0.7
# A few readings stand out: beyond so many times the bulk's scatter, at most this share, the bulk itself this quiet.
_FAR, _FEW, _QUIET = 5.0, 0.1, 0.7
# How much worse than all readings together a setup must be to be named.
_WORSE = 1.15


def in_words(comparison: Comparison) -> str:
    """What a person wants to know first: does the model fit, and if not, where not; lengths in micrometres."""
    overall = comparison.overall
    ratio, p = overall.ratio, overall.p_value
    if p > _TOO_GOOD:
        first = f"the readings scatter only {_ratio(ratio)} times the declared uncertainty, which is too large"
    elif p >= _LEVEL:
        nearly = "nearly " if p < _NEARLY else ""
        first = f"the model fits {nearly}within the declared uncertainty ({_um(overall.noise.declared)}; p = {p:.2g})"
    else:
        first = f"the readings scatter {_ratio(ratio)} times the declared uncertainty; {_where(comparison)}"
    apart = _stand_out(comparison)
    cause = " What the cause is, `mtcal diagnose` says." if p < _LEVEL else ""
    return f"{first}.{apart} {_repeats(overall, bool(apart))}{cause}"


def joint_in_words(comparison: JointComparison) -> str:
    """Whether the common model fits all sessions, and if not, which it fits worst."""
    joint = comparison.joint
    ratio, p = joint.reduced_chi_square**0.5, joint.p_value
    if p > _TOO_GOOD:
        return f"the readings scatter only {_ratio(ratio)} times the declared uncertainty, which is too large."
    if p >= _LEVEL:
        nearly = "nearly " if p < _NEARLY else ""
        return f"the model fits all sessions {nearly}within the declared uncertainty (p = {p:.2g})."
    label, worst = comparison.parts[0]
    where = "all sessions alike"
    if worst.reduced_chi_square is not None and worst.reduced_chi_square >= _WORSE**2 * joint.reduced_chi_square:
        times = _ratio(worst.reduced_chi_square**0.5)
        where = f"worst is session {label} ({times} times, {worst.share:.0%} of all misfit)"
    return (
        f"the readings scatter {_ratio(ratio)} times the declared uncertainty; {where}. Whether the sessions "
        "contradict each other, `mtcal identify` says."
    )


def _where(comparison: Comparison) -> str:
    ranked = [s for s in comparison.setups if s.reduced_chi_square is not None]
    if len(ranked) < 2:
        return "there is one setup"
    worst = ranked[0]
    assert worst.reduced_chi_square is not None
    if worst.reduced_chi_square < _WORSE**2 * comparison.overall.reduced_chi_square:
        return "all setups alike"
    times = worst.reduced_chi_square**0.5
    return f"worst is setup {worst.name} ({_ratio(times)} times, {worst.share:.0%} of all misfit)"


def _repeats(overall: Overall, apart: bool) -> str:
    noise = overall.noise
    if noise.from_repeats is None:
        return "Nothing was repeated often enough to tell noise from a lack of fit."
    scatter = f"Readings repeated at one place scatter {_um(noise.from_repeats)} (declared {_um(noise.declared)})"
    lack = noise.lack_of_fit_p
    if lack is not None and lack < _LACK:
        return f"{scatter}, and places differ by more than that: the model lacks something, or setups do not reproduce."
    if overall.p_value >= _LEVEL or apart:
        return f"{scatter}."
    if noise.from_repeats < _NOISE * overall.ratio * noise.declared:
        return f"{scatter}: what is left is more than their noise; the model lacks something, or runs do not reproduce."
    return (
        f"{scatter}: repeats differ as much, so either the declared uncertainty is too small, or something changes "
        "from one repeat to the next (time, temperature)."
    )


def _stand_out(comparison: Comparison) -> str:
    """A few large residuals over a quiet rest."""
    normal = np.abs(comparison.studentized[np.isfinite(comparison.studentized)])
    if not len(normal):
        return ""
    bulk = float(np.median(normal)) / float(special.ndtri(0.75))
    far = int((normal > _FAR * max(bulk, 1.0)).sum())
    if not far or far > _FEW * len(normal) or bulk > _QUIET * comparison.overall.ratio:
        return ""
    return (
        f" {far} reading{'s stand' if far > 1 else ' stands'} far out of the others, "
        f"which scatter {bulk:.2g} times the declared uncertainty."
    )


def _ratio(value: float) -> str:
    return f"{value:.2f}" if value < 1.5 else f"{value:.1f}"


def _um(value: float) -> str:
    return f"{1e6 * value:.2g} µm"
