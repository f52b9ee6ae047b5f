#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""From a checkout and a bare Python to a running `mtcal`, in one command.

    python3 scripts/bootstrap.py demo [OPTIONS]     install, then `mtcal demo`
    python3 scripts/bootstrap.py test [OPTIONS]     install with the tests' tools, then pytest, which runs
                                                    ruff and mypy, too; in three processes (-n 0: in this one);
                                                    --long: the tests that take seconds, too
    python3 scripts/bootstrap.py install            install only; the command is then .venv/bin/mtcal

Everything goes into the checkout's folder .venv; the system's Python is not touched, root is not needed. Where a ROS 2
with rclpy is installed (and sourced) it is used; elsewhere rclpy comes as wheels. A checkout that this user may not
write is copied to the user's cache first. Only the standard library is used here, and only syntax that an old Python
reads too, so that it can say what it needs.
"""

from __future__ import annotations

import ast
import fcntl
import hashlib
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

OLDEST = (3, 11)
CANDIDATES = ("python3.12", "python3.11", "python3.13", "python3.14")
ROOT = Path(__file__).resolve().parent.parent
SOURCES = (
    "CHANGELOG.rst", "CONTRIBUTING.md", "LICENSE", "MANIFEST.in", "README.md", "package.xml", "pyproject.toml",
    "setup.cfg", "setup.py", "config", "examples", "launch", "msg_docs", "resource", "scripts", "src",
)  # fmt: skip
NOT_SOURCES = ("__pycache__", "*.egg-info", "*.pyc")
NOT_COPIED = (".git", ".venv", "build", "install", "log", ".*_cache", *NOT_SOURCES)
ROS_CHECK = "import rclpy, diagnostic_msgs.msg, rosgraph_msgs.msg, sensor_msgs.msg, std_srvs.srv, trajectory_msgs.msg"
# Tests of one module run in one process, which makes their fixtures once; tests/conftest.py has the modules' order.
# Those of nodes wait much of their time: three processes keep two cores busy.
AT_ONCE = ("-n", "3", "--dist", "loadscope", "--no-loadscope-reorder")
# Of a whole run: to rewrite all assertions takes each process longer than to import the tests. What failed says its
# variables here, and what was compared when it is called by its name.
WHOLE = ("--assert=plain", "--showlocals")
WHEELS_MARK = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"


class BootstrapError(Exception):
    """Something that only the user can change."""


def main() -> None:
    """Prepare the environment and hand over to what was asked for."""
    action, arguments = (sys.argv[1] if len(sys.argv) > 1 else ""), sys.argv[2:]
    if action not in ("demo", "test", "install"):
        sys.stderr.write(__doc__ or "")
        sys.exit(0 if action in ("-h", "--help") else 2)
    try:
        use_recent_python()
        work_in_a_writable_checkout()
        environment = Path(ROOT, ".venv")
        lock = os.open(ROOT, os.O_RDONLY)
        fcntl.flock(lock, fcntl.LOCK_EX)  # one preparation at a time; released when another program takes over
        prepare(environment, {"ros", "test"} if action == "test" else {"ros"})
    except BootstrapError as error:
        sys.exit(f"bootstrap: {error}")
    except KeyboardInterrupt:
        sys.exit("bootstrap: interrupted")
    if action == "demo":
        hand_over(environment, ["mtcal", "demo", *arguments])
    elif action == "test":
        of_all_rooms = WHOLE if set(arguments) <= {"--long"} else ()
        hand_over(environment, ["python", "-m", "pytest", *AT_ONCE, *of_all_rooms, *arguments], ROOT)
    else:
        say(f"the command is {environment / 'bin' / 'mtcal'}")


def say(text: str) -> None:
    """Tell the user, on standard error."""
    sys.stderr.write(f"bootstrap: {text}\n")
    sys.stderr.flush()


def use_recent_python() -> None:
    """Start again with a Python that is recent enough, if this one is not."""
    if sys.version_info >= OLDEST:
        return
    for name in CANDIDATES:
        python = shutil.which(name)
        # A name on the path may be a shim without a Python behind it.
        if python and subprocess.call([python, "-c", ""], stderr=subprocess.DEVNULL, env=clean_environment()) == 0:
            os.execve(python, [python, *sys.argv], clean_environment())
    raise BootstrapError(
        f"needs Python {OLDEST[0]}.{OLDEST[1]} or later; this is {sys.version.split()[0]} and none of "
        f"{', '.join(CANDIDATES)} is on the path"
    )


def work_in_a_writable_checkout() -> None:
    """Start again in a copy of the checkout, if this user may not write here."""
    existing = Path(ROOT, ".venv")
    if os.access(ROOT, os.W_OK) and (not existing.exists() or os.access(existing, os.W_OK)):
        return
    name = f"checkout-{hashlib.sha256(str(ROOT).encode()).hexdigest()[:12]}"
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    for folder in (cache / "machine_tool_calibration", Path(tempfile.gettempdir(), f"mtcal-{os.getuid()}")):
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK) and folder.stat().st_uid == os.getuid():
            break
    else:
        raise BootstrapError(f"{ROOT} cannot be written, nor can a folder for a copy of it")
    copy = folder / name
    say(f"{ROOT} is not yours to write: working in the copy {copy}")
    for entry in copy.iterdir() if copy.exists() else ():
        if entry.name not in (".venv", "mtcal_output"):
            shutil.rmtree(entry) if entry.is_dir() and not entry.is_symlink() else entry.unlink()
    shutil.copytree(ROOT, copy, symlinks=True, dirs_exist_ok=True, ignore=shutil.ignore_patterns(*NOT_COPIED))
    os.chdir(copy)
    os.execve(this_python(), [this_python(), str(copy / "scripts" / "bootstrap.py"), *sys.argv[1:]], os.environ)


def this_python() -> str:
    """The Python that runs this; it does not know it itself where PATH is not set."""
    return sys.executable or str(Path("/proc/self/exe").resolve())


def prepare(environment: Path, extras: set[str]) -> None:
    """Make the environment, or bring it up to date; nothing is done if it is."""
    python = environment / "bin" / "python"
    stamp = environment / "mtcal.json"
    base = Path(getattr(sys, "_base_executable", None) or this_python()).resolve()
    wanted = {"python": sys.version, "base": str(base), "checkout": str(ROOT)}
    found = read_stamp(stamp)
    if not python.exists() or any(found.get(key) != value for key, value in wanted.items()):
        found = {"ros": create(environment, base), "extras": []}
    wanted["sources"] = digest()
    extras = extras | set(found["extras"])
    if found.get("sources") != wanted["sources"] or extras != set(found["extras"]):
        stamp.unlink(missing_ok=True)
        asked = sorted(extras - {"ros"} if found["ros"] == "system" else extras)
        say(f"installing into {environment}" + ("" if found.get("sources") else " (some minutes, once)"))
        install(python, asked)
        stamp.write_text(json.dumps({**wanted, "ros": found["ros"], "extras": sorted(extras)}, indent=1))


def read_stamp(stamp: Path) -> dict:  # type: ignore[type-arg]
    """What the environment was made for; empty if it was not finished."""
    try:
        return dict(json.loads(stamp.read_text()))
    except (OSError, ValueError):
        return {}


def digest() -> str:
    """A fingerprint of everything that is installed."""
    total = hashlib.sha256()
    for name in SOURCES:
        path = ROOT / name
        for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
            if file.is_file() and "__pycache__" not in file.parts and not file.parent.name.endswith(".egg-info"):
                total.update(f"{file.relative_to(ROOT)}\0{os.access(file, os.X_OK)}\0".encode())
                total.update(file.read_bytes())
    return total.hexdigest()


def create(environment: Path, base: Path) -> str:
    """Make an empty environment with pip.

    Returns:
        Where rclpy comes from: `system` or `wheels`.
    """
    if subprocess.call([str(base), "-c", ROS_CHECK], stderr=subprocess.DEVNULL, env=clean_environment()) == 0:
        make_venv(environment, base, "--system-site-packages")
        python = str(environment / "bin" / "python")
        if subprocess.call([python, "-c", ROS_CHECK], stderr=subprocess.DEVNULL, env=clean_environment()) == 0:
            say("rclpy is there already: using it")
            return "system"
    make_venv(environment, base)
    return "wheels"


def make_venv(environment: Path, base: Path, *options: str) -> None:
    """Make an environment with pip, also where Debian has split `ensurepip` off."""
    say(f"making {environment} with Python {sys.version.split()[0]}")
    command = [str(base), "-m", "venv", "--clear", *options]
    if importlib.util.find_spec("ensurepip"):
        run([*command, str(environment)], "cannot make an environment")
        return
    run([*command, "--without-pip", str(environment)], "cannot make an environment")
    python = str(environment / "bin" / "python")
    run(
        [str(base), "-m", "pip", "install", "--quiet", "--target", libraries(python), "pip"],
        "this Python has neither ensurepip nor a pip that works: install one of them (Debian: python3-venv)",
    )


def libraries(python: str) -> str:
    """The folder into which pip installs for that Python."""
    where = "import sysconfig; print(sysconfig.get_path('purelib'))"
    return subprocess.check_output([python, "-c", where], env=undisturbed_environment(), text=True).strip()


def install(python: Path, extras: list[str]) -> None:
    """Install the package from a copy, so that no build leaves anything in the checkout or finds anything stale."""
    with tempfile.TemporaryDirectory(prefix="mtcal-") as folder:
        ignore = shutil.ignore_patterns(*NOT_SOURCES)
        for name in SOURCES:
            source = ROOT / name
            if source.is_dir():
                shutil.copytree(source, Path(folder, name), symlinks=True, ignore=ignore)
            elif source.exists():
                shutil.copy2(source, folder)
        wanted = f"{folder}[{','.join(extras)}]" if extras else folder
        if not installed_by_uv(str(python), wanted, beside_ros="ros" not in extras):
            pip = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-compile"]
            run([*pip, wanted], "pip could not install it; its messages are above")
    compile_all(str(python), libraries(str(python)))


def installed_by_uv(python: str, wanted: str, beside_ros: bool) -> bool:
    """Whether uv could install it, which takes it a sixth of pip's time.

    It is not asked where rclpy is the system's: it does not see the libraries that are there, and would put a NumPy
    beside them that they were not made for; nor where pip is told what uv cannot be.
    """
    options = None if beside_ros else uv_options(python)
    if options is None or not succeeds([python, "-m", "pip", "install", "--quiet", "uv"]):
        return False
    command = [python, "-m", "uv", "pip", "install", "--quiet", "--python", python, *options]
    return succeeds([*command, "--reinstall-package", "machine_tool_calibration", wanted])


def succeeds(command: list[str]) -> bool:
    """Whether a step does what it should; what it says of it is not shown."""
    return subprocess.run(command, env=undisturbed_environment(), capture_output=True).returncode == 0


UV_OPTIONS = {
    "index-url": "--default-index", "extra-index-url": "--index", "find-links": "--find-links",
    "constraint": "--constraint",
}  # fmt: skip
NOT_UVS = {"no-index", "trusted-host", "client-cert", "proxy", "only-binary", "no-binary", "pre", "requirement", "user"}


def uv_options(python: str) -> list[str] | None:
    """What pip is configured to do (pip.conf, PIP_... variables), for uv; None where uv has no word for it."""
    listed = [python, "-m", "pip", "config", "list"]
    done = subprocess.run(listed, env=undisturbed_environment(), capture_output=True, text=True)
    if done.returncode != 0:
        return None
    # as pip chooses among several indexes
    options = ["--index-strategy", "unsafe-best-match"]
    for line in done.stdout.splitlines():
        name, _, value = line.partition("=")
        name = name.rpartition(".")[2]
        if name in NOT_UVS:
            return None
        if name in UV_OPTIONS:
            for one in ast.literal_eval(value).split():
                options += [UV_OPTIONS[name], one]
    return options


# Libraries that are large and of which hardly anything is imported here, or that come compiled to machine code.
SELDOM = ("mypy", "mypyc", "pip", "plotly", "pygments/lexers", "setuptools")


def compile_all(python: str, folder: str) -> None:
    """Compile what is installed, on all processors; pip would on one, and the libraries' own tests as well.

    What cannot be compiled is none of ours: Python tries again where it is imported.
    """
    what = (
        "import compileall, re, sys; folder = sys.argv[1]; rest = re.compile("
        f"re.escape(folder) + r'/(?:.*/tests?|{'|'.join(SELDOM)})/'); "
        "compileall.compile_dir(folder, quiet=2, workers=0, rx=rest)"
    )
    subprocess.call([python, "-c", what, folder], env=undisturbed_environment(), stderr=subprocess.DEVNULL)


def run(command: list[str], problem: str) -> None:
    """Run a step of the preparation."""
    done = subprocess.run(
        command, env=undisturbed_environment(), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    if done.returncode != 0:
        sys.stderr.write(done.stdout)
        raise BootstrapError(problem)


def undisturbed_environment() -> dict[str, str]:
    """The clean environment without what would lead Python or pip into another folder."""
    environment = clean_environment()
    for name in ("PYTHONPATH", "PYTHONHOME", "PIP_TARGET", "PIP_PREFIX", "PIP_USER", "PIP_REQUIRE_VIRTUALENV"):
        environment.pop(name, None)
    return environment


def clean_environment() -> dict[str, str]:
    """The environment of this process without what ROS wheels of another Python have set for themselves."""
    environment = dict(os.environ)
    if environment.pop(WHEELS_MARK, None):
        paths = environment.pop("LD_LIBRARY_PATH", "").split(os.pathsep)
        kept = [path for path in paths if path and not belongs_to_wheels(Path(path))]
        if kept:
            environment["LD_LIBRARY_PATH"] = os.pathsep.join(kept)
    return environment


def belongs_to_wheels(path: Path) -> bool:
    """Whether a library folder is one of a Python environment's."""
    return "site-packages" in path.parts or path == Path(sys.prefix, "lib") or Path(path.parent, "pyvenv.cfg").exists()


def hand_over(environment: Path, command: list[str], folder: Path | None = None) -> None:
    """Become the command, with the environment's programs first on the path."""
    variables = clean_environment()
    programs = environment / "bin"
    variables["VIRTUAL_ENV"] = str(environment)
    variables["PATH"] = os.pathsep.join([str(programs), variables.get("PATH", os.defpath)])
    variables.pop("PYTHONHOME", None)
    if folder is not None:
        os.chdir(folder)
    program = programs / command[0]
    if not program.exists():
        sys.exit(f"bootstrap: {program} is missing: remove {environment} and try again")
    os.execve(program, [str(program), *command[1:]], variables)


if __name__ == "__main__":
    main()
