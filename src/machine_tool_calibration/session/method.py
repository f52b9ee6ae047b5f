# SPDX-License-Identifier: Apache-2.0
"""What the rest of the package knows of a measuring method, which the method's folder holds.

Functions of rooms above this one, and what takes long to import, stand as text `module:function` and are loaded when
they are asked for (`load`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache, cached_property
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar, get_args

from machine_tool_calibration.errors import SessionError

if TYPE_CHECKING:
    from machine_tool_calibration.arrays import BoolArray
    from machine_tool_calibration.session.description import Description, Place
    from machine_tool_calibration.session.judgements import Held, Judgement
    from machine_tool_calibration.session.session import Session


class MethodSpec:
    """A measuring method: a method's folder says what differs from this."""

    description: ClassVar[type[Description]]  # record of what session.yaml says
    # module with `build(session, variant)`, which gives the model, and `error_map(model, fit)`, the machine's errors
    model: ClassVar[str]
    models: ClassVar[Mapping[str, str]]  # the model's variants, the default first, with when each is the right one
    any_axis: ClassVar[bool] = False  # whether some column of an axis's position is needed, of whichever axis
    always: ClassVar[tuple[str, ...]] = ()  # columns that observations.csv must have whatever the description
    needed: ClassVar[int] = 1  # readings that some setup must have
    remounted: ClassVar[str] = "the instrument"  # what is mounted again between setups
    # variant with tables of the machine's error motions, which other sessions can share; the default if absent
    tables: ClassVar[str | None] = None
    alone: ClassVar[tuple[str, ...]] = ()  # variants of which other sessions share nothing
    by_axes: ClassVar[tuple[str, ...]] = ()  # variants in which nothing but the axes' errors moves the tool point
    no_tables: ClassVar[str] = ""  # why a model has no tables of error motions, and what to do
    # what may be turned by orienting the spindle, and the effects that turn with it
    turned_part: ClassVar[tuple[str, tuple[str, ...]]] = ("", ())

    reads_deviations: ClassVar[bool] = False  # whether a reading is a small deviation rather than a path
    # whether a reading is the machine's deviation itself along a given direction: what does not reproduce is then the
    # machine's or the part's own, of which the declared uncertainty knows nothing, and the error map holds the
    # displacements by the effects, reading by reading
    reads_machine: ClassVar[bool] = False
    centred: ClassVar[bool] = False  # whether all places of a setup lie about a centre, which may move between runs
    probes_surface: ClassVar[bool] = False  # whether readings sense a surface along its normal, turning with the table
    turns_one_axis: ClassVar[bool] = False  # whether a run turns one rotary axis, angle after angle
    # whether a setup states a run, move after move: their order matters even where the directions of approach do not,
    # and a procedure's targets follow from the session
    states_runs: ClassVar[bool] = False
    counts_from_run: ClassVar[bool] = False  # whether readings count from the first of their run, not their setup
    free_order: ClassVar[bool] = False  # whether targets may be visited in any order

    steps: ClassVar[str | None] = None  # of a procedure, its steps one reading each
    planned: ClassVar[str | None] = None  # of a procedure, steps and setups, what a perfect machine would show
    # of a session and its description, further setups that could be measured, as options
    further_places: ClassVar[str | None] = None
    pictures: ClassVar[str | None] = None  # module with `figures` of a result; those of its map and tables if absent

    @property
    def name(self) -> str:
        """`method` in session.yaml."""
        name: str = get_args(self.description.model_fields["method"].annotation)[0]
        return name

    @property
    def together(self) -> list[str]:
        """Names of the variants that a fit of several sessions may have."""
        return [name for name in self.models if name not in self.alone]

    @cached_property
    def beam_from_pointer(self) -> bool:
        """Whether readings look along a beam from a pointer: azimuth and elevation distinguish them."""
        from machine_tool_calibration.session.description import StationSetup  # here, as the catalogue needs it not

        kinds = get_args(self.description.model_fields["setups"].annotation)
        return any(isinstance(kind, type) and issubclass(kind, StationSetup) for kind in kinds)

    def columns(self, description: Any) -> tuple[str, ...]:
        """Columns of observations.csv without which the method cannot work."""
        return self.always

    def words(self, description: Any) -> str:
        """What is measured, in words; empty where the method's name says it."""
        return ""

    def mounted(self, description: Any) -> str:
        """What has to be mounted again for further readings in a setup, whose unknowns then are new ones; may be ''."""
        return self.remounted

    def enough(self, session: Session, measured: BoolArray, place: Place) -> None:
        """Refuse (SessionError) a session of which no model of the method can make anything.

        Some setup must have enough of the readings that are `measured` (n,); losses in others the estimator names.
        """
        import numpy as np  # a history is listed without it

        good = np.bincount(session.readings.setup[measured], minlength=len(session.setup_ids))
        if good.sum() < 2:
            raise SessionError(f"{place.readings}: too few readings: {good.sum()}, and at least 2 are needed")
        if good.max() < self.needed:
            raise SessionError(
                f"{place.readings}: too few readings: no setup has more than {good.max()}; at least {self.needed} are "
                "needed"
            )

    def magnitudes(self, session: Session, place: Place) -> None:
        """Refuse (SessionError) values of the method's own keys and columns that can only be a wrong unit."""

    def nominal(self, session: Session, place: Place) -> Iterator[Judgement]:
        """Judgements by the nominal geometry, by which common mistakes are found."""
        return iter(())

    def held(self, session: Session) -> Iterator[Held]:
        """Places, beams and displacements held against the geometry that the session states."""
        return iter(())

    def suspicious(self, session: Session) -> Iterator[str]:
        """What in it hardly can be, a sentence each."""
        return iter(())


@cache
def load(where: str) -> Any:
    """What a text `module` or `module:name` stands for."""
    module, _, name = where.partition(":")
    found = import_module(module)
    return getattr(found, name) if name else found
