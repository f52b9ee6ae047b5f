# SPDX-License-Identifier: Apache-2.0
"""For tests of what is written, and not of what it looks like or how it was found: coarse pictures, searches once."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure

from machine_tool_calibration.budget import complete
from machine_tool_calibration.diagnosis import improve
from machine_tool_calibration.interface import identification
from machine_tool_calibration.methods.fitted import FitRequest, FittedSessions
from machine_tool_calibration.report import evaluation
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

    def found(subject: Any, *more: Any, **options: Any) -> Any:
        if isinstance(subject, FitRequest) and subject.own:
            return search(subject, *more, **options)
        told = sorted((name, value) for name, value in options.items() if not callable(value))
        key = (search, _same(subject), repr(more), repr(told))
        if key not in _FOUND:
            _FOUND[key] = (search(subject, *more, **options), subject)
        return _FOUND[key][0]

    return found


def _same(subject: Any) -> object:
    """What is equal where sessions hold the same, whatever folder they lie in."""
    if isinstance(subject, FitRequest):
        return _same(subject.sessions), repr(replace(subject, sessions=()))
    if isinstance(subject, FittedSessions):
        joint = subject.joint
        sessions = tuple(fit.model.observations.session for fit in joint.fits)
        # the numbers, for effects of one name are not always the same
        fitted = (joint.solution.theta.tobytes(), joint.solution.covariance.tobytes())
        return _same(sessions), repr(joint.assembly.labels), subject.model_names, subject.effects, fitted
    if not isinstance(subject, Session):
        return tuple(map(_same, subject)) if isinstance(subject, tuple | list) else id(subject)
    readings = subject.readings
    every = {**readings.columns, **readings.labels}
    columns = tuple((name, repr(values.tolist())) for name, values in sorted(every.items()))
    own = (readings.displacement, readings.setup, readings.repeat, readings.row)
    first = None if subject.recorded is None else _same(subject.recorded)
    numbers = tuple(values.tobytes() for values in own)
    return subject.description.model_dump_json(), numbers, columns, subject.sound, first


@pytest.fixture(scope="module")
def found_once() -> Iterator[None]:
    """Diagnoses, improvements and budgets of what several tests look at are calculated once, whoever asks for them."""
    with pytest.MonkeyPatch.context() as patch:
        for room, searches in (
            (complete, ("look_for_effects", "improve_models", "consequences", "what_to_measure", "propagate")),
            (improve, ("diagnose",)),
            (identification, ("diagnose", "propagate")),
            (evaluation, ("improve", "propagate")),
        ):
            for search in searches:
                patch.setattr(room, search, _once(getattr(room, search)))
        yield
