"""The command `mtcal`: finds its verbs, runs one, and turns every failure into one line and an exit status.

A verb is a module of this package that defines `command`, or a plugin of the entry-point group
`machine_tool_calibration.commands`. Verbs are imported when they run; the list of `mtcal --help` is read from their
source, so that it comes at once and a broken verb harms no other.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import NoReturn

import click

from machine_tool_calibration import __version__
from machine_tool_calibration.cli.output import one_line
from machine_tool_calibration.cli.verbs import OutputClosedError, Verbs
from machine_tool_calibration.errors import CalibrationError

__all__ = ["group", "main", "run"]

INTERRUPTED = 130
BROKEN_PIPE = 141
TRACEBACK_VARIABLE = "MTCAL_TRACEBACK"
HELP = """Calibrate a machine tool: from displacement readings to an error map, and to what the model lacks.

\b
mtcal demo                     the whole story on a simulated machine, in a minute
mtcal info SESSION             what was measured
mtcal identify SESSION         the machine's errors with their uncertainty
mtcal VERB --help              what a verb does and takes

A SESSION is a folder with session.yaml and observations.csv, or a recording (MCAP bag). With --json a verb writes one
JSON document for programs. Exit status: 0 done, 1 wrong input or request (one line says what and where), 2 wrong
command line.
"""


@click.group(cls=Verbs, help=HELP, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(__version__, prog_name="mtcal", message="%(prog)s %(version)s")
def group() -> None:
    """All verbs; what `--help` says is `HELP`."""


def main() -> NoReturn:
    """Entry point of the command."""
    sys.exit(run())


def run(arguments: Sequence[str] | None = None) -> int:
    """Run one verb.

    Args:
        arguments: the words of the command line after `mtcal`; those of this process if None.

    Returns:
        Exit status: 0 done; 1 the input or the request is wrong, told in one line on standard error; 2 wrong command
        line; 130 interrupted; 141 the reader of standard output went away.
    """
    try:
        status = group.main(args=arguments, prog_name="mtcal", standalone_mode=False)
    except OutputClosedError:
        # What is still buffered has no reader; without this the interpreter complains at its end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    except (KeyboardInterrupt, click.Abort):
        return _fail("interrupted", INTERRUPTED)
    except click.UsageError as error:
        error.show()
        return error.exit_code
    except click.ClickException as error:
        return _fail(error.format_message())
    except CalibrationError as error:
        return _fail(error)
    except OSError as error:
        return _fail(f"{error.filename}: {error.strerror}" if error.filename else error)
    except MemoryError:
        return _fail("not enough memory for this much data")
    except Exception as error:
        if os.environ.get(TRACEBACK_VARIABLE):
            raise
        return _fail(
            f"unexpected {type(error).__name__}: {error} (a fault of mtcal itself; "
            f"{TRACEBACK_VARIABLE}=1 shows where it comes from)"
        )
    return status if type(status) is int else 0


def _fail(reason: object, status: int = 1) -> int:
    click.echo(f"mtcal: {one_line(reason)}", err=True)
    return status
