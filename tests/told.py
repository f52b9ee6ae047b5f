# SPDX-License-Identifier: Apache-2.0
"""What a verb of `mtcal` says: its exit status, what it prints, its document."""

import json
from dataclasses import dataclass
from typing import Any

import pytest

from machine_tool_calibration.cli.main import run
from machine_tool_calibration.words import Said

__all__ = ["Told", "Verb", "keys"]


@dataclass(frozen=True)
class Told:
    """What was printed: standard output and standard error."""

    out: str
    err: str

    @property
    def document(self) -> Any:
        """The one JSON document on standard output, which holds no NaN."""
        return json.loads(self.out, parse_constant=pytest.fail)

    @property
    def text(self) -> str:
        """What people read, with single spaces."""
        return " ".join(self.out.split())


@dataclass(frozen=True)
class Verb:
    """Runs a verb in this process: `verb("identify", folder, "--json").document`."""

    capsys: pytest.CaptureFixture[str]

    def __call__(self, *words: object, status: int = 0) -> Told:
        """Run it; with the exit status that it must have."""
        self.capsys.readouterr()
        ended = run([str(word) for word in words])
        told = self.capsys.readouterr()
        assert ended == status, told.err
        return Told(told.out, told.err)

    def refused(self, *words: object) -> str:
        """The one line with which it refuses its input, on standard error, and nothing else."""
        told = self(*words, status=1)
        assert told.out == "" and told.err.count("\n") == 1 and "fault of mtcal" not in told.err, told
        return told.err


def keys(text: object) -> list[str]:
    """Keys of the texts that a text is made from, in their order: what it says, whatever its words."""
    if not isinstance(text, Said):
        return []
    within = text.values if isinstance(text.values, tuple) else (*text.values.values(),)
    own = [] if isinstance(text.values, tuple) else [text.key]
    return own + [key for part in within for key in keys(part)]
