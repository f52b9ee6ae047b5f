#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Swap operators of the calculating rooms at random, and see whether the room's own tests notice.

    .venv/bin/python scripts/swaps.py --count 40 --seed 1              # anywhere in the rooms
    .venv/bin/python scripts/swaps.py --at effects/warmup.py:35          # every swap of that line
    .venv/bin/python scripts/swaps.py --count 10 estimation            # in that folder or file

One swap at a time is made in a copy of the sources; the checkout stays as it is. The test file of the same name runs
first, then those that import the module, the folder's others, and the room's. Without one that fails the swap lives: a
test is missing, or the swap changes nothing that one could notice. The tests that caught a swap must pass without it.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import os
import random
import resource
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "machine_tool_calibration"
ROOMS = (
    *("estimation", "residuals", "model", "effects", "methods", "instruments", "machine", "maps.py", "budget"),
    *("diagnosis", "planning", "procedure", "session", "export", "trends"),
)
# What takes long to import and is none of ours: loaded once, before the first child.
HEAVY = ("hypothesis", "matplotlib.pyplot", "mcap", "numpy", "pandas", "pydantic", "pyarrow", "rich", "scipy.optimize")
SECONDS = (
    150  # of the processor for one run of tests, and of time for one test: a swap may make a loop or a wait endless
)

SWAPPED: dict[type, tuple[str, str]] = {
    **{ast.Add: ("+", "-"), ast.Sub: ("-", "+"), ast.Mult: ("*", "/"), ast.Div: ("/", "*"), ast.FloorDiv: ("//", "*")},
    **{
        ast.Mod: ("%", "//"),
        ast.Pow: ("**", "*"),
        ast.BitAnd: ("&", "|"),
        ast.BitOr: ("|", "&"),
        ast.BitXor: ("^", "|"),
    },
    **{ast.Eq: ("==", "!="), ast.NotEq: ("!=", "=="), ast.Lt: ("<", ">"), ast.Gt: (">", "<"), ast.LtE: ("<=", ">=")},
    **{ast.GtE: (">=", "<="), ast.Is: ("is", "is not"), ast.IsNot: ("is not", "is"), ast.In: ("in", "not in")},
    **{ast.NotIn: ("not in", "in"), ast.And: ("and", "or"), ast.Or: ("or", "and")},
}


@dataclass(frozen=True)
class Swap:
    """Characters `start` to `stop` of a file's text become `new`."""

    path: Path
    line: int
    start: int
    stop: int
    new: str

    def applied(self, text: str) -> str:
        """The file's text with the swap."""
        return text[: self.start] + self.new + text[self.stop :]

    def told(self, text: str) -> str:
        """The place, and what becomes what."""
        line = text.splitlines()[self.line - 1].strip()
        return f"{self.path}:{self.line}: {text[self.start : self.stop]} -> {self.new.strip()}   {line}"


def swaps_of(path: Path, text: str) -> Iterator[Swap]:
    """Every swap in a file: operators, comparisons, signs of numbers; none in annotations and texts."""
    data = text.encode()
    lines = [0]
    for line in data.splitlines(keepends=True):
        lines.append(lines[-1] + len(line))

    def place(line: int, column: int) -> int:
        return len(data[: lines[line - 1] + column].decode())

    def between(left: ast.expr, right: ast.expr, kind: type) -> Iterator[Swap]:
        old, new = SWAPPED.get(kind, ("", ""))
        start, stop = place(left.end_lineno or 0, left.end_col_offset or 0), place(right.lineno, right.col_offset)
        at = text.find(old, start, stop)
        if old and at >= 0:
            yield Swap(path, text.count("\n", 0, at) + 1, at, at + len(old), new)

    def walk(node: ast.AST) -> Iterator[Swap]:
        match node:
            case ast.BinOp() | ast.AugAssign():
                ends = (node.left, node.right) if isinstance(node, ast.BinOp) else (node.target, node.value)
                yield from between(*ends, type(node.op))
            case ast.Compare():
                for left, kind, right in zip([node.left, *node.comparators], node.ops, node.comparators, strict=False):
                    yield from between(left, right, type(kind))
            case ast.BoolOp():
                for left, right in zip(node.values, node.values[1:], strict=False):
                    yield from between(left, right, type(node.op))
            case ast.UnaryOp(op=ast.USub()):
                at = place(node.lineno, node.col_offset)
                yield Swap(path, node.lineno, at, at + 1, "")
            case ast.Constant(value=int() | float() as value) if value and not isinstance(value, bool):
                start, stop = (place(node.lineno, node.col_offset), place(node.lineno, node.end_col_offset or 0))
                yield Swap(path, node.lineno, start, stop, f"(-{text[start:stop]})")
        for name, child in ast.iter_fields(node):
            if name in ("annotation", "returns") or isinstance(child, ast.JoinedStr):
                continue
            for each in child if isinstance(child, list) else [child]:
                # -1 becomes 1 by its sign; the number itself would become the same.
                skipped = isinstance(node, ast.UnaryOp) and isinstance(each, ast.Constant)
                if isinstance(each, ast.AST) and not isinstance(each, ast.JoinedStr) and not skipped:
                    yield from walk(each)

    yield from walk(ast.parse(text))


def stages(path: Path) -> Iterator[list[Path]]:
    """Test files of a module of the package: its folder's, the nearest first, and then the others of its room."""
    tests = ROOT / "tests"
    room = next(tests / r for r in ROOMS if path == Path(r) or Path(r) in path.parents)
    if room.suffix:
        yield [tests / f"test_{path.name}"]
        return
    within = sorted(room.rglob("test_*.py"), key=lambda file: file.stat().st_size)
    name = ".".join((PACKAGE, *path.with_suffix("").parts)).removesuffix(".__init__")
    mirror = tests / path.parent / f"test_{path.name}"
    near = [file for file in within if file == mirror or f"{name} " in file.read_text()]
    near.sort(key=lambda file: file != mirror)
    folder = [file for file in within if (tests / path.parent) in file.parents and file not in near]
    yield near + folder
    yield [file for file in within if file not in near and file not in folder]
    if path.name == "spec.py":  # what a method asks of its sessions is tested with the sessions
        yield sorted((tests / "session").glob("test_*.py"))
    yield [tests / "test_constants.py"]


class _FirstFailure:
    """A plugin of pytest: runs tests in the order in which they are named, and writes which failed into a pipe."""

    def __init__(self, pipe: int, order: list[str]) -> None:
        self.pipe = pipe
        self.order = {name: number for number, name in enumerate(order)}

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items.sort(key=lambda item: self.order.get(str(item.path), 0))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            os.write(self.pipe, f"{report.nodeid}\n".encode())

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed:
            os.write(self.pipe, f"{report.nodeid}\n".encode())


def failures(tree: Path, tests: list[str], *options: str) -> list[str]:
    """Tests that fail with the sources in `tree`, run in a child that has imported nothing of them yet."""
    if not tests:
        return []
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, 1)
        os.dup2(nothing, 2)
        sys.path.insert(0, str(tree))
        os.environ["PYTHONPATH"] = str(tree)
        always = ["-q", "-n", "0", "-p", "no:cacheprovider", "-c", str(ROOT / "pyproject.toml"), f"--rootdir={ROOT}"]
        code = pytest.main([*always, f"--timeout={SECONDS}", *options, *tests], [_FirstFailure(writing, tests)])
        os._exit(code)
    os.close(writing)
    with os.fdopen(reading) as lines:
        failed = lines.read().split("\n")[:-1]
    _, status = os.waitpid(child, 0)
    code = os.waitstatus_to_exitcode(status)
    fine = (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED)
    return failed or ([] if code in fine else [f"(ended with {code})"])


def catcher(swap: Swap, tree: Path, near: bool, sound: dict[str, bool]) -> str | None:
    """The first test that notices a swap; None if none of the room does, or of the folder alone.

    Args:
        swap: it.
        tree: where a copy of the package is.
        near: whether the folder's tests are enough.
        sound: of tests that failed before, whether they pass without a swap; added to here.
    """
    file = tree / PACKAGE / swap.path
    text = file.read_text()
    try:
        for tests in stages(swap.path):
            file.write_text(swap.applied(text))
            left_out = [f"--deselect={name}" for name, passes in sound.items() if not passes]
            while caught := failures(tree, [str(test) for test in tests], "-x", *left_out):
                (test,) = caught[:1]
                if test not in sound and not test.startswith("("):
                    file.write_text(text)
                    sound[test] = not failures(tree, [str(ROOT / test)])
                    file.write_text(swap.applied(text))
                if sound.get(test, True):
                    return test
                left_out.append(f"--deselect={test}")
            if near and tests:
                break
    finally:
        file.write_text(text)
    return None


def chosen(arguments: argparse.Namespace, source: Path) -> list[Swap]:
    """The swaps that the command line asks for."""
    files = [
        file.relative_to(source)
        for room in ROOMS
        for file in (sorted((source / room).rglob("*.py")) if not room.endswith(".py") else [source / room])
    ]
    every = [swap for file in files for swap in swaps_of(file, (source / file).read_text())]
    if arguments.at:
        return [swap for swap in every if f"{swap.path}:{swap.line}" in arguments.at]
    within = [s for s in every if not arguments.within or any(str(s.path).startswith(w) for w in arguments.within)]
    return random.Random(arguments.seed).sample(within, min(arguments.count, len(within)))


def main() -> int:
    """Make the swaps and say which live."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("within", nargs="*", help="folders or files of the rooms, such as effects or methods/direct")
    parser.add_argument("--count", type=int, default=40, help="how many swaps (default 40)")
    parser.add_argument("--seed", type=int, default=0, help="which ones")
    parser.add_argument("--at", nargs="*", default=[], metavar="FILE:LINE", help="every swap of these lines instead")
    parser.add_argument("--near", action="store_true", help="run the folder's tests only, not the whole room's")
    parser.add_argument("--list", action="store_true", help="name the swaps only")
    arguments = parser.parse_args()
    source = ROOT / "src" / PACKAGE
    swaps = chosen(arguments, source)
    if arguments.list:
        print("\n".join(swap.told((source / swap.path).read_text()) for swap in swaps))
        return 0
    os.environ |= {"PYTHONDONTWRITEBYTECODE": "1", "OPENBLAS_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
    sys.dont_write_bytecode = True
    for name in HEAVY:
        with suppress(ImportError):
            importlib.import_module(name)
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "src"
        tree.mkdir()
        for name in ("config", "msg_docs", "package.xml"):  # which the package finds beside its sources
            (tree.parent / name).symlink_to(ROOT / name)
        # Whatever a swap writes or removes where it stands is not in the checkout.
        os.chdir(tree)
        # Without compiled files: a swap of the same length within a second would not be seen.
        shutil.copytree(source, tree / PACKAGE, ignore=shutil.ignore_patterns("__pycache__"))
        if broken := failures(tree, [str(ROOT / "tests" / "test_arrays.py")]):
            sys.exit(f"the tests do not run without a swap: {broken}")
        sound: dict[str, bool] = {}
        lives = []
        for number, swap in enumerate(swaps, 1):
            told, test = swap.told((source / swap.path).read_text()), catcher(swap, tree, arguments.near, sound)
            print(f"{number:3} {'caught' if test else 'LIVES '} {told}\n    {test or ''}", flush=True)
            lives += [] if test else [told]
    print("\n".join(f"fails without a swap: {name}" for name, passes in sound.items() if not passes))
    print(f"{len(swaps) - len(lives)} of {len(swaps)} caught\n" + "\n".join(lives))
    return 0


if __name__ == "__main__":
    sys.exit(main())
