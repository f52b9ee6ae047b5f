"""Finite rotations of vectors, exact to all orders."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array

__all__ = ["cross", "matrix", "rotate", "turn"]


def cross(a: Array, b: Array) -> Array:
    """Vector product of (…, 3) arrays; several times faster than `numpy.cross` for a few vectors."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def rotate(vector: Array, rotation: Array) -> Array:
    """Vectors turned by rotation vectors (Rodrigues' formula).

    Args:
        vector: (…, 3).
        rotation: (…, 3) axis times angle, rad, right-handed.

    Returns:
        (…, 3) turned vectors.
    """
    angle = _angle(rotation)
    first = cross(rotation, vector)
    turned: Array = vector + np.sin(angle) / angle * first + _versine(angle) * cross(rotation, first)
    return turned


def matrix(rotation: Array) -> Array:
    """(…, 3, 3) matrices of the rotation vectors (…, 3), rad."""
    angle = _angle(rotation)[..., None]
    skew = np.zeros((*rotation.shape, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        skew[..., i, j], skew[..., j, i] = -rotation[..., k], rotation[..., k]
    turned: Array = np.eye(3) + np.sin(angle) / angle * skew + _versine(angle) * (skew @ skew)
    return turned


def _angle(rotation: Array) -> Array:
    """(…, 1) length of rotation vectors; never zero, where sin(a)/a and (1 - cos(a))/a^2 have their limits."""
    square = rotation[..., 0] ** 2 + rotation[..., 1] ** 2 + rotation[..., 2] ** 2
    length: Array = np.sqrt(np.maximum(square, 1e-30))[..., None]
    return length


def _versine(angle: Array) -> Array:
    """(1 - cos(a)) / a^2; by the half angle it keeps its digits where the angle is small."""
    half: Array = 2.0 * (np.sin(0.5 * angle) / angle) ** 2
    return half


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
