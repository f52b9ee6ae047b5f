# SPDX-License-Identifier: Apache-2.0
"""What is known after further measurements: as exact as the counting of readings allows."""

import numpy as np
import pytest

from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.planning.options import further_options
from machine_tool_calibration.planning.outlook import outlooks

REPEATS = 5


@pytest.mark.usefixtures("reproducible")
def test_one_more_run_of_an_axis_counts_as_one_more_reading_of_each_place(simulated) -> None:
    """And what tells as much as another that costs less, a wait for another temperature say, is not named."""
    session = simulated("iso230_2")
    result = identify(session)
    now, *then = outlooks(FitRequest((session,)), result)
    assert now.words == "" and now.seconds is None and len(now.places) == 0
    np.testing.assert_array_equal(now.uncertainty, result.error_map.uncertainty)
    efforts = [option.effort for option in further_options(session)]
    (again,) = then
    assert len(efforts) > 2 and again.seconds == min(efforts) < max(efforts)
    assert not again.aside and len(again.places) == 22 and np.isnan(again.session.readings.displacement).all()
    np.testing.assert_array_equal(again.places[:11, 0], np.unique(session.readings.columns["x"]))
    np.testing.assert_allclose(
        again.uncertainty[:, 0], now.uncertainty[:, 0] * np.sqrt(REPEATS / (REPEATS + 1)), rtol=1e-6
    )


def test_another_station_is_judged_by_where_it_stands(simulated) -> None:
    """The best first; readings of a perfect machine do not pull the geometry on which the uncertainty rests."""
    session = simulated("tracking_2d")
    now, *then = outlooks(FitRequest((session,)), identify(session))
    sizes = [one.typical for one in then]
    assert len(then) >= 3 and sizes == sorted(sizes) and sizes[-1] < now.typical
    # Two repetitions become three, of stations that are set up anew: between what that is to noise, and no gain.
    assert np.sqrt(2 / 3) * now.typical - 1e-9 < then[0].typical < 0.9 * now.typical
    stations = [one for one in then if one.words.startswith("measure once from one more station")]
    assert stations and all(len(one.places) == 36 and one.seconds == 144.0 for one in stations)
