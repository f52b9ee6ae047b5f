# SPDX-License-Identifier: Apache-2.0
"""An axis follows a quantity of the user's own that was recorded: e_x = (quantity - reference) (k x - q)."""

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Coefficient, Effect, stands_still
from machine_tool_calibration.effects.thermal_expansion import REFERENCE_TEMPERATURE, ThermalExpansion
from machine_tool_calibration.effects.thermal_lag import ThermalLag
from machine_tool_calibration.effects.warmup import LARGEST_GROWTH
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.session.table import NUMERIC_COLUMNS
from machine_tool_calibration.words import say

# Columns that have effects: a control's whole log has hundreds, of which any hundred go with what was measured.
_MOST_COLUMNS = 12
_LINEAR = "xyz"
# Steps by one after every so many readings, from which a column is a number of the part or of the reading.
_COUNTS = 10
_TEMPERATURE, _AIR = "temperature_", "temperature_air"
# Before a column that begins like this, `now_` tells what follows it at once from what follows another late.
_LATE, _NOW = "late_", "now_"
_ID = re.compile(rf"follows_(?P<when>{_LATE}|{_NOW})?(?P<column>[A-Za-z_]\w*)_(?P<axis>[{_LINEAR}])")


class Follows(ThermalExpansion):
    """An axis is displaced, and its scale grows, in proportion to a column that the session has beside the known ones.

    Controls compensate the like by temperatures of spindle, bed or column (ISO 230-3); load and speed act alike. Where
    the axis has no sensor of its own it may follow the air. A temperature (`temperature_…`) counts from 20 degrees
    Celsius, anything else from its mean over the readings. Coefficients are per unit of the column.
    """

    id = "follows_{now}{column}_{axis}"
    title = say("effect.follows")
    formula = say("formula.follows")
    source = "ISO 230-3, thermal distortion by temperatures of the structure"
    # Of an axis of a metre, over all that was recorded; `coefficients_for` has them per unit.
    coefficients = (
        Coefficient("q", "m", -LARGEST_GROWTH, LARGEST_GROWTH, say("coefficient.follows_over_all")),
        Coefficient("k", "1", -LARGEST_GROWTH, LARGEST_GROWTH, say("coefficient.follows_scale_over_all")),
    )
    needs: tuple[str, ...] = ("{axis}", "{column}")
    tolerance = 0.3  # what grows is warm elsewhere than at the sensor, and has more than one time constant

    def __init__(self, column: str, axis: str) -> None:
        """That of one column and a linear axis."""
        self.column = column
        super().__init__(axis)

    @property
    def _names(self) -> dict[str, str]:
        now = _NOW if self.column.startswith((_LATE, _NOW)) else ""
        return super()._names | {"column": self.column, "now": now}

    def why_not(self, observations: Observations) -> str | None:
        """Nor where the column counts the readings: a number of the order is no cause."""
        if (why := super().why_not(observations)) is not None:
            return why
        values = observations.readings.column(self.column)
        steps = np.flatnonzero(np.diff(values))
        counts = len(steps) >= _COUNTS and (np.diff(values)[steps] == 1.0).all() and np.ptp(np.diff(steps)) == 0
        return f"the column {self.column} numbers the readings" if counts else None

    def excess(self, observations: Observations, shape: tuple[float, ...]) -> Array:
        """(n,) of the column over its reference."""
        if self.column.startswith(_TEMPERATURE):
            return observations.temperature(self.column) - REFERENCE_TEMPERATURE
        values = observations.readings.column(self.column)
        return np.asarray(values - values.mean())

    def coefficients_for(self, observations: Observations, shape: tuple[float, ...] = ()) -> tuple[Coefficient, ...]:
        """A shift, and a scale where the axis moves; as large as a frame's growth over what was recorded."""
        over = LARGEST_GROWTH / max(float(np.ptp(observations.readings.column(self.column))), 1e-12)
        per_unit = "/K" if self.column.startswith(_TEMPERATURE) else ""
        shift = Coefficient("q", f"m{per_unit}", -over, over, say("coefficient.follows", column=self.column))
        if stands_still(observations, self.axis):
            return (replace(shift, name="s"),)
        extent = float(np.ptp(observations.readings.column(self.axis)))
        scale = Coefficient("k", f"1{per_unit}", -over / extent, over / extent, say("coefficient.follows_scale"))
        return (shift, scale)

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Those of the thermal expansion, the shift first."""
        return super().columns(observations, shape)[::-1]


class FollowsLate(ThermalLag, Follows):
    """The same behind the column, with a first-order lag: what is heavy follows a sensor on its skin."""

    id = "follows_late_{column}_{axis}"
    title = say("effect.follows_late")
    formula = say("formula.follows_late")
    needs = (*Follows.needs, "time")
    contains = (Follows.id,)


def recorded_effects(columns: Sequence[str]) -> tuple[Effect, ...]:
    """The effects of those columns, by name, that are none of the known ones, and of the air for axes without a sensor.

    Of many columns the first have them; any other has by its id (`recorded_effect`).
    """
    own = [(column, axis) for column in columns if column not in NUMERIC_COLUMNS for axis in _LINEAR]
    own = own[: _MOST_COLUMNS * len(_LINEAR)]
    own += [(_AIR, axis) for axis in _LINEAR if _AIR in columns and f"{_TEMPERATURE}{axis}" not in columns]
    every = [effect(*one) for one in own for effect in (Follows, FollowsLate)]
    return tuple(effect for effect in every if _ID.fullmatch(effect.id))


def recorded_effect(name: str) -> Effect | None:
    """The effect of this id, such as `follows_bed_z`; None if it is none of these."""
    found = _ID.fullmatch(name)
    if found is None:
        return None
    effect = (FollowsLate if found["when"] == _LATE else Follows)(found["column"], found["axis"])
    return effect if effect.id == name else None
