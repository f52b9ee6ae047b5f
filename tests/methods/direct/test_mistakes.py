# SPDX-License-Identifier: Apache-2.0
"""Places and deviations that do not belong together: the mistake is named, and nothing else is refused."""

from collections.abc import Callable
from types import ModuleType

import numpy as np
import pytest

from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.identify import identify

TURN = 8e-3
Change = Callable[[np.ndarray, np.ndarray], np.ndarray]

ACTUAL: dict[str, tuple[Change, str]] = {
    "quarter": (lambda x, y: np.column_stack([-y, x]), "turned by 90 degrees"),
    "quarter back": (lambda x, y: np.column_stack([y, -x]), "turned by -90 degrees"),
    "half": (lambda x, y: np.column_stack([-x, -y]), "turned by 180 degrees"),
    "mirror": (lambda x, y: np.column_stack([-x, y]), "the sign of x is reversed"),
    "mirror of y": (lambda x, y: np.column_stack([x, -y]), "the sign of y is reversed"),
    "exchanged": (lambda x, y: np.column_stack([y, x]), "x and y of the actual places look exchanged"),
}


@pytest.mark.parametrize("kind", list(ACTUAL))
def test_part_that_lies_otherwise(plates: ModuleType, kind: str) -> None:
    change, words = ACTUAL[kind]
    session, _ = plates.plate(1, holes=100)
    place = session.readings.position()[::2, :2]
    actual = place + session.readings.displacement.reshape(-1, 2)
    moved = change(actual[:, 0], actual[:, 1]) - place
    with pytest.raises(ModelError, match=words) as caught:
        identify(plates.with_columns(session, moved.reshape(-1)))
    assert "\n" not in str(caught.value)


def test_columns_exchanged_and_signs_reversed(plates: ModuleType) -> None:
    session, _ = plates.plate(1, holes=100, turn=TURN)
    columns = session.readings.columns
    identify(session)
    with pytest.raises(ModelError, match="x and y look exchanged"):
        identify(plates.with_columns(session, x=columns["y"], y=columns["x"]))
    with pytest.raises(ModelError, match="x and y look exchanged"):
        identify(plates.with_columns(session, gx=columns["gy"], gy=columns["gx"]))
    flipped = np.where(columns["gy"] > 0.5, -1.0, 1.0) * session.readings.displacement
    with pytest.raises(ModelError, match="along x or along y looks reversed"):
        identify(plates.with_columns(session, flipped))


def test_places_in_millimetres(plates: ModuleType) -> None:
    session, _ = plates.plate(1, holes=100)
    columns = session.readings.columns
    with pytest.raises(ModelError, match="x, y and z look like millimetres"):
        identify(plates.with_columns(session, x=1e3 * columns["x"], y=1e3 * columns["y"]))


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "millimetres"), (1e6, "micrometres")])
def test_deviations_in_another_unit(plates: ModuleType, factor: float, unit: str) -> None:
    for seed in range(6):
        turn = (0.0, 1e-3, 2e-2)[seed % 3]
        part, _ = plates.plate(seed, holes=60, drilled=2e-5, scales=(1e-4, 2e-4), turn=turn, far=2)
        for session in (part, plates.axis(seed, wander=2e-5, scale=1e-4)):
            identify(session)
            with pytest.raises(ModelError, match=unit):
                identify(plates.with_columns(session, factor * session.readings.displacement))


def test_a_short_axis_may_be_off_by_a_hundredth_of_its_travel(plates: ModuleType) -> None:
    """A stage of 8 mm whose deviations are tens of micrometres is bad, and no mistake."""
    identify(plates.axis(1, positions=5, length=8e-3, noise=4e-5))


def test_a_bad_machine_and_a_part_askew_are_not_refused(plates: ModuleType) -> None:
    for seed in range(12):
        turn = (0.0, 1e-3, 1e-2, 5e-2)[seed % 4]
        session, _ = plates.plate(seed, holes=80, scales=(2e-3, -1e-3), square=1.5e-3, turn=turn, drilled=5e-5)
        identify(session)


def test_a_cloud_that_follows_no_place_is_no_part_that_lies_otherwise(plates: ModuleType) -> None:
    """Scatter of a third of the plate, a fifth of it along the places: nobody can say how it lies."""
    session, _ = plates.plate(1, holes=100)
    x, y = session.readings.position()[::2, :2].T
    noise = 0.2 * np.random.default_rng(3).normal(size=(len(x), 2))
    spoilt = plates.with_columns(session, (np.column_stack([-y - x, x - y]) * 0.2 + noise).reshape(-1))
    with pytest.raises(ModelError) as caught:
        identify(spoilt)
    assert "degrees" not in str(caught.value) and "reversed" not in str(caught.value)
