"""What `mtcal identify` tells people: the result document in words, micrometres and microradians."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from machine_tool_calibration.cli.diagnosing import show_table
from machine_tool_calibration.cli.direct_words import direct_tables, scatter_words
from machine_tool_calibration.cli.figures import figures
from machine_tool_calibration.diagnosis.quantities import spread_words
from machine_tool_calibration.diagnosis.text_table import TextTable
from machine_tool_calibration.model.unknown_words import unknown_in_words

if TYPE_CHECKING:
    from rich.console import Console

    from machine_tool_calibration.effects.effect import Effect
    from machine_tool_calibration.model.fit import JointFit
    from machine_tool_calibration.session.session import Session

__all__ = ["grouped", "meanings", "measured", "show_result", "shown", "verdict"]

_MOST_ROWS = 40
_MOST_NAMES = 8
_TABLE = re.compile(r"((?:.*[./])?E[XYZABC][XYZABC])\((.+)\)")
_UNITS = {"m": (1e6, "µm"), "rad": (1e6, "µrad"), "m/s": (3.6e9, "µm/h"), "rad/s": (3.6e9, "µrad/h")}
_PLACE = re.compile(r".*\.([xyz]|dead_path)")


def meanings(fit: JointFit, ids: Sequence[str], own: Sequence[Effect]) -> dict[str, str]:
    """What the coefficients of the effects in the model are, by the name under which each is published."""
    from machine_tool_calibration.effects.catalogue import find_effects

    out = {}
    for index, model in enumerate(fit.assembly.models):
        parameters = {p.name: p for p in model.parameters}
        for effect in find_effects(ids, own):
            for name, what in effect.meanings(model.observations).items():
                if name in parameters:
                    out[fit.assembly.published(index, parameters[name])] = what
    return out


def show_result(
    screen: Console, document: Mapping[str, Any], opened: Iterable[Session], meanings: Mapping[str, str] | None = None
) -> None:
    """Print a result document.

    Args:
        screen: where.
        document: of the result.
        opened: the sessions that were identified.
        meanings: what coefficients of effects are, by name.
    """
    from rich.table import Table

    for session in opened:
        screen.print(measured(session))
    if document["effects"]:
        screen.print(f"model: {_variants(document)} with {', '.join(document['effects'])}")
    if document["averaged_over"]:
        over = (f"{' + '.join(one['effects'])} ({one['probability']:.2f})" for one in document["averaged_over"])
        screen.print(f"The map is the mean over effects that these readings do not tell apart: {', '.join(over)}.")
    screen.print(verdict(document))
    for words in spread_words(document["spread"]):
        screen.print(words)
    table = Table(show_header=False, box=None, pad_edge=False)
    for name, text in figures({**document, "not_determined": []}):
        table.add_row(name, text)
    screen.print(table)
    for shown_of_direct in direct_tables(document["error_map"]):
        if isinstance(shown_of_direct, TextTable):
            show_table(screen, shown_of_direct)
        else:
            screen.print(shown_of_direct)
    if "agreement" in document:
        screen.print(document["agreement"]["statement"])
    for reason, rows in grouped((str(entry["row"]), entry["reason"]) for entry in document["rejected"]):
        screen.print(f"not used: {'rows' if ',' in rows else 'row'} {rows} (the first row is 0): {reason}")
    _show_parameters(screen, document, meanings or {})
    for why, names in grouped((entry["name"], entry["why"]) for entry in document["not_determined"]):
        screen.print(f"not determined: {names}: {why}")
    screen.print(f"datum: {document['datum']}")


def _variants(document: Mapping[str, Any]) -> str:
    """The method's variant, of several sessions each with its label."""
    if "sessions" not in document:
        return str(document["model"])
    return ", ".join(f"{entry['model']} ({entry['label']})" for entry in document["sessions"])


def measured(session: Session) -> str:
    """What was measured, in one line."""
    ids = session.setup_ids
    names = ", ".join(ids[:_MOST_NAMES]) + (" …" if len(ids) > _MOST_NAMES else "")
    description = session.description
    kind = session.method.replace("_", " ")
    if session.method == "tracking_interferometer":
        pointing = "following the target" if description.pointing == "tracking" else "pointed open loop"  # type: ignore[union-attr]
        kind += f" in {description.dimension} dimensions, {pointing}"  # type: ignore[union-attr]
    repeats = len(np.unique(session.readings.repeat))
    return (
        f"{kind}: {len(session.readings)} readings in {len(ids)} setup{'s' if len(ids) > 1 else ''} ({names}), "
        f"{repeats} repeat{'s' if repeats > 1 else ''}, declared standard uncertainty {session.sigma * 1e6:.3g} µm"
    )


def verdict(document: Mapping[str, Any]) -> str:
    """How well the model fits, in plain words."""
    chi, p = document["reduced_chi_square"], document["p_value"]
    direct = scatter_words(document.get("error_map") or {}, p)
    if direct is not None:
        return direct
    ratio = chi**0.5
    if p < 1e-3:
        return (
            f"The readings scatter {ratio:.1f} times their declared uncertainty about the model "
            f"(p {'< 1e-12' if p < 1e-12 else f'= {p:.1g}'}): something is missing in it, or the declared uncertainty "
            "is too small. `mtcal diagnose` looks for it."
        )
    if p > 1 - 1e-3:
        return f"The readings scatter only {ratio:.2f} times their declared uncertainty: it is stated too large."
    if p < 0.05:
        return (
            f"The model fits the readings nearly within their declared uncertainty (p = {p:.2g}): something small may "
            "be missing in it. `mtcal diagnose` looks for it."
        )
    return f"The model fits the readings within their declared uncertainty (p = {p:.2g})."


def grouped(entries: Iterable[tuple[str, str]]) -> list[tuple[str, str]]:
    """From (name, reason) to each reason with the names that share it, the first ones by name."""
    names: dict[str, list[str]] = {}
    for name, reason in entries:
        names.setdefault(reason, []).append(name)
    return [
        (
            reason,
            ", ".join(own[:_MOST_NAMES]) + (f" and {len(own) - _MOST_NAMES} more" if len(own) > _MOST_NAMES else ""),
        )
        for reason, own in names.items()
    ]


def _show_parameters(screen: Console, document: Mapping[str, Any], meanings: Mapping[str, str]) -> None:
    single = [entry for entry in document["parameters"] if not _TABLE.fullmatch(entry["name"])]
    effects = document["effects"]
    added = tuple(f"{effect}." for effect in effects)
    labels = tuple(f"{entry['label']}/" for entry in document.get("sessions", ()))

    def is_added(name: str) -> bool:
        # An effect of which each session has its own carries the session's label.
        bare = next((name.removeprefix(label) for label in labels if name.startswith(label)), name)
        return bool(added) and bare.startswith(added)

    # Effects first, then what is of the machine (squareness), then what is of the setups.
    single.sort(key=lambda entry: 0 if is_added(entry["name"]) else 1 + ("." in entry["name"]))
    rows = []
    for entry in single[:_MOST_ROWS]:
        name = entry["name"]
        place = _PLACE.fullmatch(name) is not None
        what = meanings.get(name) or unknown_in_words(name, effects)
        texts = shown(entry["value"], entry["standard_uncertainty"], entry["unit"], place)
        rows.append((name, *texts, "" if what == name else what))
    if rows:
        left = len(single) - len(rows)
        note = f"{left} more; --json gives all of them" if left else ""
        heads = ("name", "value", "u (k = 1)", "U (k = 2)", "unit", "what it is")
        show_table(screen, TextTable("Parameters", heads, tuple(rows), note))
    _show_tables(screen, document)


def _show_tables(screen: Console, document: Mapping[str, Any]) -> None:
    """Each table of an error motion in one row; none of what is not determined."""
    lost = {entry["name"] for entry in document["not_determined"]}
    tables: dict[str, list[Mapping[str, Any]]] = {}
    for entry in document["parameters"]:
        match = _TABLE.fullmatch(entry["name"])
        if match is not None and match[1].removeprefix("angle.") not in lost:
            tables.setdefault(match[1], []).append(entry)
    rows = []
    for name, own in tables.items():
        value, u = (1e6 * np.array([entry[key] for entry in own]) for key in ("value", "standard_uncertainty"))
        unit = "µrad" if own[0]["unit"] == "rad" else "µm"
        most = 2.0 * float(u.max())
        places = _places(most) if 1e-6 < most < 1e9 else 2
        texts = (_fixed(float(number), places) for number in (value.min(), value.max(), most))
        rows.append((name, str(len(own)), *texts, unit))
    if rows:
        heads = ("name", "values", "smallest", "largest", "U (k = 2) at most", "unit")
        show_table(screen, TextTable("Error motions", heads, tuple(rows), "--json gives every value"))


def shown(value: float, uncertainty: float, unit: str, place: bool = False) -> tuple[str, str, str, str]:
    """Value, u and U with as many digits as the uncertainty bears, and the unit that people use; a place is in mm."""
    factor, name = _UNITS.get(unit, (1.0, unit))
    if unit == "1" and max(abs(value), uncertainty) < 1e-3:
        factor, name = 1e6, "µm/m"
    if unit == "m" and (place or abs(value) > 1e-2):
        factor, name = 1e3, "mm"
    u = uncertainty * factor
    if 1e-9 < u < 1e7 and abs(value * factor) < 1e9:
        texts = tuple(_fixed(number, _places(u)) for number in (value * factor, u, 2 * u))
    else:
        texts = (f"{value * factor:.5g}", f"{u:.2g}", f"{2 * u:.2g}")
    return texts[0], texts[1], texts[2], "" if name == "1" else name


def _places(uncertainty: float) -> int:
    """Decimals that leave an uncertainty two figures."""
    return max(0, 1 - int(np.floor(np.log10(uncertainty))))


def _fixed(number: float, places: int) -> str:
    """So many decimals, and no minus sign before a zero."""
    return f"{round(number, places) + 0.0:.{places}f}"
