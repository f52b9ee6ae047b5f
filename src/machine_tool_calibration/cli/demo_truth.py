"""A demonstration's map against what is true of its simulated machine, for every method."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.cli.truth import MapError, map_error
from machine_tool_calibration.model.result import Result
from machine_tool_calibration.nodes.measurement import Measured
from machine_tool_calibration.nodes.site import Moment, Site, read_site

__all__ = ["COMPARED", "judged"]

COMPARED = {
    "tracking_interferometer": "map of the tool's position",
    "step_diagonal": "map of the tool's position along the axes",
    "probing": "map of the tool's position over the grid",
    "rotary_axis": "map of where the table carries the targets",
    "direct": "model of the axis's deviations in both directions",
}
"""What of each method is compared with the truth."""


def judged(measured: Measured, result: Result) -> MapError:
    """How far what was identified is from the truth, shift and turn taken out.

    The truth is the machine's own errors, without the hidden effect; for direct deviations, whose map says what the
    axis does from either side, with it.
    """
    spec = read_site(str(measured.output / "site.yaml"))
    method = measured.session.method
    if method == "direct":
        return _deviations(Site(spec), result)
    site = Site(spec.model_copy(update={"effects": ()}))
    points, found = result.error_map.points, result.error_map.error
    if method == "rotary_axis":
        return map_error(points, found, *_carried(site, result))
    flat = method == "probing" or getattr(measured.session.description, "dimension", 3) == 2
    axes = slice(0, 2 if flat else 3)
    return map_error(points[:, axes], found[:, axes], _positions(site, points)[:, axes])


def _positions(site: Site, points: Array) -> Array:
    """(n, 3) true error of the tool's position at commanded points, m."""
    upwards = dict.fromkeys("xyz", 1)
    rows = [dict(zip("xyz", (float(v) for v in row), strict=True)) for row in points]
    return np.asarray(np.array([site.functional_point(Moment(0.0, row, upwards)) for row in rows]) - points)


def _carried(site: Site, result: Result) -> tuple[Array, Array]:
    """Where the table carries each point of the map.

    Returns:
        (n, 3) its true error, m: that of an ideal turn taken off; and (6, n, 3) what a shift and a turn of the targets
        on the table would make, which cannot be told from where the targets are.
    """
    content, points = result.error_map.content, result.error_map.points
    angles = np.asarray(content["c"], dtype=float)
    sign = float(result.fit.model.observations.session.rotation_sign)
    out, free = np.zeros_like(points), np.zeros((6, *points.shape))
    of_point = np.repeat(angles, len(points) // len(angles))
    for c in angles:
        origin, turn = site.table(Moment(0.0, {"c": float(c)}, {"c": 1}))
        cosine, sine = np.cos(sign * c), np.sin(sign * c)
        ideal = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        mine = of_point == c
        out[mine] = points[mine] @ (turn @ ideal.T - np.eye(3)).T + origin
        for j in range(3):
            free[j, mine] = ideal[:, j]
            free[3 + j, mine] = np.cross(ideal[:, j], points[mine])
    return out, free


def _deviations(site: Site, result: Result) -> MapError:
    """Deviations along what each reading senses, as the model says and as they are; their mean taken out."""
    observations = result.fit.model.observations
    readings, names = observations.readings, "xyz"
    true = []
    for k, position in enumerate(observations.position):
        commanded = dict(zip(names, (float(v) for v in position), strict=True))
        approach = {a: int(readings.columns[f"dir_{a}"][k]) for a in names if f"dir_{a}" in readings.columns}
        moment = Moment(float(readings.column("time")[k]), commanded, dict.fromkeys(names, 1) | approach)
        true.append((site.functional_point(moment) - position) @ observations.direction[k])
    actual = np.array(true) - np.mean(true)
    found = readings.displacement - result.fit.residuals
    difference = (found - found.mean() - actual)[:, None]
    return MapError(
        difference=difference,
        rms=float(np.sqrt(np.mean(difference**2))),
        largest=float(np.abs(difference).max()),
        before=float(np.sqrt(np.mean(actual**2))),
    )
