# SPDX-License-Identifier: Apache-2.0
"""Models of several sessions of one machine made to speak of the same unknowns.

Every session's model has tables of the machine's error motions at nodes of its own, and only those that it determines
by itself. Put together, a table must be the same function for all: the nodes are those of all sessions that have it,
and a session's readings depend on every motion that any session has and that moves its functional point, also on those
that it had left out because it could not tell them from others. The angular errors that a step diagonal takes for small
random functions are such motions too (`small_angles`).
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.effects.effect_terms import (
    common_shape,
    effect_term,
    held_at,
    unbounded,
    within_grid,
    without_absorbed,
)
from machine_tool_calibration.effects.error_motion import sensed_lever_arms
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.estimation.solve import Linearised
from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.machine.error_motions import SQUARENESS, interpolation, parse_motion
from machine_tool_calibration.methods.direct.datum import needed_rows
from machine_tool_calibration.methods.joint.between_nodes import curves_seen
from machine_tool_calibration.methods.joint.small_angles import angles_of, expected, in_words, without_spread
from machine_tool_calibration.methods.step_diagonal.small_angles import WAVES_NODES
from machine_tool_calibration.model.fit import fit_models
from machine_tool_calibration.model.model import Constraint, MethodModel, assemble, weight_row
from machine_tool_calibration.model.observations import together
from machine_tool_calibration.model.rigid_body import (
    MachineTable,
    axis_nodes,
    distinct_nodes,
    linear_axis_errors,
    machine_terms,
    read_nodes,
    table_datum,
    thinned,
)
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.words import say
from machine_tool_calibration.words import together as told_together

# Most nodes of a table, and about how many are taken of more.
_MOST_NODES, _NODES_OF_MANY = 61, 31
_LEAST_SENSITIVITY = 1e-9  # m per m or rad


@dataclass(frozen=True)
class CommonModels:
    """Models with the same machine."""

    models: tuple[MethodModel, ...]  # one for each session, with the datum that all together need
    tables: tuple[MachineTable, ...]  # of the machine's linear axes, those that some session senses
    # by name of an unknown of the tables, (q,) how it takes part in what all readings leave open and the datum fixes
    fixed: Mapping[str, Array]
    datum: str  # in words
    angles: tuple[MachineTable, ...] = ()  # those of the tables that are expected to be small smooth random functions


def common_models(models: Sequence[MethodModel], labels: Sequence[str]) -> CommonModels:
    """Give models of several sessions the same tables and one datum; a ModelError if their chains differ."""
    chains = [model.observations.session.description.machine.kinematics for model in models]
    linear = [chain for chain in chains if chain.linear]
    first = next((model for model, chain in zip(models, chains, strict=True) if chain.linear), models[0])
    for model, chain, label in zip(models, chains, labels, strict=True):
        if chain.linear and chain != linear[0] and not _compatible(chain, linear[0]):
            this, before = (m.observations.session.description.machine.chain for m in (model, first))
            raise ModelError(
                f"session {label!r} is of a machine with another chain ({this}) than the sessions before it "
                f"({before}): every session.yaml holds the chain of the whole machine, moved axes and others"
            )
    models = _acquainted(models) if len(models) > 1 else models
    tables = _shared_tables(models, linear[0]) if linear else ()
    random = {table.name for model in models for table in angles_of(model)}
    shared = tuple(_with_curves(_with_tables(model, tables)) for model in models)
    angles = tuple(table for table in tables if table.name in random)
    common = _with_datum(expected(shared, angles), labels, tables)
    words = told_together((common.datum, in_words(angles)), "; ") if angles else common.datum
    return replace(common, angles=angles, datum=words)


def _acquainted(models: Sequence[MethodModel]) -> list[MethodModel]:
    """The models, knowing what all sessions have read, so that functions of an axis's position are the same for all."""
    covered = {}
    for axis in "xyz":
        read = [m.observations.readings.columns.get(axis, np.empty(0)) for m in models]
        every = np.concatenate([values[np.isfinite(values)] for values in read])
        if every.size:
            covered[axis] = (float(every.min()), float(every.max()))
    rigid = frozenset[str]().union(*(sensed_lever_arms(model.observations) for model in models))
    seen = [replace(o, covered=covered, rigid=rigid | o.rigid) for o in (model.observations for model in models)]
    return [replace(model, observations=own) for model, own in zip(models, seen, strict=True)]


def _compatible(one: Chain, other: Chain) -> bool:
    """Whether two descriptions name the linear axes alike (a rotary axis may be left out of one)."""
    return all(
        tuple(a for a in side if a in "XYZ") == tuple(b for b in same if b in "XYZ")
        for side, same in ((one.workpiece_side, other.workpiece_side), (one.tool_side, other.tool_side))
    )


def tables_of(model: MethodModel) -> tuple[MachineTable, ...]:
    """A model's own tables of the linear axes' errors; none for a rotary axis or free targets."""
    return tuple(getattr(model, "tables", None) or ())


def _shared_tables(models: Sequence[MethodModel], chain: Chain) -> tuple[MachineTable, ...]:
    every = [table for model in models for table in (*tables_of(model), *angles_of(model))]
    names = dict.fromkeys([*(table.name for table in every), *_determined_together(models, chain)])
    random = {table.name for model in models for table in angles_of(model)}
    out = []
    for name in names:
        if name in SQUARENESS:
            out.append(MachineTable(chain, name))
            continue
        # Nodes of those that determine the motion: at further ones it would be mixed with others, and nothing gained.
        nodes = [table.nodes for table in every if table.name == name]
        if name in random or not nodes:
            # Of a random function something is known everywhere, and a straight line beyond its nodes is not that.
            nodes += [own for model in models if (own := _sensed_nodes(model, name)) is not None]
        out.append(MachineTable(chain, name, _union(nodes)))
    return tuple(out)


def _determined_together(models: Sequence[MethodModel], chain: Chain) -> list[str]:
    """Error motions that trackers determine together: each alone senses one direction at a place."""
    trackers = [m for m in models if spec_of(m.observations.session).beam_from_pointer and tables_of(m)]
    if len(trackers) < 2:
        return []
    nodes: dict[str, list[Array]] = {}
    for table in (table for model in trackers for table in tables_of(model) if not table.is_squareness):
        nodes.setdefault(parse_motion(table.name).axis, []).append(table.nodes)
    candidates = linear_axis_errors(chain, {axis: _union(own) for axis, own in nodes.items()})
    return [table.name for table in machine_terms(together([m.observations for m in trackers]), candidates)[0]]


def _sensed_nodes(model: MethodModel, name: str) -> Array | None:
    """Nodes for a smooth function where a session's readings depend on an error motion; None where none does."""
    if not hasattr(model, "tables"):
        return None
    axis = "XYZ".index(parse_motion(name).axis)
    nodes = axis_nodes(model.observations.position[:, axis], WAVES_NODES)
    if len(nodes) < 2:
        return None
    own = model.observations.session.description.machine.kinematics
    term = MachineTable(own, name, nodes).term(model.observations)
    return nodes if np.abs(term.columns).max() > _LEAST_SENSITIVITY else None


def _union(nodes: Iterable[Array]) -> Array:
    every = distinct_nodes(np.concatenate(list(nodes)))
    return every if len(every) <= _MOST_NODES else thinned(every, _NODES_OF_MANY)


def _with_tables(model: MethodModel, tables: Sequence[MachineTable]) -> MethodModel:
    """The model with the shared tables in place of its own; its other conditions said of the new unknowns."""
    if not hasattr(model, "tables"):
        return model
    own, model = tables_of(model), without_spread(model)
    kept, terms = [], []
    # The lever arms of each session end at its own functional point.
    chain = model.observations.session.description.machine.kinematics
    for table in (replace(shared, chain=chain) for shared in tables):
        term = table.term(model.observations)
        if np.abs(term.columns).max(initial=0.0) > _LEAST_SENSITIVITY:
            kept.append(table)
            terms.append(term)
    translate, there = _translation(own, kept), {table.name for table in kept}
    constraints = (replace(c, weights=_translated(c.weights, translate)) for c in model.constraints)
    priors = (replace(p, weights=_translated(p.weights, translate)) for p in model.priors)
    changed: dict[str, Any] = {
        "tables": tuple(kept),
        "terms": (*terms, *model.terms[len(own) :]),
        "constraints": tuple(c for c in constraints if c.weights),
        "priors": tuple(p for p in priors if p.weights),
        "left_out": tuple(entry for entry in model.left_out if entry.name not in there),
    }
    return replace(model, **changed)


def _with_curves(model: MethodModel) -> MethodModel:
    """The model, its observations knowing what they see of the machine's curves between nodes."""
    curves = curves_seen(model)
    return model if curves is None else replace(model, observations=replace(model.observations, curves=curves))


def _translation(own: Sequence[MachineTable], new: Sequence[MachineTable]) -> dict[str, dict[str, float]]:
    """Each of a model's own unknowns of tables as a weighted sum of the new ones."""
    by_name = {table.name: table for table in new}
    out: dict[str, dict[str, float]] = {}
    for table in own:
        target = by_name.get(table.name)
        for k, label in enumerate(table.labels):
            if target is None:
                out[label] = {}
            elif table.is_squareness:
                out[label] = {label: 1.0}
            else:
                weights = interpolation(target.nodes, table.nodes[k : k + 1])[:, 0]
                out[label] = {n: float(w) for n, w in zip(target.labels, weights, strict=True) if abs(w) > 1e-9}
    return out


def _translated(weights: Mapping[str, float], translate: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    out: dict[str, float] = {}
    for name, weight in weights.items():
        for new, share in translate.get(name, {name: 1.0}).items():
            out[new] = out.get(new, 0.0) + weight * share
    return {name: weight for name, weight in out.items() if abs(weight) > 1e-12}


def _with_datum(models: Sequence[MethodModel], labels: Sequence[str], tables: Sequence[MachineTable]) -> CommonModels:
    """The models with those conditions on the machine that all readings together need."""
    own: list[list[Constraint]] = []
    candidates: list[tuple[int, Constraint]] = []  # with the number of the session that states it
    read = {table.name: np.zeros(len(table.labels), dtype=bool) for table in tables}
    for term in (term for model in models for term in model.terms if term.name in read):
        read[term.name] |= read_nodes(term.columns)
    for index, model in enumerate(models):
        shared = {p.name for p in model.parameters if p.shared}
        own.append([c for c in model.constraints if not shared & set(c.weights)])
        sensed = {table.name for table in tables_of(model)}
        acting = [table for table in tables if table.name in sensed]
        datum = table_datum(acting, [read[table.name] for table in acting])
        candidates += [(index, c) for c in datum]
        candidates += [(index, c) for c in model.constraints if shared & set(c.weights)]
    motions = {label: table for table in tables for label in table.labels}
    candidates.sort(key=lambda candidate: _preference(candidate[1], motions))
    bare = [replace(model, constraints=tuple(own[k])) for k, model in enumerate(models)]
    assembly = assemble(bare, labels)
    m = assembly.problem.size
    start = Linearised.at(assembly.problem, *assembly.problem.zero)
    undetermined = start.normal().undetermined
    # An unknown of which there is no reading (a setup that was declared and never read) counts like any other.
    size = np.sqrt(start.squares)
    typical = float(size.max(initial=0.0)) or 1.0
    scale = 1.0 / np.where(size > 1e-13 * typical, size, typical)
    basis = np.linalg.qr(undetermined / scale[:, None])[0] if undetermined.size else np.zeros((m, 0))
    places = [
        dict(zip((p.name for p in model.parameters), where, strict=True))
        for model, where in zip(bare, assembly.places, strict=True)
    ]
    rows = [weight_row(places[index], constraint.weights, m) * scale for index, constraint in candidates]
    families = {p.name: p.family for model in bare for p in model.parameters}
    chosen, fixed = needed_rows(basis, rows)
    needed = [candidates[k] for k in chosen]
    out = []
    for index, model in enumerate(bare):
        mine = tuple(constraint for owner, constraint in needed if owner == index)
        out.append(replace(model, constraints=model.constraints + mine))
    conditions = (_words(constraint, families) for _, constraint in needed)
    words = told_together((say("datum.together"), *conditions), "; ")
    by_name = {p.name: row for p, row in zip(assembly.parameters, fixed * scale[:, None], strict=True) if p.shared}
    return CommonModels(tuple(out), tuple(tables), by_name, words)


def _words(constraint: Constraint, families: Mapping[str, str]) -> str:
    name = next(iter(constraint.weights))
    if len(constraint.weights) == 1:
        return f"{name} = {constraint.value:.6g}"
    return say("datum.without_slope" if constraint.value == 0.0 else "datum.as_measured", name=families[name])


def _preference(constraint: Constraint, motions: Mapping[str, MachineTable]) -> int:
    """Straightness first, positioning last: a shift of everything is then held by the positioning errors."""
    kinds = [motions[name] for name in constraint.weights if name in motions]
    if len(kinds) < len(constraint.weights):
        return 3
    return 0 if kinds[0].is_straightness else 1 if kinds[0].is_rotation else 2


def with_effects(common: CommonModels, labels: Sequence[str], effects: Sequence[Effect]) -> CommonModels:
    """The models with effects in every session in which they can act; a ModelError names one that acts in none."""
    models = list(common.models)
    for effect in effects:
        reasons = {label: effect.why_not(m.observations) for label, m in zip(labels, models, strict=True)}
        if all(why is not None for why in reasons.values()):
            first, why = next(iter(reasons.items()))
            raise ModelError(f"effect {effect.id} acts in no session: {first}: {why}")
    # Even where a session by itself takes an effect up, the others may determine it.
    effects, absorbed = without_absorbed(fit_models(models, labels), effects)
    models = [replace(model, left_out=model.left_out + absorbed) for model in models]
    for effect in effects:
        if not effect.shapes:
            models = _extended(models, effect, ())
    for effect in effects:
        if effect.shapes:
            models = _with_curved(models, labels, effect)
    return replace(common, models=tuple(models))


def _extended(
    models: Sequence[MethodModel], effect: Effect, shape: tuple[float, ...], sizes: Sequence[Array | None] = ()
) -> list[MethodModel]:
    """The models with an effect's columns at given nonlinear coefficients, linearised if sizes are given."""
    return [
        model.with_terms([effect_term(effect, model.observations, shape, sizes[k] if sizes else None)])
        if effect.why_not(model.observations) is None
        else model
        for k, model in enumerate(models)
    ]


def _with_curved(models: list[MethodModel], labels: Sequence[str], effect: Effect) -> list[MethodModel]:
    """The models with an effect whose nonlinear coefficients are those with which all sessions together fit best."""
    observed = [m.observations for m in models if effect.why_not(m.observations) is None]
    grid = effect.shape_grid(together(observed))
    shape, sizes = common_shape(fit_models(models, labels), effect, grid)
    if all(coefficient.discrete for coefficient in effect.shapes):
        return _extended(models, effect, shape)
    moving = _extended(models, effect, shape, sizes)
    if not unbounded(fit_models(moving, labels), effect):
        return moving
    shape = within_grid(shape, grid)
    held = held_at(effect, shape)
    return [replace(own, left_out=(*own.left_out, *held)) for own in _extended(models, effect, shape)]
