# SPDX-License-Identifier: Apache-2.0
"""`mtcal align-pointer`: rotation centre and zero angle of an open-loop tracking interferometer."""

from pathlib import Path

import click

from machine_tool_calibration.cli.shared import PATH, json_option, tell_either
from machine_tool_calibration.errors import CalibrationError


@click.command("align-pointer")
@click.argument("searches", metavar="SEARCH…", nargs=-1, required=True, type=PATH)
@click.option("--machine", metavar="LENGTH", help="Standard uncertainty of the machine's position there, such as 5um.")
@click.option("--setup", default="A", show_default=True, help="Id of the station, for the lines that are printed.")
@json_option
def command(searches: tuple[Path, ...], machine: str | None, setup: str, as_json: bool) -> None:
    """Find where an open-loop pointer's rotation centre and zero angle are (Ibaraki et al. 2014, Section 2.2).

    SEARCH is a CSV file in SI units with the columns azimuth, displacement, x and y, or a folder with it as
    observations.csv. Where the beam turns and the retroreflector stands still near the axis, it gives the centre; where
    the beam is held across Y and the retroreflector moves along Y, the zero angle. One of each may be given.

    For the centre the beam turns by half a turn or more and is read more than 13 times, at 13 azimuths or more (at
    fewer, once more often than there are); the zero angle takes three places along Y. A further run takes one more.

    \b
    mtcal align-pointer turn.csv --machine 5um
    mtcal align-pointer turn.csv along_y.csv --setup B
    mtcal run pointer_centre && mtcal align-pointer mtcal_output/pointer_centre/session
    """
    from machine_tool_calibration.importing.own import read_alignment
    from machine_tool_calibration.methods.tracking.pointer_alignment import rotation_centre, zero_angle
    from machine_tool_calibration.reports.pointer_alignment import alignment_document, alignment_parts
    from machine_tool_calibration.units import quantity

    u = 0.0 if machine is None else quantity(machine, "length", "--machine")
    if u < 0:
        raise CalibrationError(f"--machine: a standard uncertainty is not negative, as {machine} is")
    read = [read_alignment(path) for path in searches]
    turning, moving = ([one for one in read if one.turns is turns] for turns in (True, False))
    if len(turning) > 1 or len(moving) > 1:
        raise CalibrationError("at most one search for the centre and one for the zero angle; several runs in one file")
    zero, centre = None, None
    for one in moving:
        zero = zero_angle(one.place[:, 1], one.displacement, one.azimuth, one.run)
    for one in turning:
        centre = rotation_centre(one.azimuth, one.displacement, one.place[0], one.run, machine=u, zero=zero)
    tell_either(alignment_document(centre, zero), alignment_parts(centre, zero, setup), as_json)
