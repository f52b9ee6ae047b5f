"""What a diagnosis says of the model itself: coefficients found, what the map holds already, what hides effects."""

from __future__ import annotations

from collections.abc import Mapping

from machine_tool_calibration.diagnosis.consequence import Consequence
from machine_tool_calibration.diagnosis.diagnose import Diagnosis
from machine_tool_calibration.diagnosis.look import Absorbed
from machine_tool_calibration.diagnosis.quantities import quantity
from machine_tool_calibration.diagnosis.text_table import TextTable
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.model.unknown_words import POINTS, in_map, unknowns_in_words

__all__ = ["coefficients_table", "hidden_table", "in_map_table"]

# Errors of position that are not the machine's: a map that takes them up is wrong by them.
_NOT_THE_MACHINES = ("workpiece_thermal", "table_thermal_growth")


def coefficients_table(diagnosis: Diagnosis, changes: Mapping[str, Consequence]) -> TextTable:
    """Every coefficient of the effects found: what it is, and its size."""
    observations = diagnosis.fits[0].fits[0].model.observations
    known = _effects(diagnosis)
    rows = []
    for name in diagnosis.accepted:
        effect, change = known.get(name), changes.get(name)
        meanings = {} if effect is None else effect.meanings(observations)
        for p in () if change is None else change.parameters:
            size = quantity(p.value, p.unit, p.standard_uncertainty)
            rows.append((name, p.name.removeprefix(f"{name}."), meanings.get(p.name, ""), size))
    heads = ("effect", "coefficient", "what it is", "size ± U (k = 2)")
    return TextTable("What was found, coefficient by coefficient", heads, tuple(rows))


def in_map_table(diagnosis: Diagnosis) -> TextTable:
    """Errors of the machine that are part of the map already: whatever their size, nothing needs to be added."""
    title = "Errors that the map holds already, whatever their size: nothing needs to be added for them"
    return TextTable(title, ("errors", "they are part of"), _rows(diagnosis, True))


def hidden_table(diagnosis: Diagnosis) -> TextTable:
    """Effects that would not show, because an unknown of the set-up, or the map, takes their place."""
    title = "Effects that would not show here: an unknown changes the readings in the same way"
    rows = _rows(diagnosis, False)
    wrong = any(in_map(a.by.split(", ")[0]) for a in _absorbed(diagnosis, False))
    note = "taken for an error motion, a squareness or the points, they make the map wrong" if wrong else ""
    return TextTable(title, ("effects", "taken for"), rows, note)


def _rows(diagnosis: Diagnosis, of_map: bool) -> tuple[tuple[str, ...], ...]:
    by: dict[str, list[str]] = {}
    for a in _absorbed(diagnosis, of_map):
        by.setdefault(_words(a, of_map, diagnosis), []).append(a.effect)
    return tuple((", ".join(names), what) for what, names in by.items())


def _absorbed(diagnosis: Diagnosis, of_map: bool) -> list[Absorbed]:
    known, method = _effects(diagnosis), diagnosis.session.method
    return [a for a in diagnosis.look.absorbed if _of_the_map(a, known.get(a.effect), method) == of_map]


def _of_the_map(absorbed: Absorbed, effect: Effect | None, method: str) -> bool:
    """Whether what takes an effect up is the map, which is meant to say it."""
    names = absorbed.by.split(", ")
    if absorbed.effect in names:
        return True
    if effect is None or effect.kind != "position" or effect.id in _NOT_THE_MACHINES:
        return False
    # The points of a probing are those of the workpiece, whose form is not the machine's.
    return in_map(names[0]) and not (names[0] == POINTS and method == "probing")


def _words(absorbed: Absorbed, of_map: bool, diagnosis: Diagnosis) -> str:
    names = absorbed.by.split(", ")
    if absorbed.effect in names:
        return "unknowns of this model themselves"
    chosen = [name for name in names if in_map(name) or not of_map]
    if chosen == [POINTS] and diagnosis.session.method == "probing":
        return "form of the workpiece: each probed point has an error of its own"
    return unknowns_in_words(chosen, list(_effects(diagnosis)))


def _effects(diagnosis: Diagnosis) -> dict[str, Effect]:
    """All effects that were looked for."""
    return {f.name: f.candidate.effect for f in diagnosis.look.findings if f.candidate.effect is not None}
