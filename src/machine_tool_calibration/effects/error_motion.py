# SPDX-License-Identifier: Apache-2.0
"""An error motion that the chosen model leaves out: EYX(x), a polynomial (ISO 230-1)."""

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import AxisEffect, Coefficient, table_axis
from machine_tool_calibration.machine.error_motions import (
    SQUARENESS,
    ErrorMotion,
    interpolation,
    motion_field,
    parse_motion,
)
from machine_tool_calibration.model.observations import SAME_POSITION, Observations
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.words import say

# Degrees of the polynomial: what a guideway's waves take, where one session alone has so many positions that they show,
# and otherwise.
_DEGREES, _ENOUGH_POSITIONS, _FEWER_DEGREES = 7, 10, 4
# Legendre polynomials over the axis's travel: what each looks like; its size is that at the upper end.
_POWERS = ("constant", "power_1", "power_2", "power_3", "power_4")
# A single axis read again and again at so few positions shows its error at each of them.
_FEWEST_NODES, _MOST_NODES = 4, 60
_ARM = 1e-9  # m, shorter than which a lever arm is none


def sensed_motion(observations: Observations, motion: ErrorMotion) -> Array:
    """(n,) change of each reading per unit of an error motion at its place; m per m, or m per rad.

    The lever arm of a rotation is that of the chain, and a flat mirror turns with it. Where the chain gives no arm in
    the measured plane, the carriage is taken to turn about the machine's zero; but not for circles, of which the
    places are no more than lengths from one centre. Of a rotary axis it moves what is on the table.
    """
    if motion.axis in "ABC":
        return _sensed_on_table(observations, motion)
    field = motion_field(observations.session.description.machine.kinematics, motion, observations.position)
    if not motion.is_rotation:
        return np.asarray(np.einsum("nj,nj->n", field, observations.direction))
    component = "ABC".index(motion.component)
    turned = observations.rotation_direction
    name = f"E{motion.component}{motion.axis}"
    yields = name not in observations.rigid and not spec_of(observations.session).centred
    if yields and not _is_sensed(observations, field):
        arm = observations.position.copy()
        arm[:, "XYZ".index(motion.axis)] = 0.0
        field = np.cross(np.eye(3)[component], arm)
    along = np.einsum("nj,nj->n", field, observations.direction)
    return np.asarray(along if turned is None else along + turned[:, component])


def _sensed_on_table(observations: Observations, motion: ErrorMotion) -> Array:
    if table_axis(observations) != motion.axis:
        return np.zeros(len(observations))
    unit = np.eye(3)["XYZABC".index(motion.component) % 3]
    if motion.component == motion.axis:  # counted as the axis turns
        unit = observations.session.rotation_sign * unit
    moved = np.cross(unit, observations.position) if motion.is_rotation else np.tile(unit, (len(observations), 1))
    return np.asarray(np.einsum("nj,nj->n", moved, observations.table_direction))


def why_no_angle(observations: Observations, motion: ErrorMotion) -> str | None:
    """Why readings of the machine itself, such as circles, show no such angle: where its axis moves it has one arm.

    They read one point of the tool, and what that does is its straightness or position, whatever turns (ISO 230-1).
    """
    direct = spec_of(observations.session).reads_machine
    if not motion.is_rotation or not direct or observations.covered is not None:
        return None
    place, setup = observations.position[:, "XYZ".index(motion.axis)], observations.readings.setup
    moves = np.isin(setup, [s for s in np.unique(setup) if np.ptp(place[setup == s]) > SAME_POSITION])
    turned = sensed_motion(observations, motion)[moves]
    for letter in "XYZ":
        moved = sensed_motion(observations, ErrorMotion(motion.axis, letter))[moves]
        arm = float(moved @ turned) / max(float(moved @ moved), _ARM)
        if arm and np.abs(turned - arm * moved).max() < _ARM:
            return f"with one lever arm it is E{letter}{motion.axis}"
    return None


def _look(degree: int) -> str:
    return say(f"coefficient.{_POWERS[degree]}") if degree < len(_POWERS) else say("coefficient.power", n=degree)


class ErrorMotionEffect(AxisEffect):
    """A smooth error motion: a polynomial of the axis's position.

    The lever arm of a rotation is that of the chain. Where the chain gives none in the measured plane, the carriage is
    taken to turn about the machine's zero: a carriage that yields instead of moving as a rigid body.

    Direct deviations of a single axis, read repeatedly at a few positions (ISO 230-2, a straightedge), show a
    translation at every position, whatever its shape: there it has one coefficient for each of them, unless other
    sessions, which were at other positions, are fitted with them.
    """

    id = "{name}"
    title = say("effect.motion")
    formula = say("formula.motion", name="{name}", axis="{axis}", n=_DEGREES)
    kind = "position"
    source = "ISO 230-1"
    tolerance = 0.0  # geometry, and no law
    needs = ("{axis}",)
    chain = moves = "{AXIS}"

    def __init__(self, name: str) -> None:
        """An error motion (EXX … ECZ)."""
        super().__init__(name)
        self.motion = parse_motion(name)
        unit, limit = ("rad", 1e-3) if self.motion.is_rotation else ("m", 1e-4)
        self.coefficients = tuple(Coefficient(f"p{k}", unit, -limit, limit, _look(k)) for k in range(1, _DEGREES + 1))
        if self.motion.component == self.motion.axis:
            self.contains = (f"scale_{self.axis}", "scale")
        elif not self.motion.is_rotation:
            self.contains = tuple(name for name, axes in SQUARENESS.items() if {*axes} == {*self.motion})

    def why_not(self, observations: Observations) -> str | None:
        """An angle of one lever arm is no other error than the straightness."""
        return super().why_not(observations) or why_no_angle(observations, self.motion)

    def coefficients_for(self, observations: Observations, shape: tuple[float, ...] = ()) -> tuple[Coefficient, ...]:
        """Of the polynomial, or as many as a single axis has positions."""
        nodes = self._nodes(observations)
        if nodes is None:
            place = np.round(observations.readings.column(self.axis) / SAME_POSITION)
            alone = observations.covered is None and len(np.unique(place)) >= _ENOUGH_POSITIONS
            return self.coefficients if alone else self.coefficients[:_FEWER_DEGREES]
        low, high = self.coefficients[0].low, self.coefficients[0].high
        first = self._first(observations)
        return tuple(
            Coefficient(f"p{k}", "m", low, high, say(f"coefficient.{_POWERS[k] if k < 2 else 'beyond_line'}"))
            for k in range(first, len(nodes))
        )

    def _nodes(self, observations: Observations) -> Array | None:
        """Positions of a single axis, if each was read at least twice; None where a polynomial is meant."""
        direct = spec_of(observations.session).reads_machine
        if self.motion.is_rotation or not direct or observations.covered is not None:
            return None
        moved = observations.moved
        if moved.sum() != 1 or not moved["xyz".index(self.axis)]:
            return None
        nodes, count = np.unique(np.round(observations.readings.column(self.axis), 6), return_counts=True)
        return nodes + 0.0 if _FEWEST_NODES <= len(nodes) <= _MOST_NODES and count.min() > 1 else None

    def _first(self, observations: Observations) -> int:
        """The lowest degree that the instrument's datum does not take up."""
        datum = getattr(observations.session.description, "datum", "none")
        return {"none": 0, "offset": 1}.get(datum, 2 if self.motion.is_straightness else 1)

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Legendre polynomials of the axis's position over its travel times the displacement of a unit.

        For a single axis read repeatedly: functions with straight lines between its positions; after a constant and
        a straight line any others that are orthogonal to these.
        """
        nodes = self._nodes(observations)
        if nodes is not None:
            along = observations.direction[:, "XYZ".index(self.motion.component)]
            table = interpolation(nodes, observations.readings.column(self.axis)) * along
            start = np.column_stack([np.ones(len(nodes)), (nodes - nodes.mean()) / np.ptp(nodes), np.eye(len(nodes))])
            basis = np.linalg.qr(start)[0][:, : len(nodes)] * np.sqrt(len(nodes))
            return np.asarray(basis.T[self._first(observations) :] @ table)
        along = sensed_motion(observations, self.motion)
        series = polynomials(observations.readings.column(self.axis), observations.span(self.axis))
        return np.asarray(series.T[: len(self.coefficients_for(observations))] * along)


def polynomials(position: Array, span: tuple[float, float]) -> Array:
    """(n, 7) an error motion per unit of each of its coefficients p1 to p7, at positions of its axis, m."""
    low, high = span
    place = (position - (high + low) / 2) / (((high - low) or 1.0) / 2)
    return np.asarray(np.polynomial.legendre.legvander(place, _DEGREES)[:, 1:])


def sensed_lever_arms(observations: Observations) -> frozenset[str]:
    """Rotations of the linear axes (EAX … ECZ) that readings sense as those of rigid bodies, by the chain's arms.

    If one of several sessions does, the carriage is rigid for all: what turns about the machine's zero in one session
    and by the chain's arms in the next is not one error motion.
    """
    chain = observations.session.description.machine.kinematics
    names = [f"E{component}{axis}" for axis in "XYZ" if axis in chain.linear for component in "ABC"]
    fields = ((name, motion_field(chain, parse_motion(name), observations.position)) for name in names)
    return frozenset(name for name, field in fields if _is_sensed(observations, field))


def _is_sensed(observations: Observations, field: Array) -> bool:
    """Whether a displacement (n, 3) has a part in some direction that readings sense, or a mirror turns with it."""
    if observations.rotation_direction is not None:
        return True
    seen = np.abs(observations.direction).max(axis=0) > 0
    return bool(np.abs(field[:, seen]).max(initial=0.0) >= _ARM)
