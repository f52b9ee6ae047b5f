"""The estimator's latched results: map, residuals, verdict, and the documents behind them."""

from __future__ import annotations

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.model.result import Result
from machine_tool_calibration.nodes.calculation import Diagnosed, Identified, Improved
from machine_tool_calibration.nodes.clouds import cloud
from machine_tool_calibration.nodes.map_views import arrows, axis_cloud
from machine_tool_calibration.nodes.qos import LATCHED
from machine_tool_calibration.nodes.stamps import now
from machine_tool_calibration.nodes.verdict import verdict_message

__all__ = ["Publications"]


class Publications:
    """Publishers of a node's results."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._map = node.create_publisher(PointCloud2, "error_map", LATCHED)
        self._result = node.create_publisher(String, "error_map/result", LATCHED)
        self._axes = node.create_publisher(PointCloud2, "error_map/axes", LATCHED)
        self._arrows = node.create_publisher(MarkerArray, "error_map/arrows", LATCHED)
        self._residuals = node.create_publisher(PointCloud2, "residuals", LATCHED)
        self._comparison = node.create_publisher(String, "comparison/result", LATCHED)
        self._diagnosis = node.create_publisher(DiagnosticArray, "diagnosis", LATCHED)
        self._diagnosis_result = node.create_publisher(String, "diagnosis/result", LATCHED)
        self._improvement = node.create_publisher(String, "improvement/result", LATCHED)

    def show_map(self, identified: Identified, magnification: float) -> None:
        """Publish an error map in all its forms.

        Args:
            identified: the map.
            magnification: of the arrows; 0 for a round number.
        """
        result, stamp = identified.result, now(self._node)
        self._map.publish(cloud(stamp, _map_fields(result)))
        self._axes.publish(axis_cloud(stamp, result))
        self._arrows.publish(arrows(stamp, result.error_map, magnification))
        self._residuals.publish(cloud(stamp, _residual_fields(result)))
        self._result.publish(String(data=identified.document))

    def show_comparison(self, document: str) -> None:
        """Publish a comparison's document."""
        self._comparison.publish(String(data=document))

    def show_diagnosis(self, diagnosed: Diagnosed) -> None:
        """Publish the verdict and the candidates, and the document."""
        self._diagnosis.publish(verdict_message(now(self._node), diagnosed))
        self._diagnosis_result.publish(String(data=diagnosed.document))

    def show_improvement(self, improved: Improved, magnification: float) -> None:
        """Publish the way to a better model, the diagnosis behind it, and the last model's map.

        Args:
            improved: the models.
            magnification: of the arrows; 0 for a round number.
        """
        self.show_diagnosis(improved.diagnosed)
        self.show_map(improved.identified, magnification)
        self._improvement.publish(String(data=improved.document))


def _map_fields(result: Result) -> dict[str, Array]:
    fields = {}
    for names, values in (
        (("x", "y", "z"), result.error_map.points),
        (("ex", "ey", "ez"), result.error_map.error),
        (("ux", "uy", "uz"), result.error_map.uncertainty),
    ):
        fields |= {name: np.asarray(values[:, index]) for index, name in enumerate(names)}
    return fields


def _residual_fields(result: Result) -> dict[str, Array]:
    readings = result.fit.model.observations.readings
    position = readings.position()
    return {
        **{axis: position[:, index] for index, axis in enumerate("xyz")},
        "measured": readings.displacement,
        "predicted": result.fit.predicted,
        "residual": result.fit.residuals,
        "row": readings.row.astype(float),
        "setup": readings.setup.astype(float),
        "repeat": readings.repeat.astype(float),
    }
