# SPDX-License-Identifier: Apache-2.0
"""What the rest of the package knows of a measuring method: one record, which the method's folder holds.

Functions of this room and of rooms below it stand in the record as they are. Those of rooms above it, and what takes
long to import, stand as text `module:function` and are loaded when they are asked for (`load`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from machine_tool_calibration.arrays import BoolArray
    from machine_tool_calibration.session.description import Description, Place
    from machine_tool_calibration.session.judgements import Held, Judgement
    from machine_tool_calibration.session.session import Session

__all__ = ["MethodSpec", "load"]


def _nothing(*_: object) -> Iterator[Any]:
    """No judgement, and nothing held against anything."""
    return iter(())


@dataclass(frozen=True)
class MethodSpec:
    """A measuring method.

    Attributes:
        name: `method` in session.yaml.
        description: record of what session.yaml says.
        columns: of a description, the columns of observations.csv without which the method cannot work.
        enough: of a session, which of its readings (n,) are there, and the names for messages: raises a SessionError
            if no model of the method can make anything of it.
        model: module with `build(session, variant)`, which gives the model.
        map: module with `error_map(model, fit)`, which gives the machine's errors; that of the model if absent.
        models: names of the model's variants, the default first; for each when it is the right one.
        magnitudes: of a session and the names for messages: raises a SessionError for values of the method's own keys
            and columns that can only be a wrong unit.
        nominal: of a session and the names for messages: judgements by the nominal geometry, by which common mistakes
            are found.
        held: of a session, places, beams and displacements held against the geometry that it states.
        suspicious: of a session, what in it hardly can be, in words, a sentence each.
        any_axis: whether some column of an axis's position is needed, of whichever axis.
        words: of a description, what is measured, in words.
        setup_word: what people call a setup.
        mounted: of a description, what has to be mounted again for further readings in a setup, whose unknowns then are
            new ones; empty where everything stays in place.
        turned_part: what may be turned by orienting the spindle, and the effects that turn with it.

        reads_deviations: whether a reading is a small deviation rather than a path.
        reads_machine: whether a reading is the machine's deviation itself along a given direction: what does not
            reproduce is then the machine's or the part's own, of which the declared uncertainty knows nothing.
        beam_from_pointer: whether readings look along a beam from a pointer: azimuth and elevation distinguish them.
        probes_surface: whether readings sense a workpiece's surface along its normal, which turns with the table.
        on_turning_table: whether what is measured lies on a rotary table whose sense of rotation matters.
        turns_one_axis: whether a run turns one rotary axis, angle after angle.
        free_order: whether targets may be visited in any order.
        ordered_moves: whether the order of the moves matters even where the directions of approach do not.
        counts_from_run: whether readings count from the first one of their run rather than of their setup.
        profiles: whether the error map gives profiles along lines of the axes rather than tables of error motions.
        map_holds_effects: whether the error map holds the displacements by the effects, reading by reading.
        along: covariate along which the readings of a run lie one after the other; None where they fill a plane or
            space.

        shared: variant in which the machine's errors are tables that other sessions can share; the default if absent.
        by_axes: variants in which nothing but the axes' errors moves the tool point.
        with_tables: variant with tables of error motions, where the default has none.
        no_tables: why a model has no tables of error motions, and what to do.

        steps: of a procedure, its steps one reading each.
        path_from_session: whether a procedure's targets follow from the session.
        further_places: of a session and its description, further setups that could be measured, as options.
        planned: of a procedure, its steps and the setup of each, what a perfect machine would show.
        pictures: module with `figures` of a result; those of its map and tables if absent.
        optics: of a site and a description, the simulated instrument's beam.
        unneeded: nodes that the method does not need: a probe is instrument and pointer in one, a fixed beam needs no
            pointer.
    """

    name: str
    description: type[Description]
    columns: Callable[[Any], tuple[str, ...]]
    enough: Callable[[Session, BoolArray, Place], None]
    model: str
    models: Mapping[str, str]
    magnitudes: Callable[[Session, Place], object] = _nothing
    nominal: Callable[[Session, Place], Iterator[Judgement]] = _nothing
    map: str | None = None
    held: Callable[[Session], Iterator[Held]] = _nothing
    suspicious: Callable[[Session], Iterator[str]] = _nothing
    any_axis: bool = False
    words: Callable[[Any], str] | None = None
    setup_word: str = "setup"
    mounted: Callable[[Any], str] = lambda description: "the instrument"
    turned_part: tuple[str, tuple[str, ...]] = ("", ())

    reads_deviations: bool = False
    reads_machine: bool = False
    beam_from_pointer: bool = False
    probes_surface: bool = False
    on_turning_table: bool = False
    turns_one_axis: bool = False
    free_order: bool = False
    ordered_moves: bool = False
    counts_from_run: bool = False
    profiles: bool = False
    map_holds_effects: bool = False
    along: str | None = None

    shared: str | None = None
    by_axes: tuple[str, ...] = ()
    with_tables: str | None = None
    no_tables: str = ""

    steps: str | None = None
    path_from_session: bool = False
    further_places: str | None = None
    planned: str | None = None
    pictures: str | None = None
    optics: str | None = None
    unneeded: tuple[str, ...] = ("probe",)


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
