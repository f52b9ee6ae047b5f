# SPDX-License-Identifier: Apache-2.0
"""How long processes wait for a processor, for tests of what must happen in time on a machine that others use too."""

from __future__ import annotations

import threading
from pathlib import Path


class Waiting:
    """Counts, as a context, how long the threads of processes wait for a processor, which is not their own slowness.

    Args:
        processes: their ids; one may end meanwhile.
    """

    def __init__(self, *processes: int) -> None:
        self._processes = processes
        self._first: dict[Path, float] = {}
        self._last: dict[Path, float] = {}
        self._over = threading.Event()
        self._watch = threading.Thread(target=self._poll)

    def __enter__(self) -> Waiting:
        self._look()
        self._first = dict(self._last)
        self._watch.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._watch.join()

    @property
    def seconds(self) -> float:
        """Of all threads together, s; nothing where the system does not tell."""
        return sum(waited - self._first.get(path, 0.0) for path, waited in self._last.items())

    def _poll(self) -> None:
        while not self._over.wait(0.02):
            self._look()

    def _look(self) -> None:
        for process in self._processes:
            for path in Path("/proc", str(process), "task").glob("*/schedstat"):
                try:
                    self._last[path] = 1e-9 * int(path.read_text(encoding="ascii").split()[1])
                except (OSError, IndexError, ValueError):
                    continue
