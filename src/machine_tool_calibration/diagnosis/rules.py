"""What a diagnosis decides by: levels, and what differs between methods."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = [
    "ALONE_LEVEL",
    "LATER_LEVEL",
    "LEVEL",
    "PAIR_LEVEL",
    "ROUNDING",
    "ROUNDS",
    "STRUCTURE_LEVEL",
    "Rules",
    "rules_of",
]

# Family errors of a round: together at most one false alarm in twenty sessions in which nothing is missing.
LEVEL, STRUCTURE_LEVEL = 0.03, 0.02
# That of a further effect, where one is in the model already and the map is put right: a needless one spoils it again.
LATER_LEVEL = 0.01
# That of two effects which are significant only together.
PAIR_LEVEL = 0.005
# Chance of a single effect, not paid for the search, where structure shows already that something is missing.
ALONE_LEVEL = 0.01
ROUNDS = 3
# Reduced chi-square below which the residuals are rounding, whatever they look like.
ROUNDING = 1e-6


@dataclass(frozen=True)
class Rules:
    """What differs between methods.

    Attributes:
        usual_spread: variance of slopes and bows between setups, over that of the readings, that is usual:
            reproducibility and no more.
        left_over: structure that is left after the accepted effects speaks against them if it is this share of all
            that was found.
        side_by_side: the machine's errors themselves are read: there are always several patterns side by side, none of
            which speaks against another.
        order: effects that are looked for before all others, group after group; they do not count as rounds.
    """

    usual_spread: float = 0.1
    left_over: float = 0.1
    side_by_side: bool = False
    order: tuple[tuple[str, ...], ...] = ()

    def tier(self, effect: str) -> int:
        """Index of the effect's group in the order; their number for all others."""
        return next((k for k, group in enumerate(self.order) if effect in group), len(self.order))


# No instrument's setup is in direct deviations of parts and of axes: the spread may be any. They hold the machine
# itself, whose small errors never end: what was found stays true beside them. Scales and squareness come first, as one
# looks for them, the one scale before all.
_DIRECT = Rules(
    usual_spread=100.0,
    left_over=0.5,
    side_by_side=True,
    order=(("scale",), ("scale_x", "scale_y", "scale_z", "C0Y", "B0Z", "A0Z")),
)


def rules_of(method: str) -> Rules:
    """The rules of a session's method."""
    return _DIRECT if method == "direct" else Rules()
