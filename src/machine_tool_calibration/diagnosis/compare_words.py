"""A comparison in plain words."""

from __future__ import annotations

from machine_tool_calibration.diagnosis.compare import Comparison, Overall

__all__ = ["in_words"]

# Chances at which the fit is called worse, or better, than declared, and repeats speak against the model.
_LEVEL, _TOO_GOOD, _LACK = 0.01, 0.999, 0.003
# How much worse than all readings together a setup must be to be named.
_WORSE = 1.15


def in_words(comparison: Comparison) -> str:
    """What a person wants to know first: does the model fit, and if not, where not; lengths in micrometres."""
    overall = comparison.overall
    ratio, p = overall.ratio, overall.p_value
    if p > _TOO_GOOD:
        first = f"the readings scatter only {ratio:.2g} times the declared uncertainty, which is too large"
    elif p >= _LEVEL:
        first = f"the model fits within the declared uncertainty ({_um(overall.noise.declared)}; p = {p:.2g})"
    else:
        first = f"the readings scatter {ratio:.2g} times the declared uncertainty; {_where(comparison)}"
    return f"{first}. {_repeats(overall)}"


def _where(comparison: Comparison) -> str:
    ranked = [s for s in comparison.setups if s.reduced_chi_square is not None]
    if len(ranked) < 2:
        return "there is one setup"
    worst = ranked[0]
    assert worst.reduced_chi_square is not None
    if worst.reduced_chi_square < _WORSE**2 * comparison.overall.reduced_chi_square:
        return "all setups alike"
    times = worst.reduced_chi_square**0.5
    return f"worst is setup {worst.name} ({times:.2g} times, {worst.share:.0%} of the sum of squares)"


def _repeats(overall: Overall) -> str:
    noise = overall.noise
    if noise.from_repeats is None:
        return "Nothing was repeated often enough to tell noise from a lack of fit."
    scatter = f"Readings repeated at one place scatter {_um(noise.from_repeats)} (declared {_um(noise.declared)})"
    lack = noise.lack_of_fit_p
    if lack is not None and lack < _LACK:
        return f"{scatter}, and places differ by more than that: the model lacks something, or setups do not reproduce."
    if overall.p_value < _LEVEL and noise.from_repeats < 0.7 * overall.ratio * noise.declared:
        return f"{scatter}: what is left is not their noise but the model's, or that setups and runs do not reproduce."
    if overall.p_value < _LEVEL:
        return f"{scatter}: they explain what is left, and the declared uncertainty is too small."
    return f"{scatter}: no more is left than they explain."


def _um(value: float) -> str:
    return f"{1e6 * value:.2g} µm"
