# SPDX-License-Identifier: Apache-2.0
"""Multilateration side by side: the solver of `mtcal identify`, plain NumPy, SciPy and, where installed, GTSAM.

    python benchmarks/multilateration.py --points 100000
    python benchmarks/multilateration.py --points 10000 1000000 --repeats 2 --missing 0.1 --effects 3

Four stations read all targets of a cubic metre with a beam that follows the target; targets, stations and dead paths
are unknown. Every contender runs in a process of its own, on the same readings. Times are the best of some runs, in
seconds; "cpu" is the processor time of the solve, which hardly depends on what else the machine does. Peak memory is
that of the whole process, and what it rose by beyond the data. "off by" is the largest difference of a target's
position from that of the first contender, after the common motion of all targets is taken out; the last column gives it
in units of the position's standard uncertainty. Targets that too few stations read are left out of it.

`plain` is the yardstick: what can be written in NumPy for exactly four stations, every target read once from each, and
nothing else, in four Gauss-Newton steps. The solver is general in the number of stations, repeats, readings missed and
effects.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

SIGMA = 3e-7
STATION_ERROR = 1.2e-5
STATIONS = np.array([[-1.0, 0.0, 0.0], [2.0, 0.0, 0.3], [0.5, 2.0, 0.0], [0.4, 0.5, 2.0]])
CHUNK = 8192


@dataclass(frozen=True)
class Case:
    """What is measured."""

    points: int
    repeats: int = 1
    missing: float = 0.0
    effects: int = 0
    open_loop: bool = False
    seed: int = 1


class Data:
    """Readings of a case; the estimate of each station's dead path is added to them."""

    def __init__(self, case: Case) -> None:
        rng = np.random.default_rng(case.seed)
        self.case, n, s = case, case.points, len(STATIONS)
        self.target = rng.random((n, 3))
        actual = self.target + rng.normal(size=(n, 3)) * 1e-5
        station = STATIONS + rng.normal(size=STATIONS.shape) * STATION_ERROR
        dead = rng.normal(size=s) * STATION_ERROR
        self.point = np.tile(np.arange(n), s * case.repeats)
        self.block = np.repeat(np.arange(s), n * case.repeats)
        self.path = np.empty(len(self.point))
        for k in range(s * case.repeats):
            here = slice(k * n, (k + 1) * n)
            which = k // case.repeats
            line = actual - station[which]
            if case.open_loop:
                beam = self.target - STATIONS[which]
                beam /= np.linalg.norm(beam, axis=1)[:, None]
                self.path[here] = np.einsum("nd,nd->n", line, beam)
            else:
                self.path[here] = np.linalg.norm(line, axis=1)
            self.path[here] += dead[which] + rng.normal(size=n) * SIGMA
        self.dense = rng.normal(size=(case.effects, len(self.path)))
        self.path += (rng.normal(size=case.effects) * 1e-6) @ self.dense
        if case.missing:
            keep = rng.random(len(self.path)) >= case.missing
            self.point, self.block, self.path = self.point[keep], self.block[keep], self.path[keep]
            self.dense = self.dense[:, keep]

    @property
    def datum(self) -> np.ndarray:
        """(6, 16 + K): no shift and no turn of the stations."""
        rows = np.zeros((6, 4, 4))
        for a in range(3):
            rows[a, :, a] = 1.0
            rows[3 + a, :, :3] = np.cross(np.eye(3)[a], STATIONS)
        return np.hstack([rows.reshape(6, 16), np.zeros((6, len(self.dense)))])

    def beams(self) -> np.ndarray | None:
        """(3, n) commanded directions, if the beam stays on them."""
        if not self.case.open_loop:
            return None
        line = (self.target[self.point] - STATIONS[self.block]).T
        return np.ascontiguousarray(line / np.linalg.norm(line, axis=0))


@dataclass
class Answer:
    """What a contender says, and what it cost (s)."""

    position: np.ndarray
    chi_square: float
    steps: int
    prepare: float
    solve: float
    processor: float
    covariance: float | None = None
    uncertainty: np.ndarray | None = None
    determined: np.ndarray | None = None


def timed(work: Callable[[], Any]) -> tuple[Any, float]:
    """What a function returns, and how long it took."""
    begin = time.perf_counter()
    value = work()
    return value, time.perf_counter() - begin


def timed_twice(work: Callable[[], Any]) -> tuple[Any, float, float]:
    """The same, with the processor time."""
    begin = time.process_time()
    value, wall = timed(work)
    return value, wall, time.process_time() - begin


# --- contenders -------------------------------------------------------------------------------------------------------


def run_mtcal(data: Data) -> Answer:
    """The solver of `mtcal identify`."""
    from machine_tool_calibration.estimation.points import points_in_inner_datum
    from machine_tool_calibration.estimation.problem import Problem, group_points
    from machine_tool_calibration.estimation.solve import solve
    from machine_tool_calibration.methods.tracking.datum import MultilaterationPart, NetworkMotion

    k, blocks = len(data.dense), np.arange(16).reshape(4, 4)
    beams = data.beams()

    def prepare() -> Problem:
        groups = group_points(data.point, data.block)
        sigma = np.full(len(data.path), SIGMA)
        nominal, stations = np.ascontiguousarray(data.target.T), np.ascontiguousarray(STATIONS.T)
        part = MultilaterationPart(
            groups, data.path, sigma, nominal, stations, beams, data.dense, blocks, 16 + np.arange(k)
        )
        return Problem([part], 16 + k, data.datum, np.zeros(6))

    problem, preparing = timed(prepare)
    solution, solving, processor = timed_twice(lambda: solve(problem))
    motion = NetworkMotion(data.target)
    theta_motion = np.vstack([motion.of_stations(STATIONS), np.zeros((k, motion.count))])

    def covariances() -> Any:
        target = np.ascontiguousarray(data.target.T)
        return points_in_inner_datum(
            problem.parts[0], solution, 0, lambda points: motion.at(target[:, points]), theta_motion
        )

    result, covariance = timed(covariances)
    uncertainty = np.sqrt(np.einsum("aan->an", result.covariance)).T
    good = result.determined
    # As the map of a tracking beam: the finite turn is taken out below, as of every contender.
    position = data.target + solution.local[0].T
    return Answer(
        position, solution.chi_square, solution.steps, preparing, solving, processor, covariance, uncertainty, good
    )


def run_plain(data: Data) -> Answer:
    """Plain NumPy for four stations that read every target once."""
    n = data.case.points
    path, target = data.path.reshape(4, n), np.ascontiguousarray(data.target.T)
    state: dict[str, Any] = {"target": target.copy(), "theta": np.zeros((4, 4)), "covariance": None, "cost": 0.0}
    free = np.linalg.svd(data.datum)[2][6:].T

    def rows(chunk: slice) -> tuple[np.ndarray, np.ndarray]:
        station = STATIONS.T + state["theta"][:, :3].T
        line = state["target"][:, None, chunk] - station[:, :, None]
        length = np.sqrt(np.einsum("dsn,dsn->sn", line, line))
        line /= length
        return line, path[:, chunk] - length + state["theta"][:, 3, None]

    def null(g: np.ndarray) -> np.ndarray:
        # The combination of the four readings in which the target's position drops out.
        def det(a: int, b: int, c: int) -> np.ndarray:
            x, y, z = g[:, a], g[:, b], g[:, c]
            return np.asarray(
                x[0] * (y[1] * z[2] - y[2] * z[1])
                - x[1] * (y[0] * z[2] - y[2] * z[0])
                + x[2] * (y[0] * z[1] - y[1] * z[0])
            )

        w = np.stack([det(1, 2, 3), -det(0, 2, 3), det(0, 1, 3), -det(0, 1, 2)])
        return np.asarray(w / np.sqrt(np.einsum("sn,sn->n", w, w)))

    def adjugate(g: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        h = np.einsum("asn,bsn->abn", g, g)
        out = np.empty_like(h)
        for a in range(3):
            for b in range(3):
                i, j, k, m = (a + 1) % 3, (a + 2) % 3, (b + 1) % 3, (b + 2) % 3
                out[a, b] = h[i, k] * h[j, m] - h[i, m] * h[j, k]
        return out, np.einsum("an,an->n", h[0], out[0])

    chunks = [slice(a, min(a + CHUNK, n)) for a in range(0, n, CHUNK)]

    def step() -> None:
        gram = np.zeros((17, 17))
        for chunk in chunks:
            g, residual = rows(chunk)
            w = null(g)
            columns = np.empty((17, g.shape[2]))
            for s in range(4):
                np.multiply(g[:, s], -w[s], out=columns[4 * s : 4 * s + 3])
                np.negative(w[s], out=columns[4 * s + 3])
            np.einsum("sn,sn->n", w, residual, out=columns[16])
            gram += columns @ columns.T
        inverse = np.linalg.inv(free.T @ gram[:16, :16] @ free)
        change = (free @ (inverse @ (free.T @ gram[:16, 16]))).reshape(4, 4)
        state["cost"] = (gram[16, 16] - gram[:16, 16] @ change.reshape(-1)) / SIGMA**2
        state["covariance"] = free @ inverse @ free.T * SIGMA**2
        moved = np.empty_like(target)
        for chunk in chunks:
            g, residual = rows(chunk)
            rest = residual + np.einsum("dsn,sd->sn", g, change[:, :3]) + change[:, 3, None]
            inverse_normal, determinant = adjugate(g)
            moved[:, chunk] = np.einsum("abn,bsn,sn->an", inverse_normal, g, rest, optimize=True) / determinant
        state["theta"] = state["theta"] + change
        state["target"] = state["target"] + moved

    def solve() -> None:
        for _ in range(4):
            step()

    _, solving, processor = timed_twice(solve)
    out = np.empty((3, 3, n))

    def covariances() -> None:
        q = state["covariance"]
        for chunk in chunks:
            g, _ = rows(chunk)
            inverse_normal, determinant = adjugate(g)
            response = np.einsum("abn,bsn->asn", inverse_normal / determinant, g)
            a = np.concatenate([-g, -np.ones((1, *g.shape[1:]))])
            flat = np.stack([q[:, 4 * s : 4 * s + 4] @ a[:, s] for s in range(4)])
            inner = np.einsum("ptn,sptn->stn", a, flat.reshape(4, 4, 4, -1).transpose(0, 2, 1, 3))
            out[:, :, chunk] = np.einsum("asn,stn,btn->abn", response, inner, response, optimize=True)
            out[:, :, chunk] += inverse_normal / determinant * SIGMA**2

    _, covariance = timed(covariances)
    return Answer(state["target"].T, float(state["cost"]), 4, 0.0, solving, processor, covariance)


def run_scipy(data: Data, tolerance: float | None) -> Answer:
    """least_squares with a sparse Jacobian and lsmr."""
    from scipy import optimize, sparse

    n, k, readings = data.case.points, len(data.dense), len(data.path)
    beams = data.beams()
    first = 16 + k
    index = np.arange(readings)
    columns = np.vstack(
        [4 * data.block + a for a in range(4)]
        + [np.full(readings, 16 + j) for j in range(k)]
        + [first + 3 * data.point + a for a in range(3)]
    )
    places = (np.tile(index, len(columns)), columns.reshape(-1))
    # The datum as six readings of high weight: it changes no other residual.
    held = sparse.csr_matrix(np.hstack([data.datum / SIGMA, np.zeros((6, 3 * n))]))

    def line(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        station = STATIONS + x[:16].reshape(4, 4)[:, :3]
        reach = data.target[data.point] + x[first:].reshape(n, 3)[data.point] - station[data.block]
        if beams is not None:
            return np.einsum("nd,dn->n", reach, beams), beams.T
        length = np.linalg.norm(reach, axis=1)
        return length, reach / length[:, None]

    def residual(x: np.ndarray) -> np.ndarray:
        length, _ = line(x)
        offset = x[:16].reshape(4, 4)[data.block, 3]
        return np.append((length - offset + x[16:first] @ data.dense - data.path) / SIGMA, held @ x)

    def jacobian(x: np.ndarray) -> Any:
        _, g = line(x)
        values = np.vstack([-g.T, -np.ones((1, readings)), data.dense, g.T]) / SIGMA
        inner = sparse.csr_matrix((values.reshape(-1), places), shape=(readings, first + 3 * n))
        return sparse.vstack([inner, held]).tocsr()

    options: dict[str, Any] = {"method": "trf", "tr_solver": "lsmr", "x_scale": "jac", "max_nfev": 100}
    if tolerance is not None:
        options |= {"ftol": tolerance, "xtol": tolerance, "gtol": tolerance}
        options |= {"tr_options": {"atol": 1e-14, "btol": 1e-14, "maxiter": 2000}}
    found, solving, processor = timed_twice(
        lambda: optimize.least_squares(residual, np.zeros(first + 3 * n), jacobian, **options)
    )
    return Answer(data.target + found.x[first:].reshape(n, 3), 2 * found.cost, found.nfev, 0.0, solving, processor)


def run_gtsam(data: Data) -> Answer:
    """GTSAM with the reading as a custom factor."""
    import gtsam

    if len(data.dense):
        raise ValueError("effects are not written for GTSAM")
    beams = data.beams()

    def station_key(k: int) -> int:
        return int(gtsam.symbol("s", k))

    def point_key(k: int) -> int:
        return int(gtsam.symbol("p", k))

    def factor(k: int) -> Any:
        s, p, path = int(data.block[k]), int(data.point[k]), float(data.path[k])
        beam = None if beams is None else beams[:, k]

        def error(this: Any, values: Any, jacobians: list[np.ndarray] | None) -> np.ndarray:
            own, local = values.atVector(this.keys()[0]), values.atVector(this.keys()[1])
            reach = data.target[p] + local - STATIONS[s] - own[:3]
            length = float(np.linalg.norm(reach)) if beam is None else float(reach @ beam)
            g = reach / length if beam is None else beam
            if jacobians is not None:
                jacobians[0] = np.append(-g, -1.0)[None]
                jacobians[1] = g[None]
            return np.array([length - own[3] - path])

        return gtsam.CustomFactor(noise, [station_key(s), point_key(p)], error)

    def datum(this: Any, values: Any, jacobians: list[np.ndarray] | None) -> np.ndarray:
        if jacobians is not None:
            for k in range(4):
                jacobians[k] = np.asfortranarray(data.datum[:, 4 * k : 4 * k + 4])
        return np.asarray(data.datum @ np.concatenate([values.atVector(key) for key in list(this.keys())]))

    noise = gtsam.noiseModel.Isotropic.Sigma(1, SIGMA)

    def prepare() -> tuple[Any, Any]:
        graph, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for k in range(4):
            start.insert(station_key(k), np.zeros(4))
        for k in range(data.case.points):
            start.insert(point_key(k), np.zeros(3))
        for k in range(len(data.path)):
            graph.add(factor(k))
        held = gtsam.noiseModel.Isotropic.Sigma(6, SIGMA)
        graph.add(gtsam.CustomFactor(held, [station_key(k) for k in range(4)], datum))
        return graph, start

    (graph, start), preparing = timed(prepare)
    parameters = gtsam.GaussNewtonParams()
    parameters.setRelativeErrorTol(1e-12)
    parameters.setAbsoluteErrorTol(1e-9)
    optimizer = gtsam.GaussNewtonOptimizer(graph, start, parameters)
    values, solving, processor = timed_twice(optimizer.optimize)
    local = np.array([values.atVector(point_key(k)) for k in range(data.case.points)])
    return Answer(
        data.target + local, 2 * graph.error(values), int(optimizer.iterations()), preparing, solving, processor
    )


@dataclass(frozen=True)
class Contender:
    """How to run one, and up to how many points it is worth waiting for."""

    run: Callable[[Data], Answer]
    title: str
    most: float = math.inf
    only_plain_cases: bool = False
    module: str = "numpy"


CONTENDERS = {
    "mtcal": Contender(run_mtcal, "mtcal"),
    "plain": Contender(run_plain, "plain NumPy, four stations only", only_plain_cases=True),
    "scipy": Contender(lambda data: run_scipy(data, None), "SciPy, default tolerances", 1e5, module="scipy"),
    "scipy_tight": Contender(lambda data: run_scipy(data, 1e-15), "SciPy, tight tolerances", 1e4, module="scipy"),
    "gtsam": Contender(run_gtsam, "GTSAM, Python factors", 2e3, module="gtsam"),
}


# --- one contender in a process of its own ----------------------------------------------------------------------------


def status(name: str) -> float:
    """A line of /proc/self/status in MB; NaN where there is none."""
    try:
        text = Path("/proc/self/status").read_text()
    except OSError:
        return math.nan
    return next((float(line.split()[1]) / 1e3 for line in text.splitlines() if line.startswith(name)), math.nan)


def forget_peak() -> None:
    """Let the peak of this process count from now on."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return


def child(name: str, case: Case, runs: int, file: Path) -> None:
    """Run one contender and leave its answer in a file."""
    data = Data(case)
    forget_peak()
    before = status("VmRSS")
    best: Answer | None = None
    for _ in range(runs):
        answer = CONTENDERS[name].run(data)
        if best is None or answer.solve < best.solve:
            best, previous = answer, best
        else:
            previous = answer
        if previous is not None and best.covariance is not None and previous.covariance is not None:
            best.covariance = min(best.covariance, previous.covariance)
    assert best is not None
    figures = {
        key: getattr(best, key) for key in ("chi_square", "steps", "prepare", "solve", "processor", "covariance")
    }
    figures |= {"peak": status("VmHWM"), "rise": status("VmHWM") - before, "readings": len(data.path)}
    arrays: dict[str, Any] = {"position": best.position, "target": data.target}
    if best.uncertainty is not None and best.determined is not None:
        arrays |= {"uncertainty": best.uncertainty, "determined": best.determined}
    np.savez(file, **arrays, figures=np.array(json.dumps(figures)))


def without_motion(position: np.ndarray, nominal: np.ndarray) -> np.ndarray:
    """Positions turned and shifted onto the nominal ones (Kabsch)."""
    middle, centre = position.mean(axis=0), nominal.mean(axis=0)
    u, _, vt = np.linalg.svd((position - middle).T @ (nominal - centre))
    return np.asarray((position - middle) @ (u @ vt) + centre)


def compare(case: Case, names: list[str], runs: int) -> None:
    """Run the contenders one after the other and print a table."""
    print(f"\n{case.points} points from four stations, repeats {case.repeats}, missing {case.missing:.0%}, ", end="")
    print(f"effects {case.effects}, beam {'on the commanded direction' if case.open_loop else 'following the target'}")
    print(f"{'':34}{'prepare':>9}{'solve':>9}{'cpu':>9}{'steps':>6}{'covar.':>9}{'peak MB':>9}{'rise MB':>9}", end="")
    print(f"{'chi2/n':>9}{'off by um':>12}{'in u':>9}")
    reference: dict[str, np.ndarray] = {}
    for name in names:
        contender = CONTENDERS[name]
        why = skipped(contender, case)
        if why:
            print(f"{contender.title:34}{why}")
            continue
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "answer.npz"
            command = [sys.executable, __file__, "--child", name, "--case", json.dumps(asdict(case))]
            done = subprocess.run(
                [*command, "--runs", str(runs), "--file", str(file)], capture_output=True, text=True, check=False
            )
            if done.returncode:
                singular = "Indeterminant" in done.stderr
                why = "the system is singular" if singular else done.stderr.strip().splitlines()[-1]
                print(f"{contender.title:34}{why}")
                continue
            with np.load(file) as content:
                answer = {key: content[key] for key in content.files}
        figures = json.loads(str(answer["figures"]))
        if not reference:
            reference = answer
        good = reference.get("determined", np.ones(case.points, dtype=bool))
        nominal = answer["target"][good]
        off = np.abs(
            without_motion(answer["position"][good], nominal) - without_motion(reference["position"][good], nominal)
        )
        relative = f"{(off / reference['uncertainty'][good]).max():9.1e}" if "uncertainty" in reference else ""
        covariance = "-" if figures["covariance"] is None else f"{figures['covariance']:.3f}"
        print(
            f"{contender.title:34}{figures['prepare']:9.3f}{figures['solve']:9.3f}{figures['processor']:9.3f}{figures['steps']:6}"
            f"{covariance:>9}{figures['peak']:9.0f}{figures['rise']:9.0f}"
            f"{figures['chi_square'] / figures['readings']:9.4f}{1e6 * off.max():12.2e}{relative}"
        )


def skipped(contender: Contender, case: Case) -> str:
    """Why a contender does not run; empty if it does."""
    if case.points > contender.most:
        return f"left out above {contender.most:.0f} points"
    if contender.only_plain_cases and (case.repeats > 1 or case.missing or case.effects or case.open_loop):
        return "cannot do this case"
    try:
        __import__(contender.module)
    except ImportError:
        return f"{contender.module} is not installed"
    return ""


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, nargs="+", default=[10_000, 100_000])
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("--missing", type=float, default=0.0, help="fraction of readings that are lost")
    parser.add_argument("--effects", type=int, default=0, help="further unknowns that enter every reading")
    parser.add_argument("--open-loop", action="store_true", help="the beam stays on the commanded direction")
    parser.add_argument("--contenders", nargs="+", choices=tuple(CONTENDERS), default=list(CONTENDERS))
    parser.add_argument("--runs", type=int, default=3, help="the best of so many runs is shown")
    parser.add_argument("--child", help=argparse.SUPPRESS)
    parser.add_argument("--case", help=argparse.SUPPRESS)
    parser.add_argument("--file", type=Path, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.child:
        child(chosen.child, Case(**json.loads(chosen.case)), chosen.runs, chosen.file)
        return
    for points in chosen.points:
        compare(
            Case(points, chosen.repeats, chosen.missing, chosen.effects, chosen.open_loop),
            chosen.contenders,
            chosen.runs,
        )


if __name__ == "__main__":
    main()
