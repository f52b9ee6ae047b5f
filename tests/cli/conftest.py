# SPDX-License-Identifier: Apache-2.0
"""A session that several commands improve."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from machine_tool_calibration.budget import complete
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.session.folder import write_session
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate


@pytest.fixture(scope="module", autouse=True)
def coarse(rough_pictures: None) -> None:
    """What the pictures look like is seen in tests/plots."""


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


@pytest.fixture(scope="session")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With backlash that is hidden in it; to be copied, not changed."""
    return _with_backlash(tmp_path_factory.mktemp("improve") / "cube", 77, 1.5e-6)


@pytest.fixture(scope="session")
def backlash(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With more backlash of Y; to be copied, not changed."""
    return _with_backlash(tmp_path_factory.mktemp("backlash") / "plane", 4, 2e-6)


def _with_backlash(folder: Path, seed: int, size: float) -> Path:
    spec = SimulationSpec(plan=PRESETS["tracking_2d"], seed=seed, effects=(FlawSpec(id="backlash_y", size=size),))
    write_session(simulate(spec).session, folder)
    return folder
