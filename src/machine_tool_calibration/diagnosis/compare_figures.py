"""Figures of a comparison as text: values with their expanded uncertainty, chances, columns that say nothing."""

from __future__ import annotations

import math
from collections.abc import Sequence

__all__ = ["NOT_TOLD", "chance", "expanded", "untold"]

# What stands where the model's own unknowns leave no number.
NOT_TOLD = "–"
_MOST_PLACES = 6
_TAKEN_UP = "the model's own unknowns take up whatever there is"


def expanded(value: float | None, uncertainty: float | None, factor: float) -> str:
    """A value with its expanded uncertainty (k = 2), of which two figures are shown; never with an exponent.

    Args:
        value: None where the data does not determine it.
        uncertainty: standard uncertainty.
        factor: from SI to the unit shown.
    """
    if value is None or uncertainty is None:
        return NOT_TOLD
    shown, number = 2 * factor * uncertainty, factor * value
    digits = 1 - math.floor(math.log10(shown)) if shown > 0 else 3
    if digits < 0:
        number, shown = round(number, digits), round(shown, digits)
    places = min(max(digits, 0), _MOST_PLACES)
    # A zero has no sign: -0.00 says nothing that 0.00 does not.
    text = f"{number:+.{places}f}"
    return f"{text[1:] if float(text) == 0.0 else text} ± {shown:.{places}f}"


def chance(p: float | None) -> str:
    """A p-value."""
    if p is None:
        return NOT_TOLD
    return f"{p:.2g}" if p >= 1e-4 else "< 0.0001"


def untold(
    heads: Sequence[str], rows: Sequence[tuple[str, ...]], columns: Sequence[int]
) -> tuple[tuple[tuple[str, ...], ...], str]:
    """Empty those columns of uncertain values that hold no number at all, and say what dashes mean.

    Args:
        heads: of the table.
        rows: of the table.
        columns: those that hold values with an uncertainty.

    Returns:
        The rows, and a note.
    """
    nowhere = [k for k in columns if all(row[k] == NOT_TOLD for row in rows)]
    shown = tuple(tuple("" if k in nowhere else cell for k, cell in enumerate(row)) for row in rows)
    notes = []
    if any(row[k] == NOT_TOLD for row in shown for k in columns):
        notes.append(f"{NOT_TOLD}: {_TAKEN_UP}")
    if nowhere:
        names = " and ".join(heads[k].split(" / ")[0] for k in nowhere)
        notes.append(f"nothing is told of the {names}: {_TAKEN_UP}")
    return shown, "; ".join(notes)
