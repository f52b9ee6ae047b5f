# SPDX-License-Identifier: Apache-2.0
"""How long processes wait for a processor, for tests of what must happen in time on a machine that others use too."""

import threading
import time
from pathlib import Path

_LOOK = 0.02  # s


class Waiting:
    """Counts, as a context, how long the threads of processes wait for a processor, which is not their own slowness.

    What a virtual machine waits for its own processors no process is told: its clock shows it, by what comes too late.

    Args:
        processes: their ids; one may end meanwhile.
    """

    def __init__(self, *processes: int) -> None:
        self._processes = processes
        self._first: dict[Path, float] = {}
        self._last: dict[Path, float] = {}
        self._late = 0.0
        self._over = threading.Event()
        self._watch = threading.Thread(target=self._poll)

    def __enter__(self) -> "Waiting":
        self._look()
        self._first = dict(self._last)
        self._watch.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._watch.join()

    @property
    def seconds(self) -> float:
        """Of all threads together, and by how much looks at them came too late, s."""
        return self._late + sum(waited - self._first.get(path, 0.0) for path, waited in self._last.items())

    def _poll(self) -> None:
        due = time.monotonic() + _LOOK
        while not self._over.wait(_LOOK):
            self._late += time.monotonic() - due
            self._look()
            due = time.monotonic() + _LOOK

    def _look(self) -> None:
        for process in self._processes:
            for path in Path("/proc", str(process), "task").glob("*/schedstat"):
                try:
                    self._last[path] = 1e-9 * int(path.read_text(encoding="ascii").split()[1])
                except (OSError, IndexError, ValueError):
                    continue
