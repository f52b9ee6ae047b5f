# SPDX-License-Identifier: Apache-2.0
"""The errors that reach the user as one clear line, and what a mistyped name may have meant."""

import difflib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager


class CalibrationError(ValueError):
    """The input or the request is wrong; the message says what and where, in one line."""


class SessionError(CalibrationError):
    """A session, recording or table that cannot be used as it is."""


class ModelError(CalibrationError):
    """A model that the data or the machine does not allow."""


@contextmanager
def suspected() -> Iterator[None]:
    """What is refused within is implausible, not impossible: the message says how it is taken as it is."""
    try:
        yield
    except CalibrationError as error:
        raise type(error)(f"{error} (trust_units: true in session.yaml takes it as it is)") from None


def one_line(text: object) -> str:
    """The text without line breaks, for a message that must stay one line."""
    return " ".join(str(text).split())


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """` (did you mean 'backlash_x'?)` for the end of a message, with the nearest known name; empty if none is near.

    All that differ by their last letter, as by the axis, where the name ends with none of these. One that differs by
    its capitals alone is near.
    """
    names, text = list(known), name if isinstance(name, str) else ""
    near = [one for one in names if one.lower() == text.lower()] or difflib.get_close_matches(text, names, n=6)
    alike = [one for one in near if one[:-1] == near[0][:-1]] if near else []
    alike = [one for one in alike if one[-1:] == name[-1:]] or alike
    return f" (did you mean {' or '.join(map(repr, sorted(alike)))}?)" if near else ""


class RecordingError(SessionError):
    """A recording that cannot be read or written; one line says which file and why."""


class UnfinishedError(RecordingError):
    """A recording whose recorder did not end it; `mtcal recover` makes it whole."""
