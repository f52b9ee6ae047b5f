# SPDX-License-Identifier: Apache-2.0
"""What a model's unknowns are, in words: of a setup, of a table of error motions, of an effect."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from machine_tool_calibration.machine.error_motions import ERROR_MOTIONS, SQUARENESS
from machine_tool_calibration.model.model import Kind, Parameter
from machine_tool_calibration.words import Said, enumeration, say

if TYPE_CHECKING:
    from machine_tool_calibration.model.fit import JointFit


def unknown_in_words(unknown: Parameter) -> str:
    """What one unknown is; its name where nothing is known of it."""
    if unknown.kind is Kind.RUN_OFFSET:
        return say("unknown.one_run", owner=_owner(unknown), repeat=unknown.at)
    return _of(unknown.kind, _owner(unknown))


def _of(kind: Kind, owner: str) -> Said:
    return say(f"unknown.{kind.name.lower()}", owner=owner)


def unknowns_in_words(unknowns: Iterable[Parameter]) -> str:
    """What several unknowns are; those of the same kind are named together."""
    kinds: dict[Kind, list[str]] = {}
    for unknown in unknowns:
        owners = kinds.setdefault(unknown.kind, [])
        if (owner := _owner(unknown)) not in owners:
            owners.append(owner)
    return enumeration([_of(kind, enumeration(sorted(owners))) for kind, owners in kinds.items()])


def named_in_words(fit: JointFit, effects: Iterable[str]) -> dict[str, str]:
    """What stands behind each name in a result: an unknown, a whole table or effect, or what was left out.

    Nothing for names that say all that is known.
    """
    whole = [Parameter(name, "m", kind=Kind.MOTION, owner=name) for name in ERROR_MOTIONS]
    whole += [Parameter(name, "rad", kind=Kind.SQUARENESS, owner=name) for name in SQUARENESS]
    whole += [Parameter(name, "1", kind=Kind.EFFECT, owner=name) for name in effects]
    out = {unknown.name: unknown_in_words(unknown) for unknown in whole}
    for model in fit.assembly.models:
        out |= {entry.name: _of(Kind.EFFECT, entry.effect) for entry in model.left_out if entry.effect}
    for unknown in fit.assembly.parameters:
        what = unknown.meaning or unknown_in_words(unknown)
        if what != unknown.name:
            out[unknown.name] = what
            if unknown.kind is Kind.MOTION:
                out[unknown.family] = what
    return out


def _owner(unknown: Parameter) -> str:
    if unknown.kind is Kind.OTHER:
        return unknown.name
    if not unknown.session:
        return unknown.owner
    if unknown.kind is Kind.EFFECT:
        return say("unknown.in_session", owner=unknown.owner, session=unknown.session)
    return f"{unknown.session}/{unknown.owner}"
