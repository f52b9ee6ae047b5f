# SPDX-License-Identifier: Apache-2.0
"""How what the interface returns shows itself: one line, the text of the command line, a document, a notebook."""

from __future__ import annotations

import io
import operator
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields
from functools import cached_property
from html import escape
from typing import TYPE_CHECKING, Any, Self

from machine_tool_calibration.effects.effect import Effect as PhysicalEffect
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.json_types import plain
from machine_tool_calibration.reports.tables import Part, show

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

_WIDTH = 120  # columns of a text, as the commands have in a file


class Shown(ABC):
    """What says in one line what it is, and in a notebook everything that the command line prints of it."""

    @property
    @abstractmethod
    def headline(self) -> str:
        """What it is, in one line."""

    @abstractmethod
    def parts(self) -> Iterator[Part]:
        """What the command line prints of it: sentences and tables of text."""

    def show(self, screen: Console, /) -> None:
        """Print it."""
        show(screen, self.parts())

    def report(self) -> str:
        """The same as text."""
        return printed(self.parts())

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.headline}>"

    def _repr_html_(self) -> str:
        return f"<p><b>{escape(self.headline)}</b></p>\n<pre>{escape(self.report())}</pre>"


class Answer(Shown):
    """What was found out, by a record of a room below that shows itself besides."""

    @classmethod
    def of(cls, found: Any, **more: Any) -> Self:
        """The record that a room below has made, with what comes on top."""
        return cls(**{one.name: getattr(found, one.name) for one in fields(found)} | more)

    @cached_property
    @abstractmethod
    def _document(self) -> dict[str, Any]: ...

    def document(self) -> dict[str, Any]:
        """The same for programs, as `mtcal` writes it with `--json`; None is not determined."""
        return dict(plain(self._document))


def printed(parts: Iterable[Part]) -> str:
    """What a command prints, as text."""
    from rich.console import Console

    text = io.StringIO()
    # Of a file, wherever this runs: neither a notebook nor a terminal changes it.
    screen = Console(
        file=text, width=_WIDTH, highlight=False, markup=False, force_terminal=False, force_jupyter=False, no_color=True
    )
    show(screen, parts)
    return text.getvalue()


def chosen(figures: Mapping[str, Figure], name: str | None) -> Figure:
    """One of several pictures, the first one without a name; a CalibrationError if there is none of that name."""
    if name is None and figures:
        name = next(iter(figures))
    if not isinstance(name, str) or name not in list(figures):
        known = f"there are {', '.join(figures)}" if figures else "there is nothing to draw"
        raise CalibrationError(known if name is None else f"no picture {name!r}; {known}")
    return notebook(figures[name])


def notebook(figure: Figure) -> Figure:
    """The same figure, which a notebook shows as a picture also where pyplot was never imported."""

    # A notebook asks the object itself: only pyplot would tell it how to show figures, and pyplot is not needed here.
    def png() -> bytes:
        picture = io.BytesIO()
        figure.savefig(picture, format="png", dpi=100)
        return picture.getvalue()

    vars(figure)["_repr_png_"] = png
    return figure


MOST_DRAWS = 100_000
"""Random draws that can be asked for: quantiles of more are no better known than what is drawn from."""
_LIMITS = {"seed": (0, 2**63 - 1), "draws": (0, MOST_DRAWS)}  # smallest and largest


def require_whole(**numbers: Any) -> None:
    """Refuse (CalibrationError) a `seed`, or a number of `draws`, that is no whole number within its limits."""
    for name, value in numbers.items():
        low, high = _LIMITS[name]
        try:
            fits = not isinstance(value, bool) and low <= operator.index(value) <= high
        except TypeError:
            fits = False
        if not fits:
            raise _refused(f"{name} must be a whole number from {low} to {high}", value)


def require_kind(value: Any, kind: Any, words: str) -> None:
    """Refuse (CalibrationError) an argument of another kind; `words` say which it has to be, its name before it."""
    if not isinstance(value, kind):
        raise _refused(words, value)


def listed(name: str, value: Any, kind: Any = object, words: str = "") -> tuple[Any, ...]:
    """An argument that is a list of one kind, which `words` name, or one text of it; a CalibrationError: it is none."""
    require_kind(value, Iterable, f"{name} must be a list{words}")
    entries = (value,) if isinstance(value, str) else tuple(value)
    for entry in entries:
        require_kind(entry, kind, f"{name} must be a list{words}")
    return entries


def own_effects_of(own: Any) -> tuple[PhysicalEffect, ...]:
    """The user's own effects that an argument `own` lists; a CalibrationError: it does not."""
    return listed("own", own, PhysicalEffect, " of effects, as mtcal.Effect makes them")


def _refused(words: str, value: Any) -> CalibrationError:
    from machine_tool_calibration.session.record import shown  # loads pydantic, which few verbs need

    return CalibrationError(f"{words}, not {shown(value)}")
