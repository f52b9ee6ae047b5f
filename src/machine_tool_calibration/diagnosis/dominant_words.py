"""What dominates the uncertainty of a map, and what to do about it, in words."""

from __future__ import annotations

from collections.abc import Iterator

from machine_tool_calibration.diagnosis.quantities import duration, micrometres
from machine_tool_calibration.planning.dominant import Dominant

__all__ = ["dominant_words"]


def dominant_words(found: Dominant) -> Iterator[str]:
    """Sentences; where the scatter of the readings dominates, only more of them help, and nothing is proposed.

    Args:
        found: what dominates.
    """
    if found.cause == "readings":
        yield (
            f"the readings' own scatter dominates the map's uncertainty, U = {micrometres(2 * found.uncertainty)} µm "
            f"(k = 2) on the average: {100 * found.shares['readings']:.0f} % of its variance; more repeats help"
        )
        return
    share = f"{100 * found.shares[found.cause]:.0f} % of its variance"
    assumed = f"angular errors of {1e6 * found.angular:.3g} µrad"
    if found.cause == "time":
        assumed = f"a drift of {3.6e9 * found.drift:.3g} µm per hour"
    yield (
        f"{found.cause} dominate{'s' if found.cause == 'time' else ''} the map's uncertainty, "
        f"U = {micrometres(2 * found.uncertainty)} µm (k = 2) on the average: {share}, for {assumed}"
    )
    for remedy in found.remedies:
        besides = f", and {remedy.aside}" if remedy.aside else ""
        time = f" ({duration(remedy.seconds)}{besides})" if remedy.seconds is not None else ""
        again = "" if found.again is None else f"; the same once more: {micrometres(2 * found.again)} µm"
        yield f"  {remedy.measure}{time}: U = {micrometres(2 * remedy.uncertainty)} µm{again}"
    if not found.remedies:
        yield "  none of the further measurements that were considered does clearly better than the same once more"
