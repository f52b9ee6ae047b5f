# SPDX-License-Identifier: Apache-2.0
"""The command `mtcal`: finds its verbs, runs one, and turns every failure into one line and an exit status.

A verb is a module of this package that defines `command`, or a plugin of the entry-point group
`machine_tool_calibration.commands`. Verbs are imported when they run; the list of `mtcal --help` is read from their
source, so that it comes at once and a broken verb harms no other. What is not asked for is neither read nor imported.
"""

from __future__ import annotations

import ast
import importlib
import io
import os
import pkgutil
import re
import sys
import warnings
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from machine_tool_calibration import __version__, cli
from machine_tool_calibration.cli.shared import note
from machine_tool_calibration.errors import CalibrationError, did_you_mean, one_line

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

PLUGIN_GROUP = "machine_tool_calibration.commands"
ROS_MODULES = ("rclpy", "rosgraph_msgs", "sensor_msgs", "std_msgs", "std_srvs", "trajectory_msgs", "diagnostic_msgs")
SECTIONS = {
    "Measure": ("demo", "workpiece", "plan", "align-pointer", "run", "simulate"),
    "Identify": ("info", "identify", "report", "features", "budget", "conformity", "enough"),
    "One machine over months, many machines": ("logbook", "check", "trend", "fleet"),
    "Find what the model lacks": ("compare", "compare-maps", "diagnose", "improve", "history", "workbench", "effects"),
    "Recordings and exchange": ("record", "play", "recover", "convert", "export"),
}
_LIGHT = ("effects", "history", "info")  # verbs that only read and show


class OutputClosedError(Exception):
    """Whatever read the standard output has gone."""


class Verbs(click.Group):
    """A click group whose commands are the modules of this package and the installed plugins."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run the verb; OutputClosedError instead of the BrokenPipeError that click would answer with exit status 1."""
        try:
            result = super().invoke(ctx)
            sys.stdout.flush()
        except BrokenPipeError as error:
            raise OutputClosedError from error
        return result

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of the verbs, plugins last."""
        own = sorted(_built_in())
        return [*own, *sorted(set(self._entry_points) - set(own))]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The verb of that name; None if there is none, a CalibrationError if it cannot be loaded."""
        if cmd_name in _built_in(cmd_name):
            return _load(cmd_name)
        if cmd_name in self._entry_points:
            return _load_plugin(self._entry_points[cmd_name])
        return None

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """The verb that the words begin with; a mistyped one is refused with what it may have meant."""
        name = args[0]
        if name in _LIGHT:
            # To start the threads of a linear algebra that is not needed takes a tenth of a second.
            os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        if name not in _built_in(name):
            hint = did_you_mean(name, self.list_commands(ctx))
            if hint and not ctx.resilient_parsing and self.get_command(ctx, name) is None:
                ctx.fail(f"No such command {name!r}{hint}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the verbs by what they are for, without importing those of this package."""
        summaries = _built_in()
        known = [name for names in SECTIONS.values() for name in names]
        entries = sorted(self._entry_points.items())
        plugins = {name: _load_plugin(entry) for name, entry in entries if name not in summaries}
        told = summaries | {name: _paragraph(one.help) for name, one in plugins.items() if one is not None}
        sections = SECTIONS | {"More": tuple(sorted(set(summaries) - set(known))), "Plugins": tuple(plugins)}
        for title, names in sections.items():
            # The first sentence, which does not end at "et al."
            rows = [(name, re.split(r"(?<!\bal)\. ", told[name])[0].rstrip(".")) for name in names if name in told]
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)

    @cached_property
    def _entry_points(self) -> dict[str, EntryPoint]:
        from importlib.metadata import entry_points  # here, because most starts ask for a verb of this package

        return {entry.name: entry for entry in entry_points(group=PLUGIN_GROUP)}


def _built_in(only: str | None = None) -> dict[str, str]:
    """Verbs among the modules of this package with the first paragraph of their help; with `only` that one alone."""
    verbs = {}
    for path in cli.__path__:
        for module in pkgutil.iter_modules([path]):
            name = module.name.replace("_", "-")
            if module.name.startswith("_") or only not in (None, name):
                continue
            file = f"{module.name}/__init__.py" if module.ispkg else f"{module.name}.py"
            if (summary := _summary(Path(path) / file)) is not None:
                verbs[name] = summary
    return verbs


def _summary(source: Path) -> str | None:
    """First paragraph of the help of the module's `command`; None if the module is no verb."""
    try:
        tree = ast.parse(source.read_bytes())
    except OSError:
        return None
    except (SyntaxError, ValueError):
        return "(cannot be loaded)"
    for node in tree.body:
        if isinstance(node, ast.FunctionDef) and node.name == "command":
            return _paragraph(ast.get_docstring(node) or ast.get_docstring(tree))
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        if any(isinstance(target, ast.Name) and target.id == "command" for target in targets):
            return _paragraph(ast.get_docstring(tree))
    return None


def _paragraph(text: str | None) -> str:
    return one_line((text or "").strip().split("\n\n")[0])


def _needs_ros(error: ModuleNotFoundError) -> str:
    """What to do about a module of ROS that is missing; empty if it is another one."""
    if (error.name or "").split(".")[0] not in ROS_MODULES:
        return ""
    return (
        f"needs ROS 2 ({error.name} is missing): source your ROS 2 installation, or "
        "pip install 'machine_tool_calibration[ros]'"
    )


def _load(name: str) -> click.Command:
    module = f"{cli.__name__}.{name.replace('-', '_')}"
    try:
        command = importlib.import_module(module).command
    except ModuleNotFoundError as error:
        if needs := _needs_ros(error):
            raise CalibrationError(f"`mtcal {name}` {needs}") from error
        raise CalibrationError(f"`mtcal {name}` cannot be loaded: {error}") from error
    except Exception as error:
        raise CalibrationError(f"`mtcal {name}` cannot be loaded: {type(error).__name__}: {error}") from error
    if not isinstance(command, click.Command):
        raise CalibrationError(f"`mtcal {name}` cannot be loaded: {module}.command is no click command")
    return command


def _load_plugin(entry: EntryPoint) -> click.Command | None:
    """The plugin's command; None, with a warning, if it is broken."""
    try:
        command = entry.load()
        if isinstance(command, click.Command):
            return command
        problem = f"{entry.value} is no click command"
    except Exception as error:
        problem = f"{type(error).__name__}: {error}"
    note(f"mtcal: warning: the plugin {entry.name!r} is skipped: {one_line(problem)}")
    return None


_LONGEST, _ENDING = 1000, 100  # letters of a message
INTERRUPTED = 130
BROKEN_PIPE = 141
TRACEBACK_VARIABLE = "MTCAL_TRACEBACK"


@click.group(cls=Verbs, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(__version__, "-V", "--version", prog_name="mtcal", message="%(prog)s %(version)s")
def group() -> None:
    """Calibrate a machine tool: from displacement readings to an error map, and to what the model lacks.

    \b
    mtcal demo                     the whole story on a simulated machine, in a minute
    mtcal info SESSION             what was measured
    mtcal identify SESSION         the machine's errors with their uncertainty
    mtcal VERB --help              what a verb does and takes

    A SESSION is a folder with session.yaml and observations.csv, or a recording (MCAP bag). With --json a verb writes
    one JSON document for programs. Exit status: 0 done, 1 wrong input or request (one line says what and where), 2
    wrong command line.
    """


def main() -> NoReturn:
    """Entry point of the command."""
    sys.exit(run())


def run(arguments: Sequence[str] | None = None) -> int:
    """Run one verb by the words of the command line after `mtcal`, those of this process if None.

    Exit status: 0 done; 1 the input or the request is wrong, said in one line on standard error; 2 wrong command line;
    130 interrupted; 141 the reader of standard output went away.
    """
    _settle_streams()
    # To look for them goes through every installed package, and no record of ours is changed by one.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    try:
        with warnings.catch_warnings():
            # NumPy's, of an overflow or a 0 in a divisor: what comes of it is judged where it is used.
            warnings.simplefilter("default" if os.environ.get(TRACEBACK_VARIABLE) else "ignore", RuntimeWarning)
            status = group.main(args=arguments, prog_name="mtcal", standalone_mode=False)
    except OutputClosedError:
        # What is still buffered has no reader; without this the interpreter complains at its end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    except (KeyboardInterrupt, click.Abort) as error:  # the second is click's word for the first
        return _fail(str(error.__cause__ or error) or "interrupted", INTERRUPTED)
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
    except RecursionError:
        return _fail("the input is nested too deeply")
    except Exception as error:
        if isinstance(error, ModuleNotFoundError) and (needs := _needs_ros(error)):
            return _fail(f"this {needs}")
        if os.environ.get(TRACEBACK_VARIABLE):
            raise
        return _fail(
            f"unexpected {type(error).__name__}: {error} (a fault of mtcal itself; "
            f"{TRACEBACK_VARIABLE}=1 shows where it comes from)"
        )
    return status if type(status) is int else 0


def _settle_streams() -> None:
    """Replace what the encoding of the output lacks, such as the letter µ, instead of failing.

    What would be written to a stream that was closed before the start (`>&-`, some schedulers) goes nowhere.
    """
    sys.stdout = sys.stdout or os.fdopen(os.open(os.devnull, os.O_WRONLY), "w")
    sys.stderr = sys.stderr or os.fdopen(os.open(os.devnull, os.O_WRONLY), "w")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def _fail(reason: object, status: int = 1) -> int:
    text = one_line(reason)
    if len(text) > _LONGEST:  # a value without measure that was given, or a list of all that there is
        text = f"{text[: _LONGEST - _ENDING]} … {text[-_ENDING:]}"
    click.echo(f"mtcal: {text}", err=True)
    return status
