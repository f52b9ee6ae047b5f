# SPDX-License-Identifier: Apache-2.0
"""What the rest of the package knows of a measuring method: one record, which the method's folder holds.

Functions of this room and of rooms below it stand in the record as they are. Those of rooms above it, and what takes
long to import, stand as text `module:function` and are loaded when they are asked for (`load`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from importlib import import_module
from typing import TYPE_CHECKING, Any, get_args

if TYPE_CHECKING:
    from machine_tool_calibration.session.description import Description
    from machine_tool_calibration.session.judgements import Checks

__all__ = ["MethodSpec", "load"]


@dataclass(frozen=True)
class MethodSpec:
    """A measuring method.

    Attributes:
        description: record of what session.yaml says.
        columns: of a description, the columns of observations.csv without which the method cannot work.
        any_axis: whether some column of an axis's position is needed, of whichever axis.
        checks: what is checked of a session, beside what is checked of every one.
        model: module with `build(session, variant)`, which gives the model.
        map: module with `error_map(model, fit)`, which gives the machine's errors; that of the model if absent.
        models: names of the model's variants, the default first; for each when it is the right one.
        tables: variant with tables of the machine's error motions, which other sessions can share; the default if
            absent.
        by_axes: variants in which nothing but the axes' errors moves the tool point.
        no_tables: why a model has no tables of error motions, and what to do.

        words: of a description, what is measured, in words.
        mounted: of a description, what has to be mounted again for further readings in a setup, whose unknowns then are
            new ones; empty where everything stays in place.
        turned_part: what may be turned by orienting the spindle, and the effects that turn with it.

        reads_deviations: whether a reading is a small deviation rather than a path.
        reads_machine: whether a reading is the machine's deviation itself along a given direction: what does not
            reproduce is then the machine's or the part's own, of which the declared uncertainty knows nothing, and the
            error map holds the displacements by the effects, reading by reading.
        probes_surface: whether readings sense a workpiece's surface along its normal, which turns with the table.
        turns_one_axis: whether a run turns one rotary axis, angle after angle.
        states_runs: whether a setup states a run, move after move: their order matters even where the directions of
            approach do not, and a procedure's targets follow from the session.
        counts_from_run: whether readings count from the first one of their run rather than of their setup.
        free_order: whether targets may be visited in any order.

        steps: of a procedure, its steps one reading each.
        planned: of a procedure, its steps and the setup of each, what a perfect machine would show.
        further_places: of a session and its description, further setups that could be measured, as options.
        pictures: module with `figures` of a result; those of its map and tables if absent.
        optics: of a site and a description, the simulated instrument's beam.
    """

    description: type[Description]
    columns: Callable[[Any], tuple[str, ...]]
    checks: Checks
    model: str
    models: Mapping[str, str]
    any_axis: bool = False
    map: str | None = None
    tables: str | None = None
    by_axes: tuple[str, ...] = ()
    no_tables: str = ""

    words: Callable[[Any], str] | None = None
    mounted: Callable[[Any], str] = lambda description: "the instrument"
    turned_part: tuple[str, tuple[str, ...]] = ("", ())

    reads_deviations: bool = False
    reads_machine: bool = False
    probes_surface: bool = False
    turns_one_axis: bool = False
    states_runs: bool = False
    counts_from_run: bool = False
    free_order: bool = False

    steps: str | None = None
    planned: str | None = None
    further_places: str | None = None
    pictures: str | None = None
    optics: str | None = None

    @property
    def name(self) -> str:
        """`method` in session.yaml."""
        name: str = get_args(self.description.model_fields["method"].annotation)[0]
        return name

    @cached_property
    def beam_from_pointer(self) -> bool:
        """Whether readings look along a beam from a pointer: azimuth and elevation distinguish them."""
        from machine_tool_calibration.session.description import StationSetup  # here, as the catalogue needs it not

        kinds = get_args(self.description.model_fields["setups"].annotation)
        return any(isinstance(kind, type) and issubclass(kind, StationSetup) for kind in kinds)


@cache
def load(where: str) -> Any:
    """What a text `module` or `module:name` stands for.

    Raises:
        ImportError: no such module.
        AttributeError: the module has no such name.
    """
    module, _, name = where.partition(":")
    found = import_module(module)
    return getattr(found, name) if name else found
