"""A ROS domain id that no other graph on this machine uses."""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from machine_tool_calibration.errors import CalibrationError

__all__ = ["claimed_domain"]

# larger ones need ports that the system gives to outgoing connections
_IDS = range(0, 102)


@contextmanager
def claimed_domain(wanted: int | None = None) -> Iterator[int]:
    """A domain id, held by the lock of a file for as long as the context lasts.

    Args:
        wanted: this one, whoever else uses it; by default the user's ROS_DOMAIN_ID, and else the first that is free.

    Raises:
        CalibrationError: not a domain id, or none is free.
    """
    chosen = os.environ.get("ROS_DOMAIN_ID", "") if wanted is None else str(wanted)
    if chosen:
        if not chosen.isdigit() or int(chosen) > 232:
            raise CalibrationError(f"ROS domain id {chosen!r} is not a whole number from 0 to 232")
        yield int(chosen)
        return
    for domain in _IDS:
        path = Path(tempfile.gettempdir(), f"machine_tool_calibration-{os.getuid()}-domain-{domain}.lock")
        with path.open("w") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                continue
            yield domain
            return
    raise CalibrationError("no ROS domain id is free on this machine; --domain-id chooses one")
