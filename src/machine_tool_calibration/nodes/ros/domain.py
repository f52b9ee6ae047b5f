# SPDX-License-Identifier: Apache-2.0
"""A ROS domain id that no other graph on this machine uses."""

from __future__ import annotations

import errno
import os
import socket
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from machine_tool_calibration.errors import CalibrationError

__all__ = ["claimed_domain", "domains_with_nodes", "free_domain"]

# larger ones need ports that the system gives to outgoing connections
_IDS = range(0, 102)
_FIRST_PORT, _PORTS_PER_DOMAIN = 7400, 250  # of DDS over UDP (OMG RTPS 2.5, 9.6.2)
_SOCKET_TABLES = (Path("/proc/net/udp"), Path("/proc/net/udp6"))


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
def free_domain(ids: Iterable[int] = _IDS, *, without_nodes: bool = False) -> Iterator[int]:
    """The first domain id that nobody on this machine has claimed, whoever runs it, claimed for as long as this lasts.

    Args:
        ids: the domain ids to choose from.
        without_nodes: leave out domains in which any program takes part, whether it has claimed the domain or not.

    Raises:
        CalibrationError: none is free.
    """
    for domain in ids:
        claim = _claim(domain)
        if claim is None:
            continue
        with claim:
            # looked at after the claim: others that have claimed it until now have started their nodes
            if without_nodes and domain in domains_with_nodes():
                continue
            yield domain
            return
    raise CalibrationError("no ROS domain id is free on this machine; --domain-id chooses one")


def domains_with_nodes() -> frozenset[int]:
    """The domains whose UDP ports are in use on this machine; empty where the system does not tell."""
    ports: set[int] = set()
    for table in _SOCKET_TABLES:
        try:
            lines = table.read_text(encoding="ascii").splitlines()[1:]
        except OSError:
            continue
        # "  155: 0100007F:6824 00000000:0000 07 …": the second word is the local address and port, in base 16
        ports |= {int(line.split()[1].rpartition(":")[2], 16) for line in lines if line.strip()}
    return frozenset((port - _FIRST_PORT) // _PORTS_PER_DOMAIN for port in ports if port >= _FIRST_PORT)


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
