# SPDX-License-Identifier: Apache-2.0
"""Errors of recordings."""

from __future__ import annotations

from machine_tool_calibration.errors import SessionError

__all__ = ["RecordingError", "UnfinishedError"]


class RecordingError(SessionError):
    """A recording that cannot be read or written; one line says which file and why."""


class UnfinishedError(RecordingError):
    """A recording whose recorder did not end it; `mtcal recover` makes it whole."""
