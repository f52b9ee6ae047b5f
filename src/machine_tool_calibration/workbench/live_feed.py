# SPDX-License-Identifier: Apache-2.0
"""What all windows see of a running graph: one listener, and the map of the readings so far."""

from __future__ import annotations

import json
import logging
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.budget import complete
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.errors import CalibrationError, SessionError
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.model.result import ErrorMap, Result
from machine_tool_calibration.nodes.heard import Heard, Offer, Published
from machine_tool_calibration.progress import Progress, untold
from machine_tool_calibration.recording.open import open_measurement
from machine_tool_calibration.reports.identification import summary_rows
from machine_tool_calibration.session.collect import Reading, live_session
from machine_tool_calibration.session.folder import write_session
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.workbench.process import Calculation

if TYPE_CHECKING:
    from machine_tool_calibration.nodes.client import Client

_EVERY = 3.0  # s from the end of one calculation to the next
# Readings from which the map takes gigabytes: it is calculated in another process, which gives them back.
_READINGS_APART = 5000
_PAUSE_RATIO = 10.0  # of the time that one takes: the page is not to be kept waiting by large sessions


@dataclass(frozen=True)
class LiveMap:
    """The map of the readings so far, and what it leaves."""

    whose: str  # who calculated it, in words
    rows: Sequence[tuple[str, str]]  # figures of the result, in words; none where only the map was published
    error_map: ErrorMap  # the machine's position errors, if there are any
    row: Array  # (n,) number of each reading in the order of time
    setup: Array  # (n,) place of its setup
    residual: Array  # (n,) m

    @staticmethod
    def of_session(
        session: Session, variant: str | None, own: Sequence[Effect], progress: Progress | None = None
    ) -> LiveMap:
        """Calculated from readings, without any progress; a CalibrationError if they do not allow it."""
        result = complete.identify(FitRequest((session,), None, variant, (), tuple(own)))
        assert isinstance(result, Result)  # of a single session
        readings = result.fit.model.observations.readings
        whose, rows = f"calculated here from {len(session.readings)} readings", summary_rows(result.document())
        row, setup = readings.row.astype(float), readings.setup.astype(float)
        return LiveMap(whose, rows, result.error_map, row, setup, result.fit.residuals)

    @staticmethod
    def of_messages(published: Published) -> LiveMap:
        """As an estimator published it; any error that Python knows where that means nothing."""
        document = json.loads(published.document) if published.document else {}
        columns = {name: np.zeros(0) for name in ("x", "y", "z", "ex", "ey", "ez", "ux", "uy", "uz")}
        columns |= dict(published.error_map)
        points, error, uncertainty = (
            np.column_stack([columns[f"{what}{axis}"] for axis in "xyz"]) for what in ("", "e", "u")
        )
        left = {name: np.zeros(0) for name in ("row", "setup", "residual")} | dict(published.residuals)
        effects = ", ".join(document.get("effects", ()))
        whose = "published by the estimator" + (f", with {effects}" if effects else "")
        rows = summary_rows(document) if document else []
        return LiveMap(whose, rows, ErrorMap({}, points, error, uncertainty), **left)


class Feed:
    """Listens from the first look at it until it is closed.

    The map that is shown is the newest: the one that the estimator published, or one that is calculated here whenever
    readings have come since, so that it is there without an estimator, as in a replay, and no node is kept busy.
    """

    def __init__(
        self, own: Sequence[Effect] = (), variant: str | None = None, domain: int | None = None, namespace: str = ""
    ) -> None:
        self._own, self._variant = own, variant
        # the ROS domain's id, that of the environment if None; and the namespace of the graph
        self.domain, self.namespace = domain, namespace.strip("/")
        self.heard = Heard()  # of the graph
        self.trouble = ""  # why nothing is heard
        self.map: LiveMap | None = None  # the newest map of the present session
        self.number = 0  # grows with every map
        # of every map of the present session, its readings, its determined coordinates, and the largest U (95 %) of one
        # of them, m
        self.fall: list[tuple[int, int, float]] = []
        self.why_not = ""  # there is no map of the newest readings, in words
        self.calculating = (0.0, 0)  # since when a map is being calculated, and from how many readings; 0 if none is
        self._client: Client | None = None
        self._starting: threading.Thread | None = None
        self._working: threading.Thread | None = None
        self._run = 0
        self._done: tuple[object, ...] = (0, 0, "")
        self._shown = 0
        self._due = 0.0
        self._kept: tuple[tuple[int, int], Path] | None = None

    def look(self, now: float) -> None:
        """Somebody looks, `now` by a steady clock, s: listen, and calculate the map anew where that is due."""
        if self._starting is None:
            self._starting = threading.Thread(target=self._start, name="listener's start", daemon=True)
            self._starting.start()
        run, count = self.heard.count
        if run != self._run:
            self._run = run
            self._show(None)
        published = self.heard.published
        if published.number != self._shown:
            self._shown = published.number
            try:
                self._show(LiveMap.of_messages(published))
            except Exception as error:
                logging.getLogger(__name__).warning("what was published as a result means nothing: %r", error)
        there = run, count, self.heard.description
        if self._working is None and now >= self._due and count and there != self._done:
            self._done, self.calculating = there, (now, count)
            self._working = threading.Thread(target=self._calculate, name="live map", daemon=True)
            self._working.start()

    def ask(self, offer: Offer) -> None:
        """Ask for a service; `heard.calls` tells the answer."""
        if self._client is not None:
            self._client.ask(offer)

    def close(self) -> None:
        """Listen no longer."""
        if self._starting is not None:
            self._starting.join()
        if self._client is not None:
            self._client.close()

    def keep(self) -> Path:
        """A file or folder with the readings so far: the graph's own recording if it is finished, else a new session.

        A CalibrationError if they do not suffice, or cannot be written.
        """
        count = self.heard.count
        if self._kept is not None and self._kept[0] == count and self._kept[1].exists():
            return self._kept[1]
        heard = self.heard.session()
        path = self._recording(_session(*heard, check=False)) or _written(_session(*heard))
        self._kept = count, path
        return path

    def _recording(self, session: Session) -> Path | None:
        """What the recorder has written, if it is finished and holds every reading that was heard."""
        recorder = self.heard.newest("recorder")
        path = Path(recorder.entries.get("bag", "")) if recorder else Path()
        if not path.is_absolute() or not path.exists():
            return None
        try:
            recorded = open_measurement(path)
        except SessionError:  # it is being written
            return None
        there = np.isin(session.readings.displacement, recorded.readings.displacement)
        lost = np.isnan(session.readings.displacement)
        return path if (there | lost).all() else None

    def _start(self) -> None:
        try:
            from machine_tool_calibration.nodes.client import Client

            self._client = Client(self.domain, self.namespace, self.heard).listen()
        except ModuleNotFoundError as error:
            self.trouble = (
                f"To see a running graph needs ROS 2 ({error.name} is missing): source your ROS 2 installation, or "
                "pip install 'machine_tool_calibration[ros]'. Everything else works without it."
            )
        except CalibrationError as error:
            self.trouble = str(error)
        except Exception as error:
            self.trouble = f"ROS 2 does not start here: {' '.join(str(error).split())}"

    def _calculate(self) -> None:
        begin, run, published = time.monotonic(), self.heard.count[0], self.heard.published.number
        try:
            asked = _session(*self.heard.session()), self._variant, self._own
            if len(asked[0].readings) > _READINGS_APART:
                found = Calculation(partial(LiveMap.of_session, *asked)).outcome(untold)
            else:
                found = LiveMap.of_session(*asked)
            self.why_not = ""
            # Else another session has begun, or the estimator's map is newer.
            if (run, published) == (self.heard.count[0], self.heard.published.number):
                self._show(found)
        except CalibrationError as error:
            self.why_not = str(error)
        except Exception as error:
            self.why_not = f"unexpected {error!r} (a fault of mtcal itself; the terminal shows where it comes from)"
            logging.getLogger(__name__).error("a fault of the live map", exc_info=error)
        end = time.monotonic()
        self._due = end + max(_EVERY, _PAUSE_RATIO * (end - begin))
        self._working, self.calculating = None, (0.0, 0)

    def _show(self, found: LiveMap | None) -> None:
        self.map, self.number = found, self.number + 1
        if found is None:
            self.fall = []
        elif found.error_map.determined:
            self.fall.append((len(found.row), found.error_map.determined, found.error_map.largest_expanded))


def _session(description: str, readings: Sequence[Reading], *, check: bool = True) -> Session:
    if not readings:
        raise CalibrationError("no readings have come yet")
    if not description:
        raise CalibrationError("no session has been described yet (topic session)")
    return live_session(description, readings, check=check)


def _written(session: Session) -> Path:
    from machine_tool_calibration.nodes.measurement import free_folder  # needs ROS 2, as what was heard does

    folder = free_folder("live", None)
    write_session(session, folder)
    return folder
