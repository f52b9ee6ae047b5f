# SPDX-License-Identifier: Apache-2.0
"""For tests of what is written, and not of what it looks like or how it was found: coarse pictures, searches once."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure

from machine_tool_calibration.budget import complete
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.session.session import Session

__all__ = ["found_once", "rough_pictures"]

# Of pictures that show the same over the same, whichever test draws them.
_DRAWN: set[object] = set()


@pytest.fixture(scope="module")
def rough_pictures(few_draws: None) -> Iterator[None]:
    """Pictures are coarse, and their panels not laid out, which draws them twice and more: those of tests/plots are.

    Of those that show the same over the same, one is drawn; the files of the others are written without it.
    """

    def save(figure: Figure, file: Any, save: Callable[..., None] = Figure.savefig, **options: Any) -> None:
        panels = (
            (panel.get_title(), panel.get_xlabel(), panel.get_ylabel(), len(panel.get_children()))
            for panel in figure.axes
        )
        alike = (file.name if isinstance(file, Path) else None, *panels)
        save(Figure() if alike in _DRAWN else figure, file, **{**options, "dpi": 40})
        _DRAWN.add(alike)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "get_layout_engine", lambda figure: None)
        patch.setattr(Figure, "savefig", save)
        yield


_FOUND: dict[tuple[object, ...], Any] = {}


def _once(search: Callable[..., Any]) -> Callable[..., Any]:
    """A search that is made once for the same subject and options, whoever asks."""

    def found(subject: Any, *more: Any, progress: Callable[[str, float], None], **options: Any) -> Any:
        if isinstance(subject, FitRequest) and subject.own:
            return search(subject, *more, progress=progress, **options)
        told = sorted((name, value) for name, value in options.items() if not callable(value))
        key = (search, _same(subject), repr(more), repr(told))
        if key not in _FOUND:
            _FOUND[key] = (search(subject, *more, progress=progress, **options), subject)
        return _FOUND[key][0]

    return found


def _same(subject: Any) -> object:
    """What is equal where sessions hold the same, whatever folder they lie in."""
    if isinstance(subject, FitRequest):
        return _same(subject.sessions), repr(replace(subject, sessions=()))
    if not isinstance(subject, Session):
        return tuple(map(_same, subject)) if isinstance(subject, tuple | list) else id(subject)
    readings = subject.readings
    columns = tuple((name, values.tobytes()) for name, values in sorted(readings.columns.items()))
    return subject.description.model_dump_json(), readings.displacement.tobytes(), readings.setup.tobytes(), columns


@pytest.fixture(scope="module")
def found_once() -> Iterator[None]:
    """Diagnoses and improvements of sessions that several tests of the commands look at are calculated once."""
    with pytest.MonkeyPatch.context() as patch:
        for search in ("look_for_effects", "improve_models", "conclude_from"):
            patch.setattr(complete, search, _once(getattr(complete, search)))
        yield
