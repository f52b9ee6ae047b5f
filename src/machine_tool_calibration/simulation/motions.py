# SPDX-License-Identifier: Apache-2.0
"""Error motions as smooth functions of one axis's position, random ones, and finite rotations exact to all orders."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.errors import ModelError

_SHORTEST = 1e-12  # m or rad, between two nodes


def cross(a: Array, b: Array) -> Array:
    """Vector product of (…, 3) arrays; several times faster than `numpy.cross` for a few vectors."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def rotate(vector: Array, rotation: Array) -> Array:
    """Vectors (…, 3) turned by rotation vectors (…, 3), axis times angle, rad, right-handed (Rodrigues' formula)."""
    # Never zero, where sin(a)/a and (1 - cos(a))/a^2 have their limits; the half angle keeps the digits of the latter.
    angle = np.sqrt(np.maximum(np.sum(rotation**2, axis=-1, keepdims=True), 1e-30))
    first, versine = cross(rotation, vector), 2.0 * (np.sin(0.5 * angle) / angle) ** 2
    return np.asarray(vector + np.sin(angle) / angle * first + versine * cross(rotation, first))


def turn(vector: Array, axis: str, angle: Array | float) -> Array:
    """Vectors (…, 3) turned by `angle` (rad, right-handed) about the axis `A` (X), `B` (Y) or `C` (Z)."""
    index = "ABC".index(axis)
    i, j = (index + 1) % 3, (index + 2) % 3
    sine, cosine = np.sin(angle), np.cos(angle)
    parts = [vector[..., 0] + 0.0 * sine] * 3
    parts[index] = vector[..., index] + 0.0 * sine
    parts[i] = cosine * vector[..., i] - sine * vector[..., j]
    parts[j] = sine * vector[..., i] + cosine * vector[..., j]
    return np.stack(parts, axis=-1)


COMPONENTS = ("EX", "EY", "EZ", "EA", "EB", "EC")
Interpolation = Literal["cubic", "linear", "periodic"]


def motion_names(axis: str) -> tuple[str, ...]:
    """ISO 230-1 names of an axis's six error motions: `EXX`, `EYX`, `EZX`, `EAX`, `EBX`, `ECX`."""
    return tuple(component + axis for component in COMPONENTS)


@dataclass(frozen=True)
class Table:
    """One error motion as values at nodes."""

    nodes: tuple[float, ...]  # (k,) increasing positions of the axis, m or rad
    values: tuple[float, ...]  # (k,) error motion there, m (EX, EY, EZ) or rad (EA, EB, EC)
    # `cubic` (natural spline), `linear`, or `periodic` (spline; the nodes span one turn and the first and last values
    # agree). Outside its nodes a motion keeps its end value
    interpolation: Interpolation = "cubic"

    def __post_init__(self) -> None:
        nodes, values = np.asarray(self.nodes, float), np.asarray(self.values, float)
        if nodes.ndim != 1 or nodes.shape != values.shape or len(nodes) < 2:
            raise ModelError(
                f"an error motion needs as many values as nodes, at least 2; not {nodes.size} nodes "
                f"and {values.size} values"
            )
        if not (np.all(np.isfinite(nodes)) and np.all(np.isfinite(values))):
            raise ModelError("an error motion's nodes and values must be finite")
        if np.any(np.diff(nodes) < _SHORTEST):
            raise ModelError(f"an error motion's nodes must increase, by {_SHORTEST:g} m or rad at least")
        if self.interpolation == "periodic" and abs(values[-1] - values[0]) > 1e-12:
            raise ModelError("a periodic error motion's first and last values must agree")

    def __call__(self, position: Array | float) -> Array:
        """The motion at positions of the axis."""
        nodes = np.asarray(self.nodes, float)
        x = _within(nodes, self.interpolation, np.asarray(position, float))
        return np.asarray(_value(nodes, _pieces(nodes, np.array([self.values]).T, self.interpolation), x)[..., 0])


def _within(nodes: Array, interpolation: Interpolation, x: Array) -> Array:
    """Positions (…) between the first node and the last, at which a motion has the value that it has there."""
    low, high = nodes[0], nodes[-1]
    inside = low + np.mod(x - low, high - low) if interpolation == "periodic" else np.minimum(np.maximum(x, low), high)
    return np.asarray(inside)


def _pieces(nodes: Array, values: Array, interpolation: Interpolation) -> Array:
    """(4, k - 1, m) coefficients of the distance from a piece's first node, the cube's first, through values (k, m)."""
    # By hand: loading scipy.interpolate takes as long as all else that a node does to start.
    length = np.diff(nodes)[:, None]
    slope = np.diff(values, axis=0) / length
    second = np.zeros(values.shape)
    if interpolation != "linear" and len(nodes) > 2:
        # Second derivatives that make the first ones continuous, at every node or all but the ends.
        wraps = interpolation == "periodic"
        inner = np.arange(0 if wraps else 1, len(nodes) - 1)
        system = np.zeros((len(nodes) - 1,) * 2)
        before = length[inner - 1, 0]
        np.add.at(system, (inner, inner - 1), before)
        np.add.at(system, (inner, inner), 2.0 * (before + length[inner, 0]))
        np.add.at(system, (inner, (inner + 1) % len(system)), length[inner, 0])
        change = 6.0 * (slope[inner] - slope[inner - 1])
        second[inner] = np.linalg.solve(system[np.ix_(inner, inner)], change)
        if wraps:
            second[-1] = second[0]
    first = slope - length * (2.0 * second[:-1] + second[1:]) / 6.0
    return np.stack([np.diff(second, axis=0) / (6.0 * length), second[:-1] / 2.0, first, values[:-1]])


def _value(breaks: Array, pieces: Array, x: Array) -> Array:
    """(…, m) piecewise polynomials (4, k - 1, m) at positions (…) between their breaks (k,)."""
    index = np.minimum(np.searchsorted(breaks, x, side="right") - 1, len(breaks) - 2)
    step = (x - breaks[index])[..., None]
    cube, square, first, value = pieces[:, index]
    return np.asarray(((cube * step + square) * step + first) * step + value)


@dataclass(frozen=True)
class AxisMotion:
    """The six error motions of one axis, evaluated together; a motion without tables is zero."""

    axis: str  # `X`, `Y`, `Z`, `A`, `B` or `C`
    tables: tuple[tuple[str, Table], ...] = ()  # (name, table) pairs; several tables of one name add up

    def __post_init__(self) -> None:
        names = motion_names(self.axis)
        for name, _ in self.tables:
            if name not in names:
                raise ModelError(f"{name} is not an error motion of the {self.axis} axis; these are {' '.join(names)}")
        if len({table.interpolation == "periodic" for _, table in self.tables}) == 2:
            raise ModelError(f"the error motions of {self.axis} mix periodic and other tables")

    @cached_property
    def _alike(self) -> list[tuple[Array, Interpolation, Array, IntArray]]:
        """Nodes, interpolation, pieces and places among the six motions of tables that have both in common."""
        alike: dict[tuple[tuple[float, ...], Interpolation], list[tuple[int, tuple[float, ...]]]] = {}
        for name, table in self.tables:
            place = COMPONENTS.index(name[:2])
            alike.setdefault((table.nodes, table.interpolation), []).append((place, table.values))
        out = []
        for (nodes, interpolation), each in alike.items():
            places, values = zip(*each, strict=True)
            at = np.asarray(nodes, float)
            out.append((at, interpolation, _pieces(at, np.array(values).T, interpolation), np.array(places)))
        return out

    def __call__(self, position: Array) -> Array:
        """(n, 6) EX, EY, EZ (m) and EA, EB, EC (rad) at positions (n,), m or rad."""
        out = np.zeros((len(position), 6))
        for nodes, interpolation, pieces, places in self._alike:
            value = _value(nodes, pieces, _within(nodes, interpolation, position))
            np.add.at(out.T, places, value.T)  # of two tables of one name, too
        return out


def summed(one: Mapping[str, Any], more: Mapping[str, Any]) -> dict[str, Any]:
    """Errors by name, those of one name added."""
    return {**one, **{name: one.get(name, 0.0) + value for name, value in more.items()}}


def random_smooth(
    rng: np.random.Generator, low: float, high: float, amplitudes: Sequence[float], *, knots: int = 7
) -> list[Table]:
    """Smooth random motions over [low, high]: zero at 0 if that is inside, else at `low`; each with its largest value.

    Natural splines through a random walk at `knots` nodes with a random slope, as guideways and ball
    screws show: long waves with some shorter ones, more of these with more nodes.
    """
    nodes, slope = np.linspace(low, high, knots), np.linspace(-1, 1, knots)
    walks = [
        np.cumsum(rng.normal(size=knots)) + rng.normal() * slope + rng.normal(size=knots) * 0.5 for _ in amplitudes
    ]
    return _normalised(nodes, np.array(walks).T, amplitudes, 0.0 if low <= 0.0 <= high else low, "cubic")


_ORDERS = 4  # harmonics of a rotary axis's motion


def random_periodic(rng: np.random.Generator, amplitudes: Sequence[float]) -> list[Table]:
    """Smooth random motions of a rotary axis, zero at 0, each with its largest absolute value: falling harmonics."""
    nodes = np.linspace(0.0, 2.0 * np.pi, 37)
    k = np.arange(1, _ORDERS + 1)[:, None]
    cosines, sines = np.cos(k * nodes), np.sin(k * nodes)
    weights = [rng.normal(size=(2, _ORDERS)) / np.sqrt(k[:, 0]) for _ in amplitudes]
    values = np.array([cosine @ cosines + sine @ sines for cosine, sine in weights]).T
    values[-1] = values[0]
    return _normalised(nodes, values, amplitudes, 0.0, "periodic")


def _normalised(
    nodes: Array, values: Array, amplitudes: Sequence[float], zero: float, interpolation: Interpolation
) -> list[Table]:
    """Motions through values (k, m), shifted and scaled; all at once, which takes little longer than one."""
    pieces = _pieces(nodes, values, interpolation)
    shift = _value(nodes, pieces, np.array(min(max(zero, nodes[0]), nodes[-1])))
    between = _value(nodes, pieces, np.linspace(nodes[0], nodes[-1], 20 * len(nodes)))
    peak = np.max(np.abs(between - shift), axis=0)
    scaled = (values - shift) * np.divide(amplitudes, peak, out=np.zeros(len(peak)), where=peak > 0)
    return [Table(tuple(nodes.tolist()), tuple(motion), interpolation) for motion in scaled.T.tolist()]
