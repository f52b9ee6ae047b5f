# SPDX-License-Identifier: Apache-2.0
"""The pictures of a result, whatever the method."""

from collections.abc import Mapping, Sequence
from typing import Any

from machine_tool_calibration.plots.direct import standard_figures
from machine_tool_calibration.plots.error_map import draw_map, draw_tables
from machine_tool_calibration.plots.style import Figure
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.session.method import load
from machine_tool_calibration.session.session import Session


def figures(sessions: Sequence[Session], result: Mapping[str, Any]) -> dict[str, Figure]:
    """The pictures of a result document by name.

    Of one session those that its method has; of several, or where the method has none of its own, the map and the
    tables of error motions, where there are any.
    """
    own = spec_of(sessions[0]).pictures if len(sessions) == 1 else None
    if own is not None:
        return dict(load(own).figures(sessions[0], result))
    content = result.get("error_map") or {}
    mapped = content.get("points") and content.get("position_error")
    motions = draw_tables(result.get("parameters", ()))
    drawn = {"error_map": draw_map(content) if mapped else None, "error_motions": motions}
    return {name: figure for name, figure in drawn.items() if figure is not None} | standard_figures(content)
