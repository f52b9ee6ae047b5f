# SPDX-License-Identifier: Apache-2.0
"""When the model that takes no axes for rigid is recommended."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from machine_tool_calibration.reports.goodness import free_words, vague_words

from ..told import keys


def test_along_one_axis_the_free_model_is_told_where_places_outnumber_the_nodes() -> None:
    points = [[0.001 * k, 0.0, 0.0] for k in range(300)]
    content = {"points": points, "tables": {"EZX": {"nodes": points[::15], "value_u": 20 * [1e-6]}}, "scatter": None}
    document = {"method": "direct", "model": "rigid_body", "used": 600, "p_value": 1e-12, "error_map": content}
    (text,) = free_words(document)
    assert keys(text) == ["fit.free_nodes"] and "20 nodes" in text and "300 places" in text
    # A single reading for each place leaves nothing to tell by.
    assert not list(free_words({**document, "used": 300}))
    # Each place that was approached from either side stands twice in a map.
    every = {**content, "points": points[:20] * 2}
    assert not list(free_words({**document, "error_map": every}))
    assert not list(free_words({**document, "p_value": 0.5}))
    wide = {**content, "points": [*points, [0.0, 0.1, 0.0]]}
    assert keys(next(free_words({**document, "error_map": wide}))) == ["fit.free"]
    # Each axis moved once, and there is a value for each place.
    once = {**content, "points": [[0.1, 0.0, 0.0], [0.0, 0.1, 0.0]], "tables": {"EXX": {"value_u": [0.0, 1e-6, 1e-6]}}}
    assert not list(free_words({**document, "error_map": once}))


@pytest.mark.parametrize(
    ("u", "sigma", "told"),
    [
        (4e-4, 1e-6, []),
        (2.15e-2, 1e-6, ["43.0 mm"]),
        (2.15e-2, 4e-3, ["43.0 mm"]),
        (2.15e-2, 2e-2, []),
        (np.nan, 1e-6, []),
    ],
)
def test_a_map_with_an_uncertainty_of_the_size_of_a_machine_is_said_to_be_hardly_determined(
    u: float, sigma: float, told: list[str]
) -> None:
    """And not where it is that of a coarse instrument, of which single readings scatter as much."""
    assembly = SimpleNamespace(models=[SimpleNamespace(sigma=np.array([1e-6, sigma]))])
    fit: Any = SimpleNamespace(birge_ratio=1.2, assembly=assembly)
    content = {"points": [[0.0, 0.0], [0.4, 0.3]], "position_error_u": [[1e-6, None], [u, 2e-6]]}
    words = list(vague_words(content, fit))
    assert [size for size in told if f"up to {size}, of places 400 mm apart" in words[0]] == told
    assert len(words) == len(told) and not list(vague_words({}, fit))
