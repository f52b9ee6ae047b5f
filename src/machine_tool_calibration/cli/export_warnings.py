"""What `mtcal export` says of the model behind the tables: that it fits badly, or that a better one is known."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from machine_tool_calibration.errors import SessionError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from machine_tool_calibration.model.fit import JointFit
    from machine_tool_calibration.session.session import Session

__all__ = ["bad_fit", "unused_model"]

# Chance below which readings contradict the model, as `mtcal identify` has it.
_CHANCE = 1e-3


def bad_fit(fit: JointFit, content: Mapping[str, Any]) -> str | None:
    """The words of `mtcal identify` if the readings scatter about the model beyond chance; None otherwise.

    Args:
        fit: of all sessions.
        content: of the error map.
    """
    from machine_tool_calibration.cli.identified import verdict

    if not fit.p_value < _CHANCE:
        return None
    words = verdict({"reduced_chi_square": fit.reduced_chi_square, "p_value": fit.p_value, "error_map": content})
    return f"warning: {words}"


def unused_model(
    session: Session, path: Path, effects: Collection[str], fit: JointFit | None, *, effects_only: bool = False
) -> str | None:
    """That the session's history holds a better model than the one used, and how to use it; None if it does not.

    Args:
        session: all its readings.
        path: where it was read; the history is in it or beside it.
        effects: ids in the model that was used.
        fit: of that model; None if it is of other readings too, so that no figures can be compared.
        effects_only: whether to say how by effects, as for several sessions together.
    """
    from machine_tool_calibration.session.history_file import fingerprint, history_path, read_history

    kept = history_path(path)
    try:
        entry = read_history(kept).in_use
    except SessionError as error:
        return f"warning: {error}"
    if entry is None or entry.data != fingerprint(session):
        return None
    more = [name for name in entry.effects if name not in effects]
    aside = () if effects_only else entry.set_aside
    if not more and not aside:
        return None
    chi = entry.reduced_chi_square
    figures = ""
    if fit is not None and chi is not None:
        if chi >= fit.reduced_chi_square:
            return None
        figures = f" (chi²/ν {chi:.2f} instead of {fit.reduced_chi_square:.2f})"
    what = [", ".join(more)] if more else []
    what += [f"{len(aside)} reading{'' if len(aside) == 1 else 's'} set aside"] if aside else []
    how = " ".join(f"--effect {name}" for name in more) if effects_only else "--from-history"
    return (
        f"note: {kept} holds a better model, number {entry.number}, with {' and '.join(what)}{figures}; "
        f"it was not used: {how} does"
    )
