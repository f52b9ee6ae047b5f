# SPDX-License-Identifier: Apache-2.0
"""Where a pointer's rotation centre and zero angle are, as tables, as lines to put into files, and as a document."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from machine_tool_calibration.coverage import K
from machine_tool_calibration.methods.tracking.pointer_alignment import Centre, ZeroAngle
from machine_tool_calibration.reports.quantities import micrometres, quantity
from machine_tool_calibration.reports.tables import Part, TextTable, Typed
from machine_tool_calibration.words import named, say


def alignment_parts(centre: Centre | None, zero: ZeroAngle | None, setup: str) -> Iterator[Part]:
    """What was found, who contributes what to its uncertainty, and the lines to put into files."""
    if centre is not None:
        yield _centre_table(centre)
        offset = ", ".join(f"{name} {quantity(float(v), 'm')}" for name, v in zip("xy", centre.offset, strict=True))
        radial, scatter = quantity(centre.radial, "m"), quantity(centre.scatter, "m")
        yield say("pointer.beside", offset=offset, radial=radial, scatter=scatter)
        if "positioning error of the machine" not in centre.contributions:
            yield say("pointer.no_machine")
    if zero is not None:
        offset, scatter = quantity(zero.offset, "rad", zero.u), quantity(zero.scatter, "m")
        yield say("pointer.zero", offset=offset, scatter=scatter)
    yield ""
    yield from map(Typed, _alignment_lines(centre, zero, setup))


def _centre_table(centre: Centre) -> TextTable:
    rows: list[tuple[str, ...]] = [(say("pointer.centre"), *(f"{1e3 * v:.6f} mm" for v in centre.centre), "")]
    rows += [
        (named("contributor", name), *(micrometres(float(v)) for v in u), "µm")
        for name, u in centre.contributions.items()
    ]
    rows.append((say("pointer.combined"), *(micrometres(float(v)) for v in centre.u), "µm"))
    rows.append((say("pointer.expanded"), *(micrometres(K * float(v)) for v in centre.u), "µm"))
    return TextTable(say("pointer.title"), ("", "x", "y", ""), tuple(rows))


def _alignment_lines(centre: Centre | None, zero: ZeroAngle | None, setup: str) -> Iterator[str]:
    """YAML for the session's setup, and for the pointer of a simulated workshop."""
    if centre is not None:
        x, y = (float(v) for v in centre.centre)
        yield "# session.yaml, or session of a procedure; z is not determined: the height of the beam"
        yield "setups:"
        u = float(np.max(centre.u))
        yield f"- {{id: {setup}, position: [{x:.8f}, {y:.8f}, 0.0], position_uncertainty: {u:.3e}}}"
    if zero is not None:
        yield f"# A real pointer: command every azimuth less by {1e6 * zero.offset:+.3f} µrad, or turn its zero."
        yield "# A simulated one, site file:"
        yield "pointer:"
        yield f"  zero_offset: {zero.offset:.9f}"


def alignment_document(centre: Centre | None, zero: ZeroAngle | None) -> dict[str, Any]:
    """For programs: SI units, standard uncertainties; null where it was not looked for."""
    found = None
    if centre is not None:
        found = {
            "position": centre.centre,
            "position_u": centre.u,
            "covariance": centre.covariance,
            "eccentricity": centre.offset,
            "contributions": centre.contributions,
            "radial_error_motion": centre.radial,
            "scatter": centre.scatter,
        }
    angle = None if zero is None else {"value": zero.offset, "u": zero.u, "scatter": zero.scatter}
    return {"format": "mtcal-pointer-alignment/1", "centre": found, "zero_angle": angle}
