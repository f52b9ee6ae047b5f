"""The whole story: a simulated machine hides an effect; it is measured, found out, and the error falls."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from machine_tool_calibration.cli import diagnosing
from machine_tool_calibration.cli.demo_truth import COMPARED, judged
from machine_tool_calibration.cli.measuring import bar, graph_options, show_files, show_result
from machine_tool_calibration.cli.output import console, json_option, plain, write_json
from machine_tool_calibration.cli.truth import MapError
from machine_tool_calibration.diagnosis.quantities import quantity
from machine_tool_calibration.nodes.measurement import Measured, Setting, free_folder, measure
from machine_tool_calibration.nodes.shared import procedure_file
from machine_tool_calibration.nodes.site import SiteSpec
from machine_tool_calibration.plots.pictures import draw
from machine_tool_calibration.simulation import FlawSpec
from machine_tool_calibration.simulation.flaws import find_flaw

if TYPE_CHECKING:
    from machine_tool_calibration.methods.improve import Improvement

__all__ = ["command"]

# What may be hidden with each method, with the smallest and the largest size; and what is measured.
_HIDDEN = {
    "tracking": {
        "backlash_x": (0.8e-6, 2.5e-6),
        "backlash_y": (0.8e-6, 2.5e-6),
    },
    # In the few minutes of a step diagonal its own unknowns take up what drifts; what depends on the direction shows.
    "step_diagonal": {"backlash_x": (3e-6, 6e-6), "backlash_y": (3e-6, 6e-6)},
    "rotary_axis": {"backlash_c": (5e-6, 2e-5)},
    "probing": {"backlash_y": (4e-6, 8e-6)},
    "direct": {"backlash_x": (1e-6, 4e-6)},
}
_PROCEDURES = {
    "step_diagonal": "step_diagonal",
    "rotary_axis": "rotary_axis",
    "probing": "probing_cross",
    "direct": "direct_iso230_2",
}


@dataclass(frozen=True)
class _Story:
    """What came of the demonstration.

    Attributes:
        seed: repeats it.
        hidden: effect and its size; None if nothing was hidden.
        measured: the measurement, with the first model's result.
        improvement: the loop.
        before: the first model's map against the truth.
        after: the last model's.
        pictures: files.
    """

    seed: int
    hidden: FlawSpec | None
    measured: Measured
    improvement: Improvement
    before: MapError
    after: MapError
    pictures: list[Path]


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
    method: str,
    dimension: str,
    seed: int | None,
    hide: str | None,
    output: Path | None,
    domain_id: int | None,
    namespace: str,
    as_json: bool,
) -> None:
    """Measure a simulated machine that hides a physical effect, find it out, add it, and watch the error fall.

    The whole way that a real measurement goes: the nodes of the graph are started, the machine is moved and measured,
    everything is recorded, and the errors are identified with their uncertainty. The model is found to disagree with
    the readings, the missing effect is looked for and added. Only then is told what was hidden, and the map is compared
    with the true errors, which nothing before has seen.
    """
    number = int(np.random.default_rng().integers(1_000_000)) if seed is None else seed
    hidden = _hidden(method, number, hide)
    procedure = _PROCEDURES.get(method, f"tracking_{dimension}d")
    setting = Setting(
        output=free_folder("demo", output),
        site=SiteSpec(seed=number, effects=(hidden,) if hidden else ()),
        domain=domain_id,
        namespace=namespace,
    )
    with bar() as progress:
        measured = measure(procedure_file(procedure), setting, progress)
    with diagnosing.bar() as share:
        story = _story(number, hidden, measured, share)
    if as_json:
        write_json(_document(story))
        return
    _tell(story)


def _hidden(method: str, seed: int, wanted: str | None) -> FlawSpec | None:
    """What the machine hides; the same seed hides the same."""
    rng = np.random.default_rng([seed, 1])
    sizes = _HIDDEN[method]
    if wanted == "none" or (wanted is None and not sizes):
        return None
    name = str(rng.choice(sorted(sizes))) if sizes else ""
    share = float(rng.uniform())
    if wanted is not None and wanted not in sizes:
        raise click.BadParameter(f"{wanted!r} is none of {', '.join([*sizes, 'none'])}", param_hint="--hide")
    low, high = sizes[wanted or name]
    return FlawSpec(id=wanted or name, size=low + share * (high - low))


def _story(seed: int, hidden: FlawSpec | None, measured: Measured, progress: Any) -> _Story:
    from machine_tool_calibration.methods.improve import improve
    from machine_tool_calibration.model.result import Result
    from machine_tool_calibration.plots.improve import save_improvement

    improvement = improve(measured.session, seed=seed, progress=progress)
    progress("drawing", 1.0)
    folder = measured.output / "pictures"
    folder.mkdir()
    last = plain(improvement.steps[-1].result.document())
    pictures = [*draw(measured.session, last, folder), *save_improvement(improvement, folder)]
    first, final = (improvement.steps[k].result for k in (0, -1))
    assert isinstance(first, Result) and isinstance(final, Result)  # of a single session
    before, after = judged(measured, first), judged(measured, final)
    return _Story(seed, hidden, measured, improvement, before, after, pictures)


def _tell(story: _Story) -> None:
    from machine_tool_calibration.cli.improve import show_improvement

    screen = console()
    measured = story.measured
    screen.print(
        f"[bold]1. Measured[/]: a simulated machine (seed {story.seed}), {measured.session.method.replace('_', ' ')}, "
        f"{len(measured.session.setup_ids)} setups, in {measured.seconds[0]:.1f} s altogether; the first model:"
    )
    show_result(screen, measured)
    screen.print("\n[bold]2. Diagnosed and improved[/]")
    show_improvement(screen, story.improvement)
    screen.print("\n[bold]3. The truth[/], which nothing before has seen")
    screen.print(_reveal(story), markup=False)
    _tell_map(measured.session.method, story.before, story.after, story.improvement.steps[-1].map_uncertainty)
    show_files(screen, measured, [("picture" if p.suffix == ".png" else "table", p) for p in story.pictures])


def _tell_map(method: str, before: MapError, after: MapError, stated: float | None) -> None:
    out = "mean" if method == "direct" else "shift and turn"
    own = "the axis's deviations" if method == "direct" else "the machine's own errors"
    known = stated is not None and method != "direct"
    expected = f" The last model's own uncertainty says {1e6 * (stated or 0.0):.2f} µm RMS (k = 1)." if known else ""
    console().print(
        f"The {COMPARED[method]} is off the truth by {before.rms * 1e6:.2f} µm RMS with the first model and by "
        f"{after.rms * 1e6:.2f} µm with the last ({out} taken out); {own} are {before.before * 1e6:.2f} µm RMS."
        f"{expected}\n"
    )


def _reveal(story: _Story) -> str:
    found = story.improvement.diagnosis.accepted
    if story.hidden is None:
        return "Nothing was hidden." + ("" if not found else " What was added is a false alarm.")
    said = f"Hidden was {story.hidden.id}, of size {_hidden_size(story.hidden)}."
    alike = {story.hidden.id}
    groups = story.improvement.diagnosis.look.groups
    alike |= {name for group in groups if story.hidden.id in group for name in group}
    if story.hidden.id in found:
        return f"{said} It was found."
    if alike & set(found):
        return f"{said} Found was {', '.join(found)}, which this measurement cannot tell from it."
    return f"{said} It was not found."


def _hidden_size(hidden: FlawSpec) -> str:
    """The size of what was hidden, in the units that people use."""
    return "as it usually is" if hidden.size is None else quantity(hidden.size, find_flaw(hidden.id).unit)


def _document(story: _Story) -> dict[str, Any]:
    measured = story.measured
    return {
        "format": "mtcal-demo/1",
        "seed": story.seed,
        "output": measured.output,
        "session": measured.session_folder,
        "bag": measured.bag,
        "pictures": story.pictures,
        "seconds": measured.seconds[0],
        "readings": len(measured.session.readings),
        "verdict": story.improvement.diagnosis.verdict,
        "found": story.improvement.diagnosis.accepted,
        "hidden": story.hidden.id if story.hidden else None,
        "hidden_size": story.hidden.size if story.hidden else None,
        "map_error_rms_before": story.before.rms,
        "map_error_rms": story.after.rms,
        "map_error_largest": story.after.largest,
        "machine_error_rms": story.before.before,
        "result": measured.result,
        "improved": story.improvement.steps[-1].result.document(),
    }
