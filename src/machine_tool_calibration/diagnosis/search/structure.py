# SPDX-License-Identifier: Apache-2.0
"""Structure in the residuals, whether or not an effect explains it: functions of every covariate."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property, partial
from itertools import combinations, product

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray, groups, means_of, occurrence, within
from machine_tool_calibration.diagnosis.search.candidates import Candidate, ShapedColumns
from machine_tool_calibration.diagnosis.search.events import ENOUGH, Explained, events
from machine_tool_calibration.diagnosis.search.evidence import gram_of
from machine_tool_calibration.effects.lost_motion import LOST_MOTION_DEGREES
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.estimation.marginal import marginal_at, size_grid
from machine_tool_calibration.machine.error_motions import interpolation
from machine_tool_calibration.model.imperfection import scaled_values
from machine_tool_calibration.model.observations import SAME_DIRECTION, SAME_POSITION, Observations
from machine_tool_calibration.model.rigid_body import thinned
from machine_tool_calibration.residuals.covariates import covariates, sensed
from machine_tool_calibration.residuals.pool import Pool
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.session.table import NUMERIC_COLUMNS
from machine_tool_calibration.words import Said, named, say, together

_DEGREE = 4
_ORDERS = (1, 2, 3, 4, 5)
_SIGNS = ("dir_x", "dir_y", "dir_z", "dir_a", "dir_b", "dir_c")
_AIR = "temperature_air"
_ANGLES = ("a", "b", "c", "azimuth", "elevation", "normal")
# Setups whose slopes are tried one by one.
_MOST_SETUPS = 12
# Places whose reversal is tried one by one: of more, neighbours have much in common.
_MOST_PLACES = 25
# Lines across an axis at which a zone is tried to end, and corners that are looked at.
_LINES, _CORNERS = 20, 4
# Share of the variance of the turns at which places are read below which each has its own.
_ALWAYS = 0.01
# Columns that are projected at once, and the sum of squares of any column of zeros.
_BATCH, _NOTHING = 120, 1e-100


def structure_candidates(pool: Pool) -> list[Candidate]:
    """Functions of every covariate that varies, of each session for itself.

    Smooth functions of every one, periodic ones of angles, steps and waves in time. A function of time, a temperature,
    the rate of the air's or a direction of approach is also tried as a displacement along each machine axis, and along
    all at once; products of two axis positions show where the machine does not move as rigid bodies, those of a
    direction of approach and a position where lost motion is not the same everywhere.
    """
    out, outside = [], _Outside(pool)
    kinds = (_of_one, _products, _lost_motions, _constants_of_texts, _path_scales, _slopes)
    for k, (observations, piece) in enumerate(zip(pool.observations, pool.pieces, strict=True)):
        # Axes that cross in the middle of their travel have no product.
        functions = (f for kind in kinds for f in kind(observations) if len(f[2]))
        own = [Candidate.of_structure(c, how, (ShapedColumns((), columns),)) for c, how, columns in functions]
        if len(observations) >= ENOUGH:
            own += _zones(observations, partial(outside.explained, piece=piece))
            if np.ptp(observations.clock) > 0:
                residual = pool.residuals[piece] / pool.sigma[piece]
                own += events(observations, residual, partial(outside.explained, piece=piece))
        for candidate in own:
            shapes = tuple(ShapedColumns(s.shape, pool.only(s.columns, piece)) for s in candidate.shapes)
            assert candidate.dependence is not None
            label, (covariate, how) = pool.label(k), candidate.dependence
            of = (together((label, covariate), "") if label else covariate, how)
            out.append(replace(candidate, name=label + candidate.name, shapes=shapes, dependence=of))
    return out


class _Outside:
    """What the model, and what does not reproduce, leave of many columns."""

    def __init__(self, pool: Pool) -> None:
        self._pool = pool

    @cached_property
    def _sizes(self) -> set[tuple[float, ...]]:
        """Sizes of what does not reproduce beside which columns are looked at: none, and the likeliest."""
        gram = gram_of(self._pool, self._pool.screen(self._pool.spread[0]))
        likeliest = max(size_grid(gram), key=lambda one: one[2])[0]
        return {likeliest, (0.0,) * len(likeliest)}

    def explained(self, of: Callable[[float], Array], values: Array, piece: slice) -> list[Array]:
        """(s,) sums of squares that columns (d, n) of a session's readings explain, beside each of some sizes.

        The columns are those `of` each of some values (s,), such as periods.
        """
        pool, d, ratios = self._pool, len(of(float(values[0]))), sorted(self._sizes)
        out = np.zeros((len(ratios), len(values)))
        for first in range(0, len(values), _BATCH // d):
            some = slice(first, min(first + _BATCH // d, len(values)))
            columns = pool.only(np.concatenate([of(value) for value in values[some]]), piece)
            projected = pool.screen(np.concatenate([columns, pool.spread[0]]))
            own = np.arange(len(columns)).reshape(-1, d)
            # What the model absorbs of a column has rounding left; a column of zeros explains nothing.
            least = np.eye(d) * np.maximum(priors.ABSORBED * projected.squares[own], _NOTHING)[:, :, None]
            for k, ratio in enumerate(ratios):
                marginal = marginal_at(gram_of(pool, projected), ratio)
                inner = marginal.inner(own.reshape(-1), own.reshape(-1)).reshape(len(own), d, len(own), d)
                core = inner[np.arange(len(own)), :, np.arange(len(own))] + least
                data = marginal.data[own]
                out[k, some] = np.sum(data * np.linalg.solve(core, data[..., None])[..., 0], axis=1)
        return list(out)


def _of_one(observations: Observations) -> Iterator[tuple[str, Said, Array]]:
    """Functions of one covariate, and of some of them displacements."""
    axes = [
        (axis, along)
        for axis, along in zip("xyz", observations.direction.T, strict=True)
        if np.ptp(along) > SAME_DIRECTION
    ]
    for name, values in _covariates(observations).items():
        within = scaled_values(values)
        if within is None:
            continue
        functions = {"its_sign": np.sign(values)[None]} if name in _SIGNS else {"smooth": _smooth(within)}
        if name in _ANGLES:
            functions["periodic"] = _waves(values)
        displaces = name in _SIGNS or name == "time" or "temperature" in name
        covariate = named("column", name)
        for shape, columns in functions.items():
            how = say(f"shape.{shape}")
            yield covariate, how, columns
            for axis, along in axes if displaces else ():
                yield covariate, say("shape.displacement", shape=how, axis=axis), columns * along
            if displaces and len(axes) > 1:
                every = np.concatenate([columns * along for _, along in axes])
                yield covariate, say("shape.displacement", shape=how, axis=", ".join(axis for axis, _ in axes)), every


def _waves(angle: Array) -> Array:
    return np.array([wave(k * angle) for k in _ORDERS for wave in (np.sin, np.cos)])


def _smooth(scaled: Array) -> Array:
    """Polynomials of a covariate from -1 to 1, no more than it has values."""
    degree = min(_DEGREE, len(np.unique(np.round(scaled, 9))) - 1)
    return np.asarray(np.polynomial.legendre.legvander(scaled, degree)[:, 1:].T)


def _positions(observations: Observations) -> dict[str, Array]:
    """Those of the axes that move, from -1 to 1."""
    scaled = {axis: scaled_values(values) for axis, values in zip("xyz", observations.position.T, strict=True)}
    return {axis: values for axis, values in scaled.items() if values is not None}


def _products(observations: Observations) -> Iterator[tuple[str, Said, Array]]:
    for (a, u), (b, v) in combinations(_positions(observations).items(), 2):
        columns = np.concatenate([w * observations.direction.T for w in (u * v, u**2 * v, u * v**2)])
        yield say("shape.axes", one=a, other=b), say("shape.product"), columns[np.abs(columns).max(axis=1) > 1e-9]


def _lost_motions(observations: Observations) -> Iterator[tuple[str, Said, Array]]:
    slowly, positions = _slowly(observations), _positions(observations)
    for axis in "xyzabc":
        sign = np.sign(observations.readings.columns.get(f"dir_{axis}", np.zeros(len(observations))))
        along = sign * sensed(observations, axis)
        # Where the direction of approach is unknown for some readings, the last is not a number.
        if len(np.unique(sign[sign != 0])) < 2 or not np.ptp(along) >= SAME_DIRECTION:
            continue
        functions = {name: values[None] for name, values in slowly.items()}
        if axis in "abc":
            functions[axis] = _waves(observations.readings.column(axis))
        else:
            functions |= {other: _smooth(scaled) for other, scaled in positions.items()}
        for name, values in functions.items():
            both = say("shape.axes", one=named("column", f"dir_{axis}"), other=named("column", name))
            yield both, say("shape.lost_motion", axis=axis.upper(), other=named("column", name)), values * along
        if axis in positions and len(places := _from_place_to_place(positions[axis], sign)):
            both = say("shape.axes", one=named("column", f"dir_{axis}"), other=axis)
            yield both, say("shape.lost_motion_of_places", axis=axis.upper()), places * along


def _slowly(observations: Observations) -> dict[str, Array]:
    """Time and columns of the user's own, from -1 to 1: with what a reversal may change besides the place."""
    columns = observations.readings.columns
    names = [name for name in columns if name == "time" or name not in NUMERIC_COLUMNS]
    scaled = {name: scaled_values(columns[name]) for name in names}
    return {name: values for name, values in scaled.items() if values is not None}


def _constants_of_texts(observations: Observations) -> Iterator[tuple[str, Said, Array]]:
    """Targets, tools or operators that differ, where a column names them."""
    if not spec_of(observations.session).reads_machine:
        return
    directions = observations.read_along
    for name, texts in observations.readings.labels.items():
        each = np.unique(texts)
        if 2 <= len(each) <= _MOST_SETUPS:
            own = np.concatenate([(texts == each[:, None]) * d for d in directions])
            yield say("shape.text_column", name=name), say("shape.constants"), own


def _each(group: IntArray) -> BoolArray:
    """(groups, n) which readings are of each group; none where there is one alone, or too many."""
    own = np.asarray(group == np.unique(group)[:, None])
    return own if 2 <= len(own) <= _MOST_SETUPS else own[:0]


def _path_scales(observations: Observations) -> Iterator[tuple[str, Said, Array]]:
    """Beams that differ by their wavelength, and a beam in which it changes or that bends with something."""
    setup = observations.readings.setup
    own, path = _each(setup), within(observations.path, setup)
    if spec_of(observations.session).reads_machine or not path.any():
        return
    yield named("column", "setup"), say("shape.path_scales"), own * path
    for name, values in _slowly(observations).items():
        both = say("shape.axes", one=named("column", name), other=named("column", "path"))
        yield both, say("shape.path_product"), np.array([values * observations.path, values * observations.path**2])


def _slopes(observations: Observations) -> Iterator[tuple[str, Said, Array]]:
    """Parts, meshes, mountings and runs that differ by tilts, scales and squareness."""
    if not spec_of(observations.session).reads_machine:
        return
    setup, run = observations.readings.setup, observations.readings.repeat_of_setup
    each = {"setup": setup, "repeat": run} if run.max(initial=0) > setup.max(initial=0) else {"setup": setup}
    directions = observations.read_along
    for name, group in each.items():
        own = _each(group)
        for shape, k in (("slopes", 0), ("bends", 1)):
            functions = [_smooth(u)[k : k + 1] for u in _positions(observations).values()]
            columns = [own * f * d for function in functions for f in function for d in directions]
            if columns:  # none where all was read in one place, or two
                yield named("column", name), say(f"shape.{shape}"), np.concatenate(columns)


def _zones(observations: Observations, explained: Explained) -> Iterator[Candidate]:
    """Zones that are displaced: beyond a line across an axis, and beyond such lines across two (a tile, a joint)."""
    if not spec_of(observations.session).reads_machine:
        return
    along = observations.read_along
    for (a, i), (b, j) in combinations(((axis, "xyz".index(axis)) for axis in _positions(observations)), 2):
        u, v = observations.position[:, i], observations.position[:, j]
        corners = list(product(_lines(u), _lines(v)))

        def zone(number: float, u: Array = u, v: Array = v, corners: Sequence[tuple[float, float]] = corners) -> Array:
            beyond = np.array([u, v]) > np.array(corners[int(number)])[:, None]
            return np.asarray((np.vstack([beyond, beyond.all(axis=0)])[:, None] * along).reshape(-1, len(u)))

        if not corners:  # the computer's rounding of one position
            continue
        powers = explained(zone, np.arange(float(len(corners))))
        best = np.unique([np.argsort(-power)[:_CORNERS] for power in powers])
        shapes = tuple(ShapedColumns(corners[k], zone(k)) for k in best)
        yield Candidate.of_structure(
            say("shape.axes", one=a, other=b), say("shape.zone_at", at=""), shapes, len(corners)
        )


def _lines(position: Array) -> list[float]:
    """Positions half way between two at which a zone may end, a few of many."""
    every = np.unique(np.round(position / SAME_POSITION)) * SAME_POSITION
    middle = (every[1:] + every[:-1]) / 2.0
    some = np.linspace(0, len(middle) - 1, min(_LINES, len(middle))).round().astype(int)
    return [float(one) for one in middle[some]]


def _from_place_to_place(scaled: Array, sign: Array) -> Array:
    """(k, n) what places, read repeatedly either way, differ by in no smooth form: none where they are few.

    Of many places lines between some, as neighbours have much in common.
    """
    at, place = np.unique(np.round(scaled, 6), return_inverse=True)
    count = np.min([np.bincount(place.reshape(-1)[sign * way > 0], minlength=len(at)) for way in (1, -1)], axis=0)
    both = np.flatnonzero(count >= (1 if np.count_nonzero(count) > 2 * _MOST_PLACES else 2))
    own = (place.reshape(-1) == both[:, None]).astype(np.float64)
    # What the effect explains is no structure.
    smooth = np.polynomial.legendre.legvander(at[both], LOST_MOTION_DEGREES)
    if len(both) <= _MOST_PLACES:
        return np.asarray(np.linalg.svd(smooth)[0][:, smooth.shape[1] :].T @ own)
    hats = interpolation(thinned(at[both], _MOST_PLACES), at[both]).T
    basis = np.linalg.qr(smooth)[0]
    left, size, _ = np.linalg.svd(hats - basis @ (basis.T @ hats), full_matrices=False)
    return np.asarray((left[:, size > 1e-6 * size[0]]).T @ own)


def _covariates(observations: Observations) -> dict[str, Array]:
    """What the residuals may depend on."""
    known = covariates(observations)
    # A displacement by the direction of approach is tried with every axis; the order stands for time, if need be.
    out = {name: values for name, values in known.items() if name not in ("order", "repeat") and " along " not in name}
    if observations.timed and _AIR in out:
        # What drives gradients in the frame; temperatures of the structure follow.
        out[f"rate of {_AIR}"] = _rate(observations.clock, out[_AIR])
    run = observations.readings.repeat_of_setup
    if not observations.timed and run.max(initial=0) > 0 and "order" in known:
        out["order"] = known["order"]
    since = occurrence(run).astype(float)
    if run.max(initial=0) > 0 and not _same_turns(observations.readings.alike(setup=False), since):
        out["order within the run"] = since  # what settles after each start
    if "path" in out:
        out["path within the setup"] = within(observations.path, observations.readings.setup)
        if not spec_of(observations.session).reads_deviations:
            # As the places say it, so that the noise of a reading does not explain itself.
            off = observations.readings.displacement - observations.path
            out["displacement"] = observations.path + means_of(groups(observations.run), off)
    return out


def _same_turns(place: IntArray, turn: Array) -> bool:
    """Whether most places are read again, always at about the same turn of a run: what comes with it is the place's."""
    off = (turn - means_of(place, turn))[np.bincount(place)[place] > 1]
    return 2 * len(off) > len(turn) and float(np.mean(off**2)) < _ALWAYS * float(np.var(turn))


def _rate(time: Array, values: Array) -> Array:
    """Of change, where readings of one moment have the same value."""
    moments, first, place = np.unique(time, return_index=True, return_inverse=True)
    return np.asarray(np.gradient(values[first], moments)[place] if len(moments) > 1 else np.zeros(len(time)))
