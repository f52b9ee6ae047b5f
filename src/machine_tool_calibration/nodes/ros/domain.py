# SPDX-License-Identifier: Apache-2.0
"""A ROS domain id that no other graph on this machine uses."""

import errno
import os
import socket
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

from machine_tool_calibration.errors import CalibrationError

# larger ones need ports that the system gives to outgoing connections
_IDS = range(0, 102)


@contextmanager
def claimed_domain(wanted: int | None = None) -> Iterator[int]:
    """A domain id for a measurement, kept from others for as long as the context lasts.

    Args:
        wanted: this one, whoever else uses it; by default the user's ROS_DOMAIN_ID, and else the first that no other
            measurement on this machine has claimed.

    Raises:
        CalibrationError: not a domain id, or none is free.
    """
    chosen = os.environ.get("ROS_DOMAIN_ID", "") if wanted is None else str(wanted)
    if chosen:
        if not chosen.isdigit() or int(chosen) > 232:
            raise CalibrationError(f"ROS domain id {chosen!r} is not a whole number from 0 to 232")
        yield int(chosen)
        return
    with free_domain() as domain:
        yield domain


@contextmanager
def free_domain(ids: Iterable[int] = _IDS) -> Iterator[int]:
    """The first of these domain ids that nobody on this machine has claimed, claimed for as long as this lasts.

    Raises:
        CalibrationError: none is free.
    """
    for domain in ids:
        claim = _claim(domain)
        if claim is not None:
            with claim:
                yield domain
            return
    raise CalibrationError("no ROS domain id is free on this machine; --domain-id chooses one")


def _claim(domain: int) -> socket.socket | None:
    """A socket that holds a name which only one program can hold; None if another has it.

    The name is in the kernel and not in a folder: it is the same for every user, reaches as far as the network on which
    graphs would meet (a container with a network of its own has names of its own), and goes with its program.

    Raises:
        CalibrationError: the system gives no such name at all.
    """
    claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        claim.bind(f"\0machine_tool_calibration/domain/{domain}")
    except OSError as error:
        claim.close()
        if error.errno == errno.EADDRINUSE:
            return None
        raise CalibrationError(f"no ROS domain id can be claimed here ({error}); --domain-id chooses one") from error
    return claim
