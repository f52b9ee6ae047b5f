# SPDX-License-Identifier: Apache-2.0
"""Graphs beside each other, and in real time."""

import copy

import numpy as np

from .conftest import PROCEDURE, SITE
from .reference import reference


def readings(operator):
    names = list(operator.readings[0].names)
    table = np.array([list(message.values) for message in operator.readings])
    return {name: table[:, index] for index, name in enumerate(names)}


def since_first(operator, displacement):
    setups = [message.values[list(message.names).index("setup_index")] for message in operator.readings]
    first = {}
    for setup, value in zip(setups, displacement, strict=True):
        first.setdefault(setup, value)
    return displacement - np.array([first[setup] for setup in setups])


def test_two_graphs_in_one_domain(bench, finish):
    other = {**SITE, "machine": {**SITE["machine"], "seed": 78}}
    first = bench.graph(namespace="cell_1")
    second = bench.graph(namespace="cell_2", site=other)
    operators = bench.operator(first), bench.operator(second)
    for operator in operators:
        finish(operator)
    for operator, site in zip(operators, (SITE, other), strict=True):
        table = readings(operator)
        assert len(operator.readings) == 128
        assert np.abs(since_first(operator, table["displacement"]) - reference(PROCEDURE, site)).max() < 1e-12


def test_real_time_gives_the_same_readings(bench, finish):
    procedure = copy.deepcopy(PROCEDURE)
    procedure["session"]["repeats"] = 1
    procedure["session"]["setups"] = procedure["session"]["setups"][:2]
    for axis in "xy":  # short ways: each takes its time
        procedure["path"]["grid"][axis] = {"first": 0.15, "last": 0.2, "count": 2}
    procedure["motion"]["dwell"] = 0.3
    graph = bench.graph(procedure=procedure, simulated_time=False)
    operator = bench.operator(graph)
    finish(operator)
    displacement = since_first(operator, readings(operator)["displacement"])
    assert np.abs(displacement - reference(procedure, SITE)).max() < 1e-10
    # each reading was taken while the axes stood: later than the move and the averaging take
    assert np.diff(readings(operator)["time"]).min() > 0.2
