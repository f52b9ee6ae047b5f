"""What all tests share: quiet libraries, and a ROS domain that no other test process on this machine uses."""

import atexit
import fcntl
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import pytest
from hypothesis import settings

# The same examples every time, and no limit of the wall clock; HYPOTHESIS_PROFILE=explore looks for new ones.
settings.register_profile("repeatable", deadline=None, derandomize=True)
settings.register_profile("explore", deadline=None, print_blob=True)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))

# Text is laid out as in a file, whatever the terminal is.
for variable in ("COLUMNS", "LINES"):
    os.environ.pop(variable, None)

# Before anything imports them: pictures without a screen, and one thread for small matrices on a shared machine.
os.environ.setdefault("MPLBACKEND", "Agg")
for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

# Nothing leaves this machine, whatever the user's own setting is.
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ.pop("ROS_LOCALHOST_ONLY", None)

# Larger ones need ports that the system gives to outgoing connections.
DOMAINS = range(1, 102)


class Domains:
    """ROS domain ids, each claimed on this machine by the lock of a file for as long as this process lives."""

    def __init__(self) -> None:
        self._held: dict[int, IO[str]] = {}

    def claim(self) -> int:
        """A domain id that no other claimant has."""
        for domain in DOMAINS:
            if domain in self._held:
                continue
            path = Path(tempfile.gettempdir(), f"machine_tool_calibration-{os.getuid()}-domain-{domain}.lock")
            try:
                file = path.open("w")
            except OSError:
                continue
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                file.close()
                continue
            self._held[domain] = file
            return domain
        raise RuntimeError("no ROS domain id is free on this machine")

    def release(self, domain: int) -> None:
        """Give an id back."""
        self._held.pop(domain).close()

    def release_all(self) -> None:
        """Give every id back."""
        for domain in list(self._held):
            self.release(domain)


_domains = Domains()
atexit.register(_domains.release_all)
os.environ["ROS_DOMAIN_ID"] = str(_domains.claim())


@pytest.fixture(scope="session")
def ros_domain() -> int:
    """The domain id of this test process, which ROS_DOMAIN_ID already holds."""
    return int(os.environ["ROS_DOMAIN_ID"])


@pytest.fixture
def other_ros_domain() -> Iterator[int]:
    """One more domain id, for a second graph that must not hear the first."""
    domain = _domains.claim()
    yield domain
    _domains.release(domain)
