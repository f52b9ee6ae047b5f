# SPDX-License-Identifier: Apache-2.0
"""Physical effects: the catalogue, and effects of the user's own by formula."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from machine_tool_calibration.effects.effect import Effect as PhysicalEffect
from machine_tool_calibration.effects.formula import FormulaEffect, read_effects
from machine_tool_calibration.interface.show import own_effects_of

Range = tuple[str, float, float] | Mapping[str, Any]
"""Of an unknown: unit, smallest and largest plausible value; or a mapping with `unit`, `low`, `high`, `meaning`."""


class Effect(FormulaEffect):
    """An effect of the user's own, by its formula.

    A creep that dies away, for which to look beside the catalogue, or which to have in the model at once::

        creep = mtcal.Effect(
            "creep_y", "b * dir_y * exp(-time / tau)", enters="y",
            coefficients={"b": ("m", -2e-5, 2e-5)}, shapes={"tau": ("s", 100.0, 1e4)},
        )
        fit = mtcal.identify(session, own=[creep])
        fit = mtcal.identify(session, effects=[creep])

    The formula is parsed and never run as Python.
    """

    def __init__(
        self,
        id: str,
        formula: str,
        *,
        enters: str,
        coefficients: Mapping[str, Range],
        shapes: Mapping[str, Range] | None = None,
        title: str = "",
        columns: Mapping[str, str] | None = None,
        constants: Mapping[str, Mapping[str, Any]] | None = None,
        source: str = "the user's own formula",
    ) -> None:
        """Check the formula.

        Args:
            id: letters, digits, `_`; not one of the catalogue.
            formula: numbers, names, `+ - * / ** ^ ( )`, `sin cos tan exp log sqrt abs sign`; m, or rad. Names that
                are neither coefficients nor constants are columns of the session, or `path` and `pi`.
            enters: `x`, `y`, `z`: a displacement of that axis; `reading`: the reading itself; `ECX`, `EBC` …: that
                error motion by ISO 230-1 of a linear or of the rotary axis, with its lever arm (a rotation in rad).
            coefficients: unknowns that the formula is linear in, with unit (SI) and plausible range.
            shapes: at most one unknown that it is not linear in, likewise.
            title: in a few words.
            columns: units of columns of your own, if they shall be checked.
            constants: known numbers, `{"k0": {"value": 2.5, "unit": "1/s"}}`.
            source: where it is described.

        Raises:
            ModelError: the formula cannot be parsed, is not linear in its coefficients, or its units do not fit.
        """
        definition: dict[str, Any] = {"id": id, "title": title, "enters": enters, "formula": formula, "source": source}
        definition |= {"coefficients": _ranges(coefficients), "shapes": _ranges(shapes or {})}
        definition |= {"columns": columns or {}, "constants": _ranges(constants or {})}
        super().__init__(definition, f"effect {id}")

    def __repr__(self) -> str:
        return f"<Effect {self.id}: {self.formula}>"

    @staticmethod
    def read(path: str | os.PathLike[str]) -> list[PhysicalEffect]:
        """Effects from a YAML file, as for `--effects-file`.

        Raises:
            ModelError: not such a file, or a wrong definition; one line that says what and where.
        """
        return read_effects(Path(path))


def _ranges(given: Any) -> Any:
    # What is no mapping is for the check to name.
    return {name: _range(said) for name, said in given.items()} if isinstance(given, Mapping) else given


def _range(said: Any) -> Any:
    if isinstance(said, tuple | list) and len(said) == 3:
        return dict(zip(("unit", "low", "high"), said, strict=True))
    # What is neither is for the check to name.
    return dict(said) if isinstance(said, Mapping) else said


def catalogue(own: Sequence[PhysicalEffect] = ()) -> pd.DataFrame:
    """The physical effects that can be looked for, simulated and added, one a row by id.

    Args:
        own: effects of the user's own, listed too.

    Returns:
        Texts in the columns `title`, `formula`, `enters` (`position` if it displaces the functional point, `reading` if
        it changes the reading itself) and `source`; tuples of texts in `coefficients` (name and SI unit of each),
        `needs` (columns of the session), `methods` and `instruments` (in which it can act; all where empty).

    Raises:
        ModelError: one of the user's own has the id of another effect.
    """
    from machine_tool_calibration.effects.catalogue import catalogue as every_effect

    rows = [
        {
            "id": effect.id,
            "title": effect.title,
            "formula": effect.formula,
            "enters": effect.kind,
            "coefficients": tuple(f"{one.name} ({one.unit})" for one in (*effect.coefficients, *effect.shapes)),
            "needs": tuple(effect.needs),
            "methods": tuple(effect.methods),
            "instruments": tuple(effect.instruments),
            "source": effect.source,
        }
        for effect in every_effect(own_effects_of(own)).values()
    ]
    return pd.DataFrame(rows).set_index("id")
