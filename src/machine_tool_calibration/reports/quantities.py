# SPDX-License-Identifier: Apache-2.0
"""Values for people: a quantity with its expanded uncertainty, a probability, a duration.

Every command, table and picture forms its numbers here, so that one quantity looks the same wherever it stands: three
figures where there is no uncertainty, else as many as leave the expanded uncertainty two.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from machine_tool_calibration.coverage import K
from machine_tool_calibration.words import TIMES, Said, say, together

if TYPE_CHECKING:
    from machine_tool_calibration.model.result import Estimate
    from machine_tool_calibration.session.description import DeclaredUncertainty, StandardUncertainty

NOT_DETERMINED = "–"  # what stands where the data leaves no number
ROUNDING = 1e-11
"""Length or angle that is nothing, m or rad, however many figures the computer has of it."""
_SURE = 0.9  # probability from which what does not reproduce is shown with a size
MOST_NAMED = 3
"""Coefficients of an effect, or setups, of which each is named in a sentence; of more, one or their range."""
# (smallest absolute value, factor, unit) for each SI unit, the largest first.
_SCALES: dict[str, tuple[tuple[float, float, str], ...]] = {
    "1": ((1e-3, 1.0, ""), (0.0, 1e6, "µm/m")),
    "m": ((1.0, 1.0, "m"), (1e-3, 1e3, "mm"), (0.0, 1e6, "µm")),
    "m^2": ((1e-8, 1e6, "mm²"), (0.0, 1e12, "µm²")),
    "rad": ((0.1, 1.0, "rad"), (0.0, 1e6, "µrad")),
    "s": (*((least, 1 / of, unit) for least, of, unit in TIMES), (0.01, 1.0, "s"), (0.0, 1e3, "ms")),
    "1/K": ((0.0, 1e6, "µm/(m K)"),),
    "m/K": ((0.0, 1e6, "µm/K"),),
    "rad/K": ((0.0, 1e6, "µrad/K"),),
    "m/s": ((0.0, 3.6e9, "µm/h"),),
    "rad/s": ((0.0, 3.6e9, "µrad/h"),),
}


def quantity(value: float, unit: str, uncertainty: float | None = None) -> str:
    """A value with its unit (SI), and its expanded uncertainty (k = 2) if there is a standard uncertainty."""
    expanded = K * uncertainty if uncertainty is not None and math.isfinite(uncertainty) else 0.0
    if unit in ("m", "rad") and max(abs(value), expanded) < ROUNDING:
        value, expanded = 0.0, 0.0
    factor, shown = _scale(unit, max(abs(value), expanded))
    size, after = factor * expanded, f" {shown}" if shown else ""
    number = in_digits_of(size, factor * value)
    return f"{number} ± {in_digits_of(size, size)}{after}" if expanded else f"{number}{after}"


def as_exact(value: float, unit: str, expanded: float | None) -> str:
    """A value with its unit (SI) and as many digits as leave its expanded uncertainty two; three without one."""
    factor, shown = _scale(unit, abs(value))
    return f"{in_digits_of(factor * (expanded or 0.0), factor * value)}{f' {shown}' if shown else ''}"


def expanded_text(expanded: float, unit: str = "m") -> str:
    """An expanded uncertainty with its unit, of which two figures are shown; a dash where it is not determined."""
    return as_exact(expanded, unit, expanded) if math.isfinite(expanded) else NOT_DETERMINED


def _scale(unit: str, size: float) -> tuple[float, str]:
    """Factor from SI to the unit that people use for a value of that size, and that unit."""
    # of a user's own formula
    other = ((1e-3, 1.0, unit), (1e-7, 1e6, f"×10⁻⁶ {unit}"), (1e-300, 1e9, f"×10⁻⁹ {unit}"))
    factor, shown = next(((f, u) for low, f, u in _SCALES.get(unit, other) if size >= low), (1.0, unit))
    return factor, "" if shown == "1" else shown


def rounded(value: float | None) -> str:
    """Three figures, without an exponent where that is readable; a dash if it is not known."""
    if value is None:
        return NOT_DETERMINED
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g}"
    digits = 2 - math.floor(math.log10(abs(float(f"{value:.3g}"))))
    return f"{value:.{max(digits, 0)}f}" if -3 <= digits <= 8 else f"{value:.2e}"


def micrometres(metres: float | None, *, signed: bool = False) -> str:
    """Length in micrometres (or angle in microradians) without the unit, for a table; a dash if it is not known."""
    if metres is None or not math.isfinite(metres):
        return NOT_DETERMINED
    if abs(metres) < ROUNDING:
        return "0"
    return f"{'+' if signed and metres > 0 else ''}{rounded(1e6 * metres)}"


def millimetres(metres: float) -> str:
    """A long distance in millimetres down to the nanometre, in groups of three digits; a dash if it is not known."""
    if not math.isfinite(metres):
        return NOT_DETERMINED
    whole, rest = f"{1e3 * metres:,.6f}".split(".")
    return f"{whole}.{rest[:3]},{rest[3:]}".replace(",", "\u202f")


def probability(value: float | None) -> str:
    """A probability or p-value without a long tail of zeros; a dash if it is not determined."""
    if value is None:
        return NOT_DETERMINED
    if value < 1e-6:
        return "< 1e-6"
    return f"{value:.1e}" if value < 1e-3 else f"{value:.3f}" if value < 0.1 else f"{value:.2f}"


def p_value(value: float) -> str:
    """A p-value in a sentence: `p = 0.28`, `p < 1e-6`."""
    text = probability(value)
    return f"p {text}" if text.startswith("<") else f"p = {text}"


def duration(seconds: float | None) -> str:
    """A time as people say it."""
    if seconds is None:
        return NOT_DETERMINED
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    if seconds < 5400.0:
        return f"{seconds / 60.0:.0f} min"
    return f"{seconds / 3600.0:.1f} h"


def range_of(low: float, high: float, unit: str) -> str:
    """A plausible range."""
    if low == -high:
        return f"±{quantity(high, unit)}"
    return say("text.range", low=quantity(low, unit), high=quantity(high, unit))


def residual_change(before: float, after: float) -> Said:
    """How the residual, RMS, m, of a better model stands to that of the first one.

    It is larger where unknowns with a variance of their own, such as small angles, had taken up what the better model
    explains.
    """
    key = "fit.residual_falls" if after < before else "fit.residual_rises"
    return say(key, before=quantity(before, "m"), after=quantity(after, "m"))


def sizes_in_words(parameters: Sequence[Estimate], none: str = NOT_DETERMINED) -> str:
    """Coefficients of one effect with their expanded uncertainty; of many, the most significant one."""
    if not parameters:
        return none
    shown = list(parameters)
    if len(shown) > MOST_NAMED:
        shown = [max(shown, key=lambda p: abs(p.value) / max(p.standard_uncertainty, 1e-300))]
    text = ", ".join(f"{p.name.split('.', 1)[-1]} = {quantity(p.value, p.unit, p.standard_uncertainty)}" for p in shown)
    return text if len(shown) == len(parameters) else say("text.coefficients", n=len(parameters), one=text)


def reproducibility_words(sizes: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """What does not reproduce, where that is sure: from the entries `spread` of a result."""
    for entry in sizes:
        if entry["probability"] > _SURE and entry["size"] > 0:
            low, high = (quantity(end, "m") for end in entry["interval"])
            yield say("fit.differ", family=_family(entry), size=quantity(entry["size"], "m"), low=low, high=high)


def not_ruled_out(sizes: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """The most of what does not reproduce, where it is not sure that there is any: from the same entries."""
    most = [
        say("result.between", size=quantity(entry["interval"][1], "m"), family=_family(entry))
        for entry in sizes
        if entry["probability"] <= _SURE and entry["interval"][1] > 0
    ]
    if most:
        yield say("result.not_ruled_out", most=together(most, say("text.and")))


def _family(entry: Mapping[str, Any]) -> str:
    return say(f"fit.family_{entry['family']}")


def declared_words(said: StandardUncertainty) -> str:
    """What was declared of one reading: a, a + b of the path, and what single setups have instead."""

    def one(entry: DeclaredUncertainty) -> str:
        size = quantity(entry.displacement, "m")
        return say("result.of_path", size=size, slope=quantity(entry.per_length, "1")) if entry.per_length else size

    own = [say("text.sized", name=name, size=one(entry)) for name, entry in said.setups.items()]
    more = [say("text.more_setups", n=len(own) - MOST_NAMED)] if len(own) > MOST_NAMED else []
    return together((one(said), *own[:MOST_NAMED], *more), "; ")


def plus_minus(value: float | None, uncertainty: float | None, factor: float) -> str:
    """A value with its expanded uncertainty (k = 2), of which two figures are shown; never with an exponent.

    The factor is from SI, in which the standard uncertainty is, to the unit shown; None is not determined.
    """
    if value is None or uncertainty is None:
        return NOT_DETERMINED
    text, expanded = with_expanded(value, K * uncertainty, factor)
    return f"{'+' if float(text) > 0.0 else ''}{text} ± {expanded}"


def value_and_uncertainties(
    value: float, uncertainty: float, unit: str, place: bool = False
) -> tuple[str, str, str, str]:
    """Value, u and U with as many digits as `quantity` shows, and the unit that people use; a place is in mm."""
    expanded = K * uncertainty
    factor, name = (1e3, "mm") if place else _scale(unit, max(abs(value), expanded))
    size = expanded * factor
    found, u = in_digits_of(size, value * factor), in_digits_of(size, uncertainty * factor, 1)
    return found, u, in_digits_of(size, size), name


def in_digits_of(expanded: float, number: float, more: int = 0) -> str:
    """A number with the decimals that leave its expanded uncertainty two figures, or with `more` than these."""
    if not math.isfinite(number):
        return NOT_DETERMINED
    if not 1e-9 < expanded < 1e7 or abs(number) >= 1e9:
        return rounded(number)
    return fixed(number, decimals(expanded) + more)


def with_expanded(value: float, expanded: float, factor: float = 1e6) -> tuple[str, str]:
    """A length and its expanded uncertainty in micrometres, of which two figures are shown."""
    return in_digits_of(factor * expanded, factor * value), in_digits_of(factor * expanded, factor * expanded)


def of_map(size: float | None, u: float | None) -> tuple[str, str]:
    """The size of a map's errors and its expanded uncertainty (k = 2), m, likewise; a dash where one is not known."""
    return (micrometres(size), NOT_DETERMINED) if size is None or u is None else with_expanded(size, K * u)


def decimals(uncertainty: float) -> int:
    """Decimals that leave an uncertainty two figures; negative where these are tens and more."""
    return 1 - math.floor(math.log10(uncertainty))


def fixed(number: float, places: int) -> str:
    """So many decimals, and no minus sign before a zero."""
    return f"{round(number, places) + 0.0:.{max(places, 0)}f}"
