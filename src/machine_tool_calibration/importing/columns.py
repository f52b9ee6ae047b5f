# SPDX-License-Identifier: Apache-2.0
"""A foreign table's columns by what they are, in SI units."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray, first_true
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.importing.mapping import ROLES, ColumnRule
from machine_tool_calibration.importing.mapping import Mapping as TableMapping
from machine_tool_calibration.importing.text_table import TextTable
from machine_tool_calibration.units import dimension, name_and_unit, quantity, unknown_unit

_NEED_NO_UNIT = {"time": "s", "temperature": "degC", "number": "1"}


@dataclass(frozen=True)
class Rows:
    """Readings made from a table."""

    numbers: Mapping[str, Array]  # numeric columns of `observations.csv`, each (n,)
    labels: Mapping[str, np.ndarray]  # text columns, each (n,), `setup` among them
    row: IntArray  # (n,) row of the table that each reading comes from
    description: Mapping[str, object]  # keys of session.yaml that the table gives
    notes: tuple[str, ...] = ()  # what was done that the user should know


@dataclass
class Columns:
    """Access to the columns that a mapping names."""

    table: TextTable  # the file's cells
    mapping: TableMapping  # what they mean
    # what was read, for the preview: quantity, column, unit
    read: dict[str, tuple[str, str]] = field(default_factory=dict)
    # whether the times that were read are time stamps, not seconds since the start of the session
    stamped: bool = False

    def has(self, role: str) -> bool:
        """Whether a column or a value is named for it."""
        return role in self.mapping.columns or role in self.mapping.values

    def take_namesakes(self) -> None:
        """Take each column that is called as a quantity, with or without its unit, for that where nothing else is.

        A SessionError: there are two of them.
        """
        named = dict(self.mapping.columns)
        for column in self.table.names:
            role = name_and_unit(column)[0].lower()
            if role in ROLES[self.mapping.table] and not self.has(role):
                if role in named and named[role].column != column:
                    both = f"{named[role].column!r} and {column!r}"
                    raise SessionError(f"{self.table.source}: {role} may be {both}; say which, as in --column {role}=…")
                named[role] = ColumnRule(column=column)
        self.mapping = self.mapping.model_copy(update={"columns": named})

    @property
    def unread(self) -> list[str]:
        """Columns that were not read."""
        known = {column for column, _ in self.read.values()}
        return [] if self.mapping.transposed else [name for name in self.table.names if name and name not in known]

    def need(self, roles: Collection[str], why: str) -> None:
        """Raise a SessionError that names the first quantity that nothing is named for."""
        for role in roles:
            if not self.has(role):
                raise SessionError(
                    f"{self.table.source}: no column is named for {role} ({why}), as in --column {role}=NAME; "
                    f"the table has {', '.join(map(repr, self.table.names[:20]))}"
                )

    def number(self, role: str) -> Array:
        """(rows,) the quantity in SI, NaN where the cell is empty; a SessionError names what is wrong."""
        wanted = ROLES[self.mapping.table][role]
        if role in self.mapping.values:
            text = self.mapping.values[role]
            self.read[role] = ("(the same in every row)", text)
            return np.full(len(self.table), quantity(text, wanted, f"value of {role}"))
        rule = self.mapping.columns[role]
        if role == "time" and (stamps := self.table.stamps(rule.column, role)) is not None:
            self.read[role] = (rule.column, "time stamps")
            self.stamped = True
            return stamps
        unit = self._unit(role, rule, wanted)
        self.read[role] = (rule.column, unit)
        values = self.table.numbers(rule.column, role, unit)
        # People count runs from 1.
        return values - 1.0 if role == "repeat" and np.nanmin(values, initial=np.inf) == 1.0 else values

    def text(self, role: str) -> np.ndarray:
        """(rows,) the text of a column."""
        if role in self.mapping.values:
            self.read[role] = ("(the same in every row)", "")
            return np.full(len(self.table), self.mapping.values[role], dtype=object).astype(np.str_)
        rule = self.mapping.columns[role]
        self.read[role] = (rule.column, "")
        return self.table.text(rule.column, role)

    def unit_of(self, role: str, column: str) -> str:
        """The unit of a quantity in a column of that name."""
        return self._unit(role, ColumnRule(column=column), ROLES[self.mapping.table][role])

    def others(self, taken: Collection[str]) -> dict[str, Array]:
        """Every numeric column of a session that is named beside those taken, and the covariates of the user's own."""
        numeric = [role for role, kind in ROLES[self.mapping.table].items() if kind != "text"]
        out = {role: self.number(role) for role in numeric if role not in taken and self.has(role)}
        for name, rule in self.mapping.extras.items():
            unit = self._unit(name, rule, None)
            self.read[name] = (rule.column, unit)
            out[name] = self.table.numbers(rule.column, name, unit)
        return out

    def filled(self, role: str) -> Array:
        """(rows,) the quantity in SI, of which no row may be without: a SessionError names the empty cell."""
        values = self.number(role)
        self._refuse_empty(role, ~np.isfinite(values))
        return values

    def setups(self, default: str) -> np.ndarray:
        """(rows,) id of each row's setup."""
        if not self.has("setup"):
            return np.full(len(self.table), default)
        ids = self.text("setup")
        self._refuse_empty("setup", ids == "")
        return ids

    def _refuse_empty(self, what: str, empty: BoolArray) -> None:
        if (row := first_true(empty)) is not None:
            raise SessionError(f"{self.table.where(row)}: {what} is empty")

    def in_machine(self, positions: Mapping[str, Array]) -> dict[str, Array]:
        """Positions by axis, each (rows,) m, from the table's zero, in the machine, where it is said to be elsewhere.

        A SessionError if it is said of another axis: of one that no column has nothing is shifted.
        """
        placed = dict(positions)
        for axis, text in self.mapping.origin.items():
            if axis not in placed:
                raise SessionError(
                    f"{self.table.source}: origin names {axis}, of which there is no column of positions; what is the "
                    f"same in every row is a value, as in --value {axis}=250mm"
                )
            placed[axis] = placed[axis] + quantity(text, "length", f"origin of {axis}")
        return placed

    def _unit(self, role: str, rule: ColumnRule, wanted: str | None) -> str:
        units = self.mapping.units
        named = name_and_unit(rule.column)[1]
        given = rule.unit or units.get(role)
        differ = given is not None and named is not None and named != given and dimension(named) == dimension(given)
        if differ and not self.mapping.trusted:
            raise SessionError(
                f"{self.table.source}: the column {rule.column!r} says {named}, but {role} is given in {given}"
            )
        if given is None and named is not None and (wanted is None or dimension(named) == wanted):
            given = named
        if given is None and wanted is not None:
            given = units.get(wanted) or _NEED_NO_UNIT.get(wanted)
            if (unknown := unknown_unit(rule.column)) is not None and wanted != "number":
                raise SessionError(
                    f"{self.table.source}: the column {rule.column!r} says {unknown}, which is no unit that is known; "
                    f"say which it is, as in --unit {role}={given or 'mm'}"
                )
        if given is None and wanted is None:
            given = "1"
        if given is None:
            self.table.index(rule.column, role)  # where there is no such column, that is what is wrong
            usual = {"length": "mm", "angle": "deg", "pressure": "hPa"}.get(str(wanted), "1")
            raise SessionError(
                f"{self.table.source}: the unit of {role} (column {rule.column!r}) is not given, as in "
                f"--unit {role}={usual} or --unit {wanted}={usual}"
            )
        if wanted is not None and dimension(given) != wanted:
            raise SessionError(f"{self.table.source}: {role} is a {wanted}, and {given} is no unit of it")
        return given
