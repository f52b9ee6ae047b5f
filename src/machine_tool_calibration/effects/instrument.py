# SPDX-License-Identifier: Apache-2.0
"""Effects of the instrument: the air in its beam, mirror, pointer, retroreflector, and a probe's pre-travel."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import replace

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Coefficient, Effect, Shape, table_axis
from machine_tool_calibration.instruments.refractive_index import index_deviation
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.words import say

__all__ = [
    "DeadPath", "HarmonicEffect", "MirrorMisalignment", "PointerAxisOffset", "PointerRadialError", "PointerZeroOffset",
    "ProbePretravel", "RefractiveIndex", "RetroreflectorForm",
]  # fmt: skip

# A beam that is pointed at a retroreflector from a station.
_POINTED = ("tracking_interferometer", "laser_tracker")
_STATIONS = ("tracking_interferometer", "rotary_axis")
# Highest orders that are tried.
_HIGHEST = (3.0, 5.0, 8.0)
# A dead path of this length is usual on any machine, m.
_LEAST_USUAL = 0.5


def _azimuth(direction: Array) -> Array:
    """(n,) of directions (n, 3) in the machine frame, rad."""
    return np.asarray(np.arctan2(direction[:, 1], direction[:, 0]))


class AirEffect(Effect):
    """An effect of the air in a beam whose wavelength measures."""

    kind = "reading"
    needs = ("temperature_air",)
    covariates: tuple[str, ...] = ("temperature_air", "air_pressure", "relative_humidity")
    methods = ("step_diagonal", "tracking_interferometer", "rotary_axis", "direct")
    instruments = ("laser_interferometer", "tracking_interferometer", "laser_tracker")

    def deviation(self, observations: Observations) -> Array:
        """(n,) refractive index minus that of standard air."""
        columns = observations.readings.columns
        others = columns.get("air_pressure"), columns.get("relative_humidity")
        return index_deviation(columns["temperature_air"], *others)


class RefractiveIndex(AirEffect):
    """The part g of the wavelength's compensation that is missing, in proportion to the path (Edlén)."""

    id = "refractive_index"
    title = say("effect.air")
    formula = say("formula.air")
    source = "Edlén; Bönsch and Potulski 1998; ISO 230-2:2014 Annex on laser interferometers"
    coefficients = (Coefficient("g", "1", -20.0, 20.0, say("coefficient.not_compensated"), usual=2.0),)
    covariates = (*AirEffect.covariates, "path", "displacement")

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Deviation of the index times path."""
        return np.asarray(self.deviation(observations) * observations.path)[None]


class DeadPath(AirEffect):
    """The path in front of the datum, which is not in the reading but changes with the air (ISO 230-2)."""

    id = "dead_path"
    title = say("effect.dead_path")
    formula = say("formula.dead_path")
    source = "ISO 230-2:2014, dead path; Ibaraki et al. 2014, Table 4, u14"
    coefficients = (Coefficient("D", "m", -20.0, 20.0, say("coefficient.dead_path"), usual=_LEAST_USUAL),)

    def coefficients_for(self, observations: Observations, shape: tuple[float, ...] = ()) -> tuple[Coefficient, ...]:
        """Usually no longer than the machine or the paths that were measured: who has a longer one sees it."""
        travel = [abs(end - start) for start, end in observations.session.description.machine.travel.values()]
        longest = max([_LEAST_USUAL, *travel, float(np.abs(observations.path).max(initial=0.0))])
        return (replace(self.coefficients[0], usual=longest),)

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Deviation of the index."""
        return np.asarray(self.deviation(observations))[None]


class MirrorMisalignment(Effect):
    """A tilted mirror normal n reads n.d/(n.l): two tilts a setup (Ibaraki and Hata 2010, Section 3.1)."""

    id = "mirror_misalignment"
    title = say("effect.mirror")
    formula = say("formula.mirror")
    source = "Ibaraki and Hata 2010, Eq. (4)"
    kind = "reading"
    methods = ("step_diagonal",)
    setup_level = True

    def coefficients_for(self, observations: Observations, shape: tuple[float, ...] = ()) -> tuple[Coefficient, ...]:
        """Two tilts for each setup."""
        return tuple(
            Coefficient(f"{i}.t{k}", "rad", -0.02, 0.02, say("coefficient.mirror_tilt", setup=i, n=k))
            for i in observations.session.setup_ids
            for k in (1, 2)
        )

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Displacement across the beam since the start of the run."""
        readings = observations.readings
        out = np.zeros((len(observations.session.setup_ids), 2, len(readings)))
        for run in np.unique(observations.run):
            mine = np.flatnonzero(observations.run == run)
            moved = observations.position[mine] - observations.position[mine[0]]
            across = np.linalg.svd(observations.direction[mine[:1]])[2][1:]
            out[readings.setup[mine[0]]][:, mine] = (moved @ across.T).T
        return out.reshape(-1, len(readings))


class HarmonicEffect(Effect):
    """A reading that depends on an angle; sine and cosine of orders 2 up to the highest that the data asks for.

    The first order is left to the model: it is a shift of station, target or stylus.

    Attributes:
        limit: largest plausible amplitude, m.
    """

    kind = "reading"
    shapes = (Shape("highest_order", "1", 2.0, 8.0, discrete=True, meaning=say("coefficient.waves_most")),)
    limit: float

    @abstractmethod
    def angle(self, observations: Observations) -> Array:
        """(n,) the angle, rad."""

    def coefficients_for(self, observations: Observations, shape: tuple[float, ...] = ()) -> tuple[Coefficient, ...]:
        """Sine and cosine coefficients of each order, m."""
        highest = int(shape[0]) if shape else int(_HIGHEST[-1])
        return tuple(
            Coefficient(f"{kind}{k}", "m", -self.limit, self.limit, say(f"coefficient.waves_{part}", n=k))
            for k in range(2, highest + 1)
            for kind, part in (("s", "sine"), ("c", "cosine"))
        )

    def shape_grid(self, observations: Observations) -> list[tuple[float, ...]]:
        """Few orders, or many."""
        return [(highest,) for highest in _HIGHEST]

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Sine and cosine of each order."""
        angle = self.angle(observations)
        return np.array([wave(k * angle) for k in range(2, int(shape[0]) + 1) for wave in (np.sin, np.cos)])


class ProbePretravel(HarmonicEffect):
    """The way from contact to trigger depends on the direction of the contact's normal (three lobes, typically)."""

    id = "probe_pretravel"
    title = say("effect.pretravel")
    formula = say("formula.harmonics", angle=say("formula.angle_normal"))
    source = "ISO 230-10, pre-travel variation"
    limit = 3e-5
    covariates = ("normal",)
    methods = ("probing",)

    def angle(self, observations: Observations) -> Array:
        """Direction of the normal in the machine frame."""
        return _azimuth(observations.table_direction)


def _level(observations: Observations) -> Array:
    """(n,) cosine of the beam's elevation."""
    return np.asarray(np.hypot(observations.direction[:, 0], observations.direction[:, 1]))


def _open_loop(observations: Observations) -> bool:
    """Whether the beam stays on the commanded direction."""
    return getattr(observations.session.description, "pointing", "tracking") == "open_loop"


class PointerRadialError(HarmonicEffect):
    """Radial error motion of the pointer's azimuth axis; once a turn is the station's position (ISO 230-7).

    The rotation centre moves across that axis, in the plane of azimuth: a beam that rises senses the cosine of it.
    """

    id = "pointer_radial_error"
    title = say("effect.pointer_radial")
    formula = say("formula.pointer_radial")
    source = "Ibaraki et al. 2014, Table 4, u21; ISO 230-7"
    limit = 5e-5
    covariates = ("azimuth", "elevation")
    methods = _STATIONS
    instruments = _POINTED

    def angle(self, observations: Observations) -> Array:
        """The azimuth."""
        return _azimuth(observations.direction)

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Sine and cosine of each order, as far as the beam lies in the plane of azimuth."""
        return np.asarray(_level(observations) * super().columns(observations, shape))


class PointerZeroOffset(Effect):
    """The azimuth counts from another zero: a beam that is held reads the path's projection (cosine error).

    Turned about the azimuth axis by a small angle, a beam is off its direction by cos(elevation) times the angle. One
    that follows the target stays on it wherever the azimuth counts from. An elevation's zero makes all paths shorter
    alike, as a scale does.
    """

    id = "pointer_zero_offset"
    title = say("effect.pointer_zero")
    formula = say("formula.pointer_zero")
    source = "Ibaraki et al. 2014, Section 4 and Table 4, u41"
    kind = "reading"
    coefficients = (Coefficient("q", "1", 0.0, 2e-4, say("coefficient.half_square")),)
    covariates = ("path", "displacement")
    methods = ("tracking_interferometer",)
    instruments = ("tracking_interferometer",)

    def why_not(self, observations: Observations) -> str | None:
        """Also where the beam follows the target."""
        if (why := super().why_not(observations)) is not None:
            return why
        return None if _open_loop(observations) else "does not occur where the beam follows the target"

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Minus the path's part in the plane of azimuth, times the cosine of the elevation."""
        return np.asarray(-observations.path * _level(observations) ** 2)[None]


class PointerAxisOffset(Effect):
    """The elevation axis stands in front of the azimuth axis by d, and the beam passes it at a distance h.

    The axis in front turns with the azimuth, towards the target: the path is shorter by d cos(elevation). A beam that
    follows the target and misses the elevation axis by h reads a leg of the triangle: shorter by h^2 / (2 path); one
    that is held on its direction (open loop) reads the projection whatever h. In a plane, where the elevation does not
    change, the dead path takes d up.
    """

    id = "pointer_axis_offset"
    title = say("effect.pointer_axes")
    formula = say("formula.pointer_axes")
    source = "Hughes et al. 2011, laser tracker error determination; ISO 10360-10, offset of axes and beam"
    kind = "reading"
    coefficients = (
        Coefficient("d", "m", -1e-3, 1e-3, say("coefficient.elevation_in_front")),
        Coefficient("q", "m^2", 0.0, 1e-5, say("coefficient.beam_off")),
    )
    covariates = ("elevation", "path")
    methods = _STATIONS
    instruments = _POINTED

    def coefficients_for(self, observations: Observations, shape: tuple[float, ...] = ()) -> tuple[Coefficient, ...]:
        """The beam's distance only where the beam follows."""
        return self.coefficients[:1] if _open_loop(observations) else self.coefficients

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Minus the cosine of the beam's elevation, and minus the reciprocal of twice the path."""
        every = np.asarray([-_level(observations), -0.5 / observations.path])
        return every[: len(self.coefficients_for(observations))]


class RetroreflectorForm(HarmonicEffect):
    """Path change with the direction in which the beam meets the retroreflector.

    The retroreflector keeps its orientation to the machine on a spindle, and turns with a rotary table. In a plane
    the angle of incidence is the azimuth; in space it is the angle to the spindle's axis; on a table it is the angle
    about the table's axis, as seen from the table.
    """

    id = "retroreflector_form"
    title = say("effect.retroreflector")
    formula = say("formula.harmonics", angle=say("formula.angle_incidence"))
    source = "Takatsuji et al. 1999; Ibaraki et al. 2014, Table 3"
    limit = 2e-5
    covariates = ("azimuth", "elevation", "c")
    methods = _STATIONS
    instruments = _POINTED

    def angle(self, observations: Observations) -> Array:
        """The angle of incidence."""
        session = observations.session
        if spec_of(session).turns_one_axis:
            axis = table_axis(observations)
            i, j = (("ABC".index(axis) + k) % 3 for k in (1, 2))
            about = np.arctan2(observations.direction[:, j], observations.direction[:, i])
            return np.asarray(about - session.rotation_sign * observations.readings.column(axis.lower()))
        if getattr(session.description, "dimension", 3) == 2:
            return _azimuth(observations.direction)
        return np.asarray(np.arccos(np.clip(observations.direction[:, 2], -1.0, 1.0)))
