# SPDX-License-Identifier: Apache-2.0
"""The whole story: a simulated machine hides an effect; it is measured, found out, and the error falls."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np

from machine_tool_calibration.arrays import Array, rigid_motions, rms
from machine_tool_calibration.cli.measuring import files_table, graph_options, readings_bar, result_table
from machine_tool_calibration.cli.shared import json_option, note, progress_bar, tell_either
from machine_tool_calibration.diagnosis.improve import Improvement, improve
from machine_tool_calibration.json_types import plain
from machine_tool_calibration.model.result import Result
from machine_tool_calibration.nodes.measurement import Measured, Setting, free_folder, measure
from machine_tool_calibration.nodes.shared import procedure_file
from machine_tool_calibration.plots.diagnosis import save_improvement
from machine_tool_calibration.plots.pictures import figures
from machine_tool_calibration.plots.style import save
from machine_tool_calibration.reports.improvement import improvement_parts
from machine_tool_calibration.reports.quantities import quantity
from machine_tool_calibration.reports.tables import Part
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import FlawSpec
from machine_tool_calibration.simulation.flaws import find_flaw
from machine_tool_calibration.simulation.motions import turn
from machine_tool_calibration.simulation.site import Site, SiteSpec, read_site


@dataclass(frozen=True)
class MapError:
    """Difference of an identified map from the truth, after the datum has been taken out."""

    difference: Array  # (n, d) identified minus true position error, m
    before: float  # RMS length of the difference for a map that says that the machine has no errors, m

    @property
    def rms(self) -> float:
        """Root mean square length of the difference, m."""
        return rms(np.linalg.norm(self.difference, axis=1))

    @property
    def largest(self) -> float:
        """Greatest length of the difference, m."""
        return float(np.linalg.norm(self.difference, axis=1).max())


def map_error(points: Array, identified: Array, true: Array, free: Array | None = None) -> MapError:
    """Compare a map with the truth: position errors at points, (n, d), m; d is 2 or 3; points with NaN are left out.

    Self-calibration fixes neither where the origin of the coordinates is nor how they are turned: the rigid motion that
    fits best is taken out of both, as are further displacements `free` (k, n, d) that the measurement leaves open.
    """
    known = np.all(np.isfinite(identified), axis=1)
    points, identified, true = points[known], identified[known], true[known]
    count, d = points.shape
    # In a plane, what leaves it is nothing.
    motions = rigid_motions(np.pad(points, ((0, 0), (0, 3 - d))))[:, :d].reshape(count * d, -1)
    if free is not None:
        motions = np.hstack([motions, free[:, known].reshape(len(free), -1).T])

    def without(field: Array) -> Array:
        found = np.linalg.lstsq(motions, field.ravel(), rcond=None)[0]
        return np.asarray(field - (motions @ found).reshape(count, d))

    return MapError(without(identified - true), rms(np.linalg.norm(without(true), axis=1)))


COMPARED = {
    "tracking_interferometer": "map of the tool's position",
    "step_diagonal": "map of the tool's position along the axes",
    "probing": "map of the tool's position over the grid",
    "rotary_axis": "map of where the table carries the targets",
    "direct": "model of the axis's deviations in both directions",
}
"""What of each method is compared with the truth."""


def error_against_truth(measured: Measured, result: Result) -> MapError:
    """How far what was identified is from the truth, shift and turn taken out.

    The truth is the machine's own errors, without the hidden effect; for direct deviations, whose map says what the
    axis does from either side, with it.
    """
    true, spec = read_site(str(measured.output / "site.yaml")), spec_of(measured.session)
    if spec.reads_machine:
        return _deviations(Site(true), result)
    site = Site(true.model_copy(update={"effects": ()}))
    points, found = result.error_map.points, result.error_map.error
    if spec.turns_one_axis:
        return map_error(points, found, *_carried(site, result))
    actual = site.functional_point(site.scene(0.0, points))
    flat = spec.probes_surface or measured.session.description.axes == "xy"
    axes = slice(0, 2 if flat else 3)
    return map_error(points[:, axes], found[:, axes], (actual - points)[:, axes])


def _carried(site: Site, result: Result) -> tuple[Array, Array]:
    """(n, 3) true error of where the table carries each point of the map, m: that of an ideal turn taken off.

    And (6, n, 3) what a shift and a turn of the targets on the table would make, which cannot be distinguished from
    where the targets are.
    """
    content, points = result.error_map.content, result.error_map.points
    angles = np.asarray(content["c"], dtype=float)
    angle = np.repeat(angles, len(points) // len(angles))
    sign = float(result.fit.model.observations.session.rotation_sign)
    moment = site.scene(0.0, np.zeros((len(points), 3)), {"C": 1.0}, angle=angle)
    error = site.on_table(moment, turn(points, "C", -sign * angle)) - points
    shifts = np.stack([turn(np.tile(axis, (len(points), 1)), "C", sign * angle) for axis in np.eye(3)])
    return error, np.concatenate([shifts, np.cross(shifts, points)])


def _deviations(site: Site, result: Result) -> MapError:
    """Deviations along what each reading senses, as the model says and as they are; their mean taken out."""
    observations = result.fit.model.observations
    readings, position = observations.readings, observations.position
    approach = {axis.upper(): readings.columns[f"dir_{axis}"] for axis in "xyz" if f"dir_{axis}" in readings.columns}
    actual = site.functional_point(site.scene(readings.column("time"), position, approach))
    true = np.einsum("ni,ni->n", actual - position, observations.direction)
    found = readings.displacement - result.fit.residuals
    return MapError((found - found.mean() - (true - true.mean()))[:, None], rms(true - true.mean()))


# What may be hidden with each method, with the smallest and the largest size; and what is measured.
_HIDDEN = {
    "tracking": {"backlash_x": (0.8e-6, 2.5e-6), "backlash_y": (0.8e-6, 2.5e-6)},
    # In the few minutes of a step diagonal its own unknowns take up what drifts; what depends on the direction shows.
    "step_diagonal": {"backlash_x": (3e-6, 6e-6), "backlash_y": (3e-6, 6e-6)},
    "rotary_axis": {"backlash_c": (5e-6, 2e-5)},
    "probing": {"backlash_y": (4e-6, 8e-6)},
    "direct": {"backlash_x": (1e-6, 4e-6)},
}
_PROCEDURES = {"probing": "probing_cross", "direct": "direct_iso230_2"}


@click.command("demo")
@click.option(
    "--method",
    type=click.Choice(list(_HIDDEN)),
    default="tracking",
    show_default=True,
    help="What the machine is measured with.",
)
@click.option(
    "--dimension",
    type=click.Choice(["2", "3"]),
    default="2",
    show_default=True,
    help="Tracking interferometer: a plane, or the whole volume.",
)
@click.option("--seed", type=click.IntRange(min=0), help="Repeats a demonstration; drawn at random if absent.")
@click.option("--hide", metavar="ID", help="Effect to hide, or none; drawn at random if absent.")
@graph_options
@json_option
def command(
    method: str, dimension: str, seed: int | None, hide: str | None, output: Path | None, as_json: bool, **graph: Any
) -> None:
    """Measure a simulated machine that hides a physical effect, find it out, add it, and watch the error fall.

    The whole way that a real measurement goes: the nodes of the graph are started, the machine is moved and measured,
    everything is recorded, and the errors are identified with their uncertainty. The model is found to disagree with
    the readings, the missing effect is looked for and added. Only then is revealed what was hidden, and the map is
    compared with the true errors, which nothing before has seen.
    """
    number = int(np.random.default_rng().integers(1_000_000)) if seed is None else seed
    hidden = _hidden(method, number, hide)
    procedure = f"tracking_{dimension}d" if method == "tracking" else _PROCEDURES.get(method, method)
    site = SiteSpec(seed=number, effects=(hidden,) if hidden else ())
    setting = Setting(output=free_folder("demo", output), site=site, **graph)
    with readings_bar() as progress:
        measured = measure(procedure_file(procedure), setting, progress, note)
    with progress_bar() as share:
        improvement = improve(measured.session, progress=share)
        share("drawing", 1.0)
        folder = measured.output / "pictures"
        first, final = (improvement.steps[k].result for k in (0, -1))
        drawn = figures([measured.session], plain(final.document()))
        pictures = [*save(drawn, folder, final.provenance), *save_improvement(improvement, folder)]
        assert isinstance(first, Result) and isinstance(final, Result)  # of a single session
        before, after = error_against_truth(measured, first), error_against_truth(measured, final)
    document = {
        "format": "mtcal-demo/1",
        "seed": number,
        "output": measured.output,
        "session": measured.session_folder,
        "bag": measured.bag,
        "pictures": pictures,
        "seconds": measured.seconds[0],
        "readings": len(measured.session.readings),
        "verdict": improvement.diagnosis.verdict,
        "found": improvement.accepted,
        "hidden": hidden.id if hidden else None,
        "hidden_size": hidden.size if hidden else None,
        "map_error_rms_before": before.rms,
        "map_error_rms": after.rms,
        "map_error_largest": after.largest,
        "machine_error_rms": before.before,
        "result": measured.result,
        "improved": final.document(),
    }
    tell_either(document, _parts(document, measured, improvement), as_json)


def _hidden(method: str, seed: int, wanted: str | None) -> FlawSpec | None:
    """What the machine hides; the same seed hides the same."""
    rng = np.random.default_rng([seed, 1])
    sizes = _HIDDEN[method]
    if wanted == "none":
        return None
    name = str(rng.choice(sorted(sizes)))
    share = float(rng.uniform())
    if wanted is not None and wanted not in sizes:
        raise click.BadParameter(f"{wanted!r} is none of {', '.join([*sizes, 'none'])}", param_hint="--hide")
    low, high = sizes[wanted or name]
    return FlawSpec(id=wanted or name, size=low + share * (high - low))


def _parts(told: Mapping[str, Any], measured: Measured, improvement: Improvement) -> Iterator[Part]:
    yield (
        f"1. Measured: a simulated machine (seed {told['seed']}), {measured.session.method.replace('_', ' ')}, "
        f"{len(measured.session.setup_ids)} setups, in {measured.seconds[0]:.1f} s altogether; the first model:"
    )
    yield result_table(measured)
    yield "2. Diagnosed and improved"
    yield from improvement_parts(improvement)
    yield "3. The truth, which nothing before has seen"
    yield _truth_in_words(told, improvement)
    yield _error_in_words(told, measured.session, improvement.steps[-1].map_uncertainty)
    yield files_table(measured, [("picture" if p.suffix == ".png" else "table", p) for p in told["pictures"]])


def _error_in_words(told: Mapping[str, Any], session: Session, u: float | None) -> str:
    direct = spec_of(session).reads_machine
    out = "mean" if direct else "shift and turn"
    own = "the axis's deviations" if direct else "the machine's own errors"
    known = u is not None and not direct
    expected = f" The last model's own uncertainty says {quantity(u or 0.0, 'm')} RMS (k = 1)." if known else ""
    keys = ("map_error_rms_before", "map_error_rms", "machine_error_rms")
    before, after, size = (quantity(told[key], "m") for key in keys)
    return (
        f"The {COMPARED[session.method]} is off the truth by {before} RMS with the first model and "
        f"by {after} with the last ({out} taken out); {own} are {size} RMS.{expected}"
    )


def _truth_in_words(told: Mapping[str, Any], improvement: Improvement) -> str:
    found, hidden = improvement.accepted, told["hidden"]
    if hidden is None:
        return "Nothing was hidden." + ("" if not found else " What was added is a false alarm.")
    said = f"Hidden was {hidden}, of size {quantity(told['hidden_size'], find_flaw(hidden).unit)}."
    if hidden in found:
        return f"{said} It was found."
    if any(hidden in group and set(group) & set(found) for group in improvement.diagnosis.search.groups):
        return f"{said} Found was {', '.join(found)}, which this measurement cannot distinguish from it."
    return f"{said} It was not found."
