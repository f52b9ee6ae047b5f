# SPDX-License-Identifier: Apache-2.0
"""What verbs for many sessions share: where they are worked on, and how far that is."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import click

from machine_tool_calibration.cli.output import bar, note, options

if TYPE_CHECKING:
    from machine_tool_calibration.cli.diagnosing import Wanted
    from machine_tool_calibration.interface.identification import Fit
    from machine_tool_calibration.methods.fitted import FitRequest
    from machine_tool_calibration.reports.identification import Measured

One = TypeVar("One")
# Seconds between two lines where there is no terminal for a bar.
_LINE = 30.0

workers_options = options(
    click.option(
        "--workers",
        type=click.IntRange(min=0),
        help="Processes of this machine, by default one a processor; 0: one session after the other, without Dask.",
    ),
    click.option(
        "--scheduler", metavar="ADDRESS", help="Of a Dask cluster that works instead, such as tcp://host:8786."
    ),
)
"""`workers` and `scheduler` of `fleet.each.each`."""


def fit_one(path: Path, wanted: Wanted, *, keep_all: bool = False) -> Fit:
    """Identify one of many sessions; the variant of the model is for those of methods that have it."""
    return wanted.fit([path], lambda what, share=None: None, partial(_chosen, wanted, keep_all))


def _chosen(wanted: Wanted, keep_all: bool, measured: Measured) -> FitRequest:
    from machine_tool_calibration.session.catalogue import method_names, method_spec, spec_of

    chosen = measured.chosen
    elsewhere = {model for name in method_names() for model in method_spec(name).models}
    # One that no method has is left for the refusal.
    if wanted.model and wanted.model in elsewhere and wanted.model not in spec_of(chosen.sessions[0]).models:
        chosen = replace(chosen, model=None)
    return replace(chosen, keep_all=keep_all or chosen.keep_all)


def followed(finished: Iterable[One], count: int) -> Iterator[One]:
    """The same, with how many of `count` are finished and the time that is left, on standard error."""
    from machine_tool_calibration.reports.quantities import duration

    begun = said = time.monotonic()
    with bar("sessions", counted=True) as update:
        for done, one in enumerate(finished, start=1):
            yield one
            now = time.monotonic()
            left = f"{duration((now - begun) / done * (count - done))} left"
            if update is not None:
                update(description=f"sessions, {left}", completed=done, total=count)
            elif now - said >= _LINE and done < count:
                said = now
                note(f"{done} of {count} sessions, {left}")
