"""Measure a simulated machine with a tracking interferometer at four stations, and identify its errors."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import numpy as np

from machine_tool_calibration.cli.measuring import bar, graph_options, show_files, show_result
from machine_tool_calibration.cli.output import console, json_option, write_json
from machine_tool_calibration.cli.truth import MapError, map_error
from machine_tool_calibration.nodes.measurement import Measured, Setting, free_folder, measure
from machine_tool_calibration.nodes.shared import procedure_file
from machine_tool_calibration.nodes.site import Moment, Site, SiteSpec, read_site
from machine_tool_calibration.plots.pictures import draw

__all__ = ["command"]

_PICTURES = "machine_tool_calibration.plots.pictures"


@click.command("demo")
@click.option(
    "--dimension", type=click.Choice(["2", "3"]), default="2", show_default=True, help="A plane, or the whole volume."
)
@click.option("--seed", type=click.IntRange(min=0), help="Repeats a demonstration; drawn at random if absent.")
@graph_options
@json_option
def command(
    dimension: str, seed: int | None, output: Path | None, domain_id: int | None, namespace: str, as_json: bool
) -> None:
    """Measure a simulated machine with a tracking interferometer at four stations, and identify its errors.

    The whole way that a real measurement goes: the nodes of the graph are started, the machine is moved and measured,
    everything is recorded, the errors are identified with their uncertainty. At the end the map is compared with the
    simulated machine's true errors, which nothing before has seen.
    """
    number = int(np.random.default_rng().integers(1_000_000)) if seed is None else seed
    setting = Setting(
        output=free_folder("demo", output),
        site=SiteSpec(seed=number),
        domain=domain_id,
        namespace=namespace,
    )
    with bar() as progress:
        measured = measure(procedure_file(f"tracking_{dimension}d"), setting, progress)
        progress("drawing", len(measured.session.readings), len(measured.session.readings))
        judged = _judge(measured, int(dimension))
        pictures = draw(measured.session, measured.result or {}, measured.output)
    if as_json:
        write_json(_document(measured, judged, pictures, number))
        return
    screen = console()
    screen.print(
        f"Simulated machine, seed {number}: measured in {dimension} dimensions from "
        f"{len(measured.session.setup_ids)} stations in {measured.seconds[0]:.1f} s altogether."
    )
    show_result(screen, measured)
    screen.print(
        f"Against the simulated truth (shift and turn taken out): the map is off by {judged.rms * 1e6:.2f} µm RMS, "
        f"{judged.largest * 1e6:.2f} µm at most; the machine's own errors are {judged.before * 1e6:.2f} µm RMS."
    )
    screen.print()
    show_files(screen, measured, [("picture", path) for path in pictures])


def _judge(measured: Measured, dimension: int) -> MapError:
    """The map against the truth, which the nodes' site file holds."""
    assert measured.result is not None
    content = measured.result["error_map"]
    points = np.array(content["points"], dtype=float)
    site = Site(read_site(str(measured.output / "site.yaml")))
    full = np.zeros((len(points), 3))
    full[:, : points.shape[1]] = points
    upwards = dict.fromkeys("xyz", 1)
    actual = np.array([site.functional_point(Moment(0.0, dict(zip("xyz", row, strict=True)), upwards)) for row in full])
    identified = np.array(content["position_error"], dtype=float)[:, :dimension]
    return map_error(full[:, :dimension], identified, (actual - full)[:, :dimension])


def _document(measured: Measured, judged: MapError, pictures: list[Path], seed: int) -> dict[str, Any]:
    return {
        "format": "mtcal-demo/1",
        "seed": seed,
        "output": measured.output,
        "session": measured.session_folder,
        "bag": measured.bag,
        "pictures": pictures,
        "seconds": measured.seconds[0],
        "readings": len(measured.session.readings),
        "map_error_rms": judged.rms,
        "map_error_largest": judged.largest,
        "machine_error_rms": judged.before,
        "result": measured.result,
    }
