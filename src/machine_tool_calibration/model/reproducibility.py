# SPDX-License-Identifier: Apache-2.0
"""What does not reproduce: every run and every mounting of an instrument has a smooth function of time of its own.

Repeats within a run show the repeatability, not the reproducibility: on a real machine the runs of an instrument differ
by slopes and bows that are no physical effect of the machine. They are random, alike in size, and part of every fit.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from machine_tool_calibration.arrays import (
    Array,
    BoolArray,
    IntArray,
    groups,
    in_order_of_appearance,
    inverse_root,
    means_of,
    occurrence,
    within,
)
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.estimation.marginal import Gram
from machine_tool_calibration.model.imperfection import scaled_values
from machine_tool_calibration.model.observations import SAME_DIRECTION, SAME_POSITION, Observations
from machine_tool_calibration.session.catalogue import spec_of

DRIFT = "drift"
"""Name of the family of functions of time that all runs of a session have in common."""
CURVES = "curves"
"""Name of that of what the machine's errors are between the nodes of tables."""

# Readings of a group for each degree, so that a short run is not all spread.
_FOR_A_DEGREE = 3
# Readings of repeats that are enough.
_ENOUGH = 20_000
_ROUNDING = 1e-9
# Groups of a family, and functions of them all, at most: the fit's time goes with the third power of these.
_MOST_GROUPS, _MOST_FUNCTIONS = 200, 300
# Sine of an angle, below which a circle has not gone on.
_TURNS = 1e-6
# A grid: so many rows at most, with so many readings each.
_MOST_ROWS, _IN_A_ROW = 60, 6


@dataclass(frozen=True)
class Family:
    """Groups of readings that have a random function each, all of one size."""

    name: str  # run, mounting, pass, centre, or rows of equal x
    group: IntArray  # (n,) index of the group of each reading, from 0
    shapes: Array  # (d, n) values of the group's d functions, of a size of about 1
    offsets_of_each: int = 1  # how many of a group's functions, the first, are offsets

    @property
    def count(self) -> int:
        """Number of groups."""
        return int(self.group.max(initial=-1)) + 1

    def columns(self) -> Array:
        """(count d, n) the functions of every group, group after group."""
        d, n = self.shapes.shape
        out = np.zeros((self.count, d, n))
        out[self.group, :, np.arange(n)] = self.shapes.T
        return out.reshape(-1, n)

    @property
    def offsets(self) -> BoolArray:
        """(count d,) which of the functions are offsets of their group."""
        return np.tile(np.arange(len(self.shapes)) < self.offsets_of_each, self.count)


def offsets_apart(family: IntArray, offset: BoolArray, seen: BoolArray) -> tuple[IntArray, IntArray]:
    """Families in which offsets that show have a size of their own.

    An offset comes from mounting and probing, a slope and a bow from heat: the size of one says nothing of the other.
    Offsets that the model absorbs, as where every run counts from its own zero, keep the size of the others: `seen`
    (u,) is whether the model leaves something of a function. Returned are the family (u,) of each, and for each family
    the one that it was, the new ones being last.
    """
    out, was = family.copy(), np.arange(int(family.max(initial=-1)) + 1)
    for k in was:
        own = (family == k) & offset
        if (own & seen).any() and not own[family == k].all():
            out[own] = len(was)
            was = np.append(was, k)
    return out, was


@dataclass(frozen=True)
class PureError:
    """Readings of the same thing (setup, place, direction of approach) without their mean.

    What a model lacks of the machine does not enter them: pure error, as against lack of fit.
    """

    # (u + 1, u + 1) inner products of [functions that do not reproduce, residual] there, over the declared uncertainty
    gram: Array
    dof: int  # degrees of freedom
    lost: int = 0  # those of readings that were left out, as there are many
    in_setups: bool = True  # whether what is read again is so in one setup; else in any

    def whole(self, squares: float, dof: float) -> tuple[float, float]:
        """A sum of squares and its degrees of freedom, as they are with the readings that were left out."""
        return squares * (dof + self.lost) / dof, dof + self.lost

    def outside(self, own: BoolArray, family: IntArray) -> Gram:
        """Without functions (u,) that the model has as unknowns of its `own`, such as the constants of runs."""
        held = self.gram[np.ix_(own, own)]
        values, vectors = np.linalg.eigh(held)
        kept = values > _ROUNDING * max(float(values.max(initial=0.0)), 1e-300)
        root = vectors[:, kept] / np.sqrt(values[kept])
        along = root.T @ self.gram[np.append(own, False)]
        left = self.gram - along.T @ along
        left[np.append(own, False)], left[:, np.append(own, False)] = 0.0, 0.0
        dof = max(self.dof - int(kept.sum()), 1)
        return Gram(left[:-1, :-1], left[:-1, -1], max(float(left[-1, -1]), 0.0), family, dof)


def reproducibility(observations: Observations) -> tuple[Family, ...]:
    """Families of what does not reproduce: at most three.

    Runs (a setup in one repeat, for one target) and mountings (a stretch of consecutive readings of one setup), which
    are one family where they are the same. Of direct deviations runs and passes over one axis; of a plate its runs, and
    the rows and columns of a grid of holes that were drilled one after the other; of circles runs and their centres.
    Where several sessions are fitted together, also what the machine does between the nodes of their tables.
    """
    return (*_of_session(observations), *_curves(observations))


def _of_session(observations: Observations, by_order: bool = False) -> tuple[Family, ...]:
    direct = spec_of(observations.session).reads_machine
    every = _of_direct(observations, by_order) if direct else _of_runs(observations, by_order)
    return tuple(family for family in every if family.shapes.any())


def _of_runs(observations: Observations, by_order: bool) -> Iterator[Family]:
    """Runs, and mountings where these are others."""
    clock, readings = observations.clock, observations.readings
    # Readings are in the order of time, in whatever order they are given.
    order = np.argsort(clock, kind="stable")
    keys = [readings.setup, readings.repeat]
    if "target" in spec_of(observations.session).columns(observations.session.description):
        keys.append(readings.labels["target"])
    run = in_order_of_appearance(groups(*keys))
    mounting = np.empty(len(readings), dtype=np.int64)
    mounting[order] = np.cumsum(np.r_[0, np.diff(readings.setup[order]) != 0])[: len(readings)]
    yield _family(observations, "run", run, by_order)
    mounting = in_order_of_appearance(mounting)
    if not np.array_equal(run, mounting):
        yield _family(observations, "mounting", mounting, by_order)


def _curves(observations: Observations) -> tuple[Family, ...]:
    if observations.curves is None:
        return ()
    return (Family(CURVES, np.zeros(len(observations), dtype=np.int64), observations.curves, offsets_of_each=0),)


def with_drift(observations: Observations) -> tuple[Family, ...]:
    """Families of runs, mountings and passes, and curves; and of many runs what they share: a smooth function of time.

    Runs that differ only because something drifts through all of them would otherwise count as that many random
    functions, which move the map. Few do not tell the one from the other. Where the machine's deviations are read
    themselves, a drift is the machine's own. Runs without times may have slopes, too, in the order of their readings,
    unless that is a raster over an area: a search looks for these as a pattern.
    """
    families = tuple(family for family in _of_session(observations, True) if not family.name.startswith("rows"))
    return (*families, *_slopes_of_setups(observations), *_drift(observations, families), *_curves(observations))


def _slopes_of_setups(observations: Observations) -> tuple[Family, ...]:
    """A slope of each setup over a single axis of which it reads a part: a scale, a beam or a part that stands aslant.

    Where the setup has an offset in the model. A search looks for these as a pattern.
    """
    setup, moved = groups(observations.readings.setup), np.flatnonzero(observations.moved)
    direct = spec_of(observations.session).reads_machine and not spec_of(observations.session).centred
    if not direct or len(moved) != 1 or not setup.max(initial=0) or _datum(observations) != "offset":
        return ()
    position = observations.position[:, moved[0]]
    slope = 2.0 * (position - means_of(setup, position)) / np.ptp(position)
    return (Family("setup", setup, slope[None], offsets_of_each=0),)


def _datum(observations: Observations) -> str | None:
    """What a session of directly read deviations knows of their zero."""
    return getattr(observations.session.description, "datum", None)


def _drift(observations: Observations, families: Sequence[Family]) -> tuple[Family, ...]:
    fewest = min((family.count for family in families), default=0)
    if fewest < 2 * len(priors.DRIFT) or not observations.timed or spec_of(observations.session).reads_machine:
        return ()
    scaled = scaled_values(observations.clock)
    if scaled is None:
        return ()
    weights = np.array(priors.DRIFT)[:, None]
    shapes = np.polynomial.legendre.legvander(scaled, len(weights)).T[1:] * weights
    return (Family(DRIFT, np.zeros(len(scaled), dtype=np.int64), shapes, offsets_of_each=0),)


def of_repeats(
    observed: Sequence[Observations], residuals: Sequence[Array], names: Sequence[str], *, in_setups: bool = True
) -> PureError | None:
    """What readings of the same thing tell of these families; None where too little was read again.

    The residuals (n,) of each session are over the declared uncertainty. In other setups the same is read again, too,
    beside an offset of each, unless that is to be `in_setups`.
    """
    columns, left, dof, lost = [], [], 0, 0
    for observations, residual in zip(observed, residuals, strict=True):
        place = observations.readings.alike(setup=in_setups)
        stride = -(-len(place) // _ENOUGH)
        some = np.flatnonzero(place % stride == 0)
        mine = groups(place[some])
        free = len(some) - int(mine.max(initial=-1)) - 1
        dof += free
        lost += len(place) - int(place.max(initial=-1)) - 1 - free
        families = [family.columns()[:, some] for family in with_drift(observations) if family.name in names]
        both = np.concatenate([*families, residual[some][None]])
        both -= np.array([means_of(mine, values) for values in both])
        if not in_setups:
            both, offsets = _beside_setups(both, mine, groups(observations.readings.setup[some]))
            dof -= offsets
        columns.append(both[:-1])
        left.append(both[-1])
    if dof < priors.ENOUGH_REPEATS:
        return None
    whole = block_diag(*(c @ c.T for c in columns), sum(r @ r for r in left))
    whole[-1, :-1] = whole[:-1, -1] = np.concatenate([c @ r for c, r in zip(columns, left, strict=True)])
    return PureError(whole, dof, lost, in_setups)


def _beside_setups(values: Array, place: IntArray, setup: IntArray) -> tuple[Array, int]:
    """Values (k, n) without their places' means beside an offset of each setup, too; and how many of these there are.

    What is all of offsets is nothing then, and no rounding.
    """
    offsets = np.eye(1 + setup.max())[setup].T
    offsets -= np.array([means_of(place, one) for one in offsets])
    squares = np.sum(offsets**2, axis=1)
    basis = inverse_root(offsets @ offsets.T, np.maximum(squares, _ROUNDING), _ROUNDING).T @ offsets
    left = values - (values @ basis.T) @ basis
    kept = np.sum(left**2, axis=1) > _ROUNDING * np.sum(values**2, axis=1)
    return np.where(kept[:, None], left, 0.0), len(basis)


def _family(observations: Observations, name: str, group: IntArray, by_order: bool = False) -> Family:
    """One with smooth functions of the groups' time; of many groups with fewer, of very many offsets of several."""
    count = int(group.max(initial=0)) + 1
    if count > _MOST_GROUPS:
        group = _several_alike(observations, group, -(-count // _MOST_GROUPS))
        return Family(name, group, _smooth(observations, group)[:1])
    return Family(name, group, _smooth(observations, group, by_order)[: max(_MOST_FUNCTIONS // count, 1)])


def _several_alike(observations: Observations, group: IntArray, several: int) -> IntArray:
    """(n,) index of so many groups each, one after the other, of the same setup and direction of approach.

    The mean of as many offsets scatters as that of all does. What passes there and back have in common would say
    nothing of what distinguishes the two directions.
    """
    readings = observations.readings
    ways = [np.sign(values) for name, values in readings.columns.items() if name.startswith("dir_")]
    count = np.bincount(group)
    alike = groups(*(np.round(np.bincount(group, values) / count) for values in (readings.setup, *ways)))
    place = occurrence(alike) // several
    return groups(alike[group], place[group])


def _smooth(observations: Observations, group: IntArray, by_order: bool = False) -> Array:
    """(3, n) weighted Legendre polynomials over each group's time; an offset alone where no time was recorded.

    With those of the order of its readings then, if they are asked for `by_order`.
    """
    time, weights = observations.clock, np.array(priors.SERIES if by_order or observations.timed else priors.SERIES[:1])
    scaled, degree = within(time, group), np.arange(len(weights))[:, None]
    flat = (np.bincount(group, np.abs(scaled)) == 0)[group]
    series = np.polynomial.legendre.legvander(scaled, len(weights) - 1).T * weights[:, None]
    determined = (np.bincount(group)[group] >= np.maximum(_FOR_A_DEGREE * degree, 2)) & (~flat | (degree == 0))
    return np.where(determined, series, 0.0)


def _of_direct(observations: Observations, by_order: bool) -> Iterator[Family]:
    """Setups; runs and passes over a single axis; rows and columns of a grid; otherwise runs."""
    yield from _setups(observations)
    moved = np.flatnonzero(observations.moved).tolist()
    run = observations.readings.repeat_of_setup
    if len(moved) >= 2:
        if _tell(observations.place, run):
            # The order of a raster is a place, too: without times what goes on with it is the machine's.
            yield _moved_aside(observations, _family(observations, "run", run))
        if spec_of(observations.session).centred:
            way = _ways_round(observations.direction, run)
            if _tell(observations.readings.alike(approach=False), way):
                yield Family("centre", way, observations.direction[:, moved].T.copy(), offsets_of_each=0)
            return
        yield from _rows(observations, moved)
        return
    # Of a place that each run reads once, what runs differ by is how readings scatter.
    in_a_run = np.bincount(groups(observations.readings.alike(), run))
    # Both passes of a run share what came over the axis before it, and a reversal shows between them.
    run = in_order_of_appearance(run if moved or np.median(in_a_run) >= 2 else observations.run)
    ways = in_order_of_appearance(passes_over(observations, moved[0])) if moved else run
    # Two runs there and back differ by what their passes do, and two passes by what the direction does.
    families = [("run", run, 2)] if np.array_equal(ways, run) else [("run", run, 3), ("pass", ways, 3)]
    for name, group, fewest in families:
        if group.max(initial=-1) + 1 >= fewest and _tell(observations.place, group):
            yield _family(observations, name, group, by_order)


def _moved_aside(observations: Observations, family: Family) -> Family:
    """The same along each direction that a run senses: a plate that slips or warms moves along x and along y."""
    if spec_of(observations.session).centred:
        return family
    along = observations.read_along
    sensed = np.zeros((int(family.group.max(initial=0)) + 1, len(along)))
    np.maximum.at(sensed, family.group, np.abs(along.T))
    if (np.sum(sensed > SAME_DIRECTION, axis=1) < 2).all():
        return family
    shapes = (family.shapes[:, None] * along).reshape(-1, len(observations))
    return replace(family, shapes=shapes, offsets_of_each=len(along) * family.offsets_of_each)


def _setups(observations: Observations) -> Iterator[Family]:
    """Offsets of setups that read the same as others, in several runs each, and have no offset in the model."""
    readings, same = observations.readings, observations.readings.alike(setup=False)
    if _datum(observations) != "none" or not len(readings):
        return
    setup = groups(readings.setup)
    several = np.bincount(np.unique(np.stack([same, setup]), axis=1)[0])[same] > 1
    if readings.repeat_of_setup.max() > setup.max() and _tell(same[several], groups(setup[several])):
        yield Family("setup", in_order_of_appearance(setup), several[None].astype(np.float64))


def _tell(place: IntArray, run: IntArray) -> bool:
    """Whether runs tell how they differ: several of them, or two that read enough of the same places."""
    read_again = len(np.unique(np.stack([place, run]), axis=1).T) - len(np.unique(place))
    return int(run.max(initial=-1)) + 1 >= priors.SEVERAL_RUNS or read_again >= priors.ENOUGH_REPEATS


def _rows(observations: Observations, moved: list[int]) -> Iterator[Family]:
    """Offsets of whole rows and columns of a grid, along and across them."""
    for j in moved:
        row = groups(np.round(observations.position[:, j] / SAME_POSITION))
        count = np.bincount(row)
        if priors.SEVERAL_RUNS <= len(count) <= _MOST_ROWS and np.median(count) >= _IN_A_ROW:
            yield Family(f"rows of equal {'xyz'[j]}", row, observations.direction[:, moved].T.copy(), offsets_of_each=0)


def _ways_round(direction: Array, run: IntArray) -> IntArray:
    """(n,) which way round a circle a reading belongs to, from its direction (n, 3) to the centre, run by run."""
    turn = np.cross(direction[:-1], direction[1:])
    turn[np.diff(run) != 0] = 0.0
    moving = np.flatnonzero(np.linalg.norm(turn, axis=1) > _TURNS)
    begins = np.diff(run, prepend=run[:1]) != 0
    begins[moving[1:][np.sum(turn[moving[1:]] * turn[moving[:-1]], axis=1) < 0.0]] = True
    return np.asarray(np.cumsum(begins))


def passes_over(observations: Observations, axis: int) -> IntArray:
    """(n,) which pass over the axis a reading belongs to: a pass ends where the axis turns, or a run ends."""
    position, readings = observations.position[:, axis], observations.readings
    step = np.diff(position)
    again = np.r_[False, np.diff(readings.repeat_of_setup) != 0]
    # The way to where the next run begins is none.
    sign = np.where((np.abs(step) > SAME_POSITION) & ~again[1:], np.sign(step), 0.0)
    turned = np.zeros(len(readings), dtype=bool)
    last = 0.0
    for k, s in enumerate(sign):
        # The second of two readings at a turning point begins the way back.
        ahead = s if s != 0.0 else (sign[k + 1] if k + 1 < len(sign) else last)
        turned[k + 1] = last != 0.0 and ahead == -last
        last = 0.0 if again[k + 1] else ahead or last
    return np.asarray(np.cumsum(turned | again))
