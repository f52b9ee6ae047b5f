# SPDX-License-Identifier: Apache-2.0
"""How a long calculation tells how far it is."""

from collections.abc import Callable

Progress = Callable[[str, float], None]
"""Is told what is being done, and which share of it is done, from 0 to 1."""


def untold(what: str, share: float | None) -> None:
    """Nobody is told."""
