# SPDX-License-Identifier: Apache-2.0
"""Effects as terms of a model: linear columns, and nonlinear coefficients found on the way."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray
from machine_tool_calibration.effects.effect import Coefficient, Effect
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.model.fit import Fit, JointFit, fit_models, screen, screen_joint
from machine_tool_calibration.model.model import Kind, MethodModel, NotDetermined, Parameter, Term
from machine_tool_calibration.model.observations import Observations, together
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.words import say

# Share of a column's squared norm outside the model, and other effects, below which these take it up.
ABSORBED = 1e-7
# Smallest share of the squared norm that the model leaves of any combination of an effect's columns that it tells.
_LEAST_SHARE_LEFT = 1e-6
# Squared norm of a column, over the largest of its effect, below which it is the computer's rounding.
_ROUNDING = 1e-20
# Times the longest time constant that is tried up to which one is looked for.
_BEYOND = 16.0
_TAKEN_UP = say("undetermined.taken_up")


def effect_term(
    effect: Effect,
    observations: Observations,
    shape: tuple[float, ...] = (),
    size: Array | None = None,
    mapped: bool = True,
) -> Term:
    """An effect's columns, linearised at given nonlinear coefficients.

    These are held where no (k,) linear coefficients are given at which they are linearised. Where it is `mapped`, the
    term says where the effect moves the functional point, if the method maps that.
    """
    columns = effect.columns(observations, shape)
    parameters = [
        _coefficient(effect, c, 0.0, not effect.of_session) for c in effect.coefficients_for(observations, shape)
    ]
    if size is not None:
        for j, coefficient in enumerate(effect.shapes):
            if coefficient.discrete:
                continue
            step = coefficient.step * shape[j]
            up, down = list(shape), list(shape)
            up[j] += step
            down[j] -= step
            slope = (effect.columns(observations, tuple(up)) - effect.columns(observations, tuple(down))) / (2 * step)
            columns = np.concatenate([columns, (size @ slope)[None]])
            parameters.append(_coefficient(effect, coefficient, shape[j], True))
    field = None
    if mapped and effect.kind == "position" and spec_of(observations.session).reads_machine:
        # By the same readings along each axis.
        looks = [replace(observations, direction=np.tile(np.eye(3)[j], (len(observations), 1))) for j in range(3)]
        along = [effect_term(effect, look, shape, size, mapped=False).columns for look in looks]
        field = np.stack(along, axis=-1)
    return Term(effect.id, tuple(parameters), columns, field)


def _coefficient(effect: Effect, of: Coefficient, reference: float, shared: bool) -> Parameter:
    name, kind = f"{effect.id}.{of.name}", Kind.EFFECT
    return Parameter(name, of.unit, of.least, of.high, reference, shared, kind, effect.id, meaning=of.meaning)


def common_shape(
    joint: JointFit, effect: Effect, grid: Sequence[tuple[float, ...]]
) -> tuple[tuple[float, ...], list[Array]]:
    """Nonlinear coefficients with which an effect explains most of the residuals of one or several sessions.

    A grid first, as there are several minima, then a search around its best value; a time constant may be longer than
    the session, which the grid ends with. Also, for each session, the linear ones there; none where the effect does not
    act. A ModelError if the grid is empty.
    """
    if not grid:
        raise ModelError(f"effect {effect.id}: too few distinct positions to look for it")
    of = partial(explained, joint, effect)
    gains, sizes, told = of(grid)
    best = int(np.argmax(gains))
    if all(coefficient.discrete for coefficient in effect.shapes):
        # As many unknowns as the readings tell: how large they plausibly are keeps those that are nothing small.
        enough = [k for k, each in enumerate(told) if each]
        best = max(enough, key=lambda k: (sum(map(len, sizes[k])), gains[k]), default=0)
        return grid[best], sizes[best]
    if len(grid[best]) > 1 or len(grid) == 1:
        return grid[best], sizes[best]
    ordered = sorted(s[0] for s in grid)
    place = ordered.index(grid[best][0])
    low, high = ordered[max(place - 1, 0)], ordered[min(place + 1, len(ordered) - 1)]
    if high == ordered[place] and effect.shapes[0].unit == "s":
        high = max(min(_BEYOND * high, effect.shapes[0].high), high)  # a session may be longer than that
    from scipy import optimize  # slow to load, and few effects need it

    found = optimize.minimize_scalar(
        lambda value: -of([(float(value),)])[0][0], bounds=(low, high), method="bounded", options={"xatol": 1e-4 * low}
    )
    if -found.fun <= gains[best]:
        return grid[best], sizes[best]
    shape = (float(found.x),)
    return shape, of([shape])[1][0]


def shape_of(effect: Effect, term: Term, observations: Observations, known: Mapping[str, float]) -> tuple[float, ...]:
    """Nonlinear coefficients of an effect in a model: as `known` by name, or those whose columns its term has."""
    found = [known.get(f"{effect.id}.{shape.name}") for shape in effect.shapes]
    if all(value is not None for value in found):
        return tuple(value for value in found if value is not None)
    rows = {p.name: row for p, row in zip(term.parameters, term.columns, strict=True)}

    def unlike(tried: tuple[float, ...]) -> tuple[int, float]:
        """How many columns less they have in common, and how far these are apart."""
        names = [f"{effect.id}.{c.name}" for c in effect.coefficients_for(observations, tried)]
        pairs = zip(names, effect.columns(observations, tried), strict=True)
        apart = [float(np.linalg.norm(own - rows[name])) for name, own in pairs if name in rows]
        return -len(apart), sum(apart)

    return min(effect.shape_grid(observations), key=unlike)


def within_grid(shape: tuple[float, ...], grid: Sequence[tuple[float, ...]]) -> tuple[float, ...]:
    """Nonlinear coefficients that are no larger than the largest of those tried: a time constant, than the session."""
    return min(shape, max(grid))


def _more_than_rounding(squares: Array) -> Array:
    """Squared norms of columns, those of rounding alone as if they were as large as the others.

    So they explain nothing: the sine of a wave whose nodes are all the places that were read is none of its sizes.
    """
    largest = max(float(squares.max(initial=0.0)), np.finfo(float).tiny)
    return np.where(squares > _ROUNDING * largest, squares, largest)


def explained(
    joint: JointFit, effect: Effect, shapes: Sequence[tuple[float, ...]]
) -> tuple[list[float], list[list[Array]], list[bool]]:
    """For each shape what an effect explains of the residuals, its sizes in each session, and if all are told."""
    terms, names = [], []
    for k, readings in enumerate(_acting(effect, joint)):
        tried = [] if readings is None else [effect_term(effect, readings, shape, mapped=False) for shape in shapes]
        numbered = [tuple(replace(p, name=f"{s}: {p.name}") for p in term.parameters) for s, term in enumerate(tried)]
        terms.append([replace(t, parameters=own) for t, own in zip(tried, numbered, strict=True)])
        names.append([[joint.assembly.published(k, p) for p in own] for own in numbered])
    screened = screen_joint(joint, terms)
    place = {name: j for j, name in enumerate(screened.names)}
    gains, sizes, told = [], [], []
    for s in range(len(shapes)):
        mine = [[place[name] for name in own[s]] if own else [] for own in names]
        pick = np.unique(np.concatenate(mine).astype(np.int64))
        inner, right = screened.gram[np.ix_(pick, pick)], screened.gram[pick, -1]
        scale = np.sqrt(_more_than_rounding(screened.squares[pick]))
        inner = inner / np.outer(scale, scale)
        size = np.linalg.pinv(inner, rcond=1e-10, hermitian=True) @ (right / scale) / scale
        gains.append(float(right @ size))
        told.append(bool(np.linalg.eigvalsh(inner).min(initial=np.inf) > _LEAST_SHARE_LEFT))
        sizes.append([size[np.searchsorted(pick, np.array(own, dtype=np.int64))] for own in mine])
    return gains, sizes, told


def _acting(effect: Effect, joint: JointFit) -> list[Observations | None]:
    """Readings of each session; None where the effect cannot act."""
    return [m.observations if effect.why_not(m.observations) is None else None for m in joint.assembly.models]


def without_absorbed(fit: JointFit, effects: Sequence[Effect]) -> tuple[list[Effect], tuple[NotDetermined, ...]]:
    """The effects without those that the models take up together.

    An effect that only repeats the models' own unknowns would make these undetermined and add nothing.
    """
    kept, absorbed = [], []
    for effect in effects:
        acting = _acting(effect, fit)
        grid = effect.shape_grid(together([o for o in acting if o is not None]))
        tried = ([[] if o is None else [effect_term(effect, o, shape, mapped=False)] for o in acting] for shape in grid)
        screened = (screen_joint(fit, terms) for terms in tried)
        if any((np.diag(one.gram)[:-1] > ABSORBED * one.squares[:-1]).any() for one in screened):
            kept.append(effect)
        else:
            absorbed.append(NotDetermined(effect.id, _TAKEN_UP, effect.id))
    return kept, tuple(absorbed)


def _determined_columns(fit: Fit, terms: Sequence[Term]) -> tuple[list[Term], tuple[NotDetermined, ...]]:
    """The terms without single columns that the model takes up, such as a shift with a temperature that stood still.

    Left in, such a column would make the model's own unknowns undetermined.
    """
    if not terms:
        return [], ()
    screened = screen(fit, np.concatenate([term.columns for term in terms]))
    seen = np.diag(screened.gram)[:-1] > ABSORBED * screened.squares[:-1]
    kept, left, first = [], list[NotDetermined](), 0
    for term in terms:
        own = seen[first : first + len(term.columns)]
        first += len(term.columns)
        kept.append(_with_columns(term, own, _TAKEN_UP, left))
    return kept, tuple(left)


def _with_columns(term: Term, keep: BoolArray, why: str, left: list[NotDetermined]) -> Term:
    """A term with some of its columns; the others are added to what is left out."""
    left += [NotDetermined(p.name, why, p.owner) for p, k in zip(term.parameters, keep, strict=True) if not k]
    parameters = tuple(p for p, k in zip(term.parameters, keep, strict=True) if k)
    return Term(term.name, parameters, term.columns[keep], None if term.field is None else term.field[keep])


def _without_repeated_columns(fit: Fit, terms: Sequence[Term]) -> tuple[list[Term], tuple[NotDetermined, ...]]:
    """The terms without columns that only repeat others: the straight part of EXX beside a scale of X.

    Simple effects come first: of a polynomial, what a scale or a squareness says already is left out.
    """
    if len(terms) < 2:
        return list(terms), ()
    screened = screen(fit, np.concatenate([term.columns for term in terms]))
    scale = np.sqrt(np.maximum(np.diag(screened.gram)[:-1], np.finfo(float).tiny))
    inner = screened.gram[:-1, :-1] / np.outer(scale, scale)
    seen = scale**2 > ABSORBED * screened.squares[:-1]
    starts = np.cumsum([0, *(len(term.columns) for term in terms)])
    taken: list[int] = []
    kept, left = list(terms), list[NotDetermined]()
    for k in sorted(range(len(terms)), key=lambda k: len(terms[k].columns)):
        own = np.arange(starts[k], starts[k + 1])
        # Among a term's own columns the model decides: what they repeat of each other is not meant.
        pairs = ((j, own[:i].tolist()) for i, j in enumerate(own))
        said = [seen[j] and _repeats(inner, j, [*taken, *b]) and not _repeats(inner, j, b) for j, b in pairs]
        again = np.array(said, dtype=bool)
        if (again.all() and len(own) == 1) or not again.any():
            taken += [int(j) for j in own if seen[j]]
            continue
        kept[k] = _with_columns(terms[k], ~again, say("undetermined.said_by_others"), left)
        taken += [int(j) for j in own[~again] if seen[j]]
    return [term for term in kept if term.parameters], tuple(left)


def _repeats(inner: Array, column: int, taken: Sequence[int]) -> bool:
    """Whether a column is a combination of others, from their inner products outside the model."""
    if not taken:
        return False
    pick = list(taken)
    weights = np.linalg.lstsq(inner[np.ix_(pick, pick)], inner[pick, column], rcond=1e-9)[0]
    return bool(inner[column, column] - inner[pick, column] @ weights < ABSORBED)


def refuse_idle(effects: Sequence[Effect], observations: Observations) -> None:
    """A ModelError if an effect cannot act in these readings."""
    for effect in effects:
        if (why := effect.why_not(observations)) is not None:
            raise ModelError(f"effect {effect.id}: {why}")


def add_effects(model: MethodModel, effects: Sequence[Effect]) -> MethodModel:
    """The model with these effects; nonlinear coefficients are fitted and published with their uncertainty.

    A ModelError if an effect cannot act in these readings.
    """
    observations = model.observations
    refuse_idle(effects, observations)
    if not effects:
        return model
    bare = fit_models([model]).fits[0]
    effects, absorbed = without_absorbed(bare.joint, effects)
    linear = [effect for effect in effects if not effect.shapes]
    curved = [effect for effect in effects if effect.shapes]
    terms, taken_up = _determined_columns(bare, [effect_term(effect, observations) for effect in linear])
    terms, repeated = _without_repeated_columns(bare, terms)
    base = replace(model, left_out=model.left_out + absorbed + taken_up + repeated).with_terms(terms)
    shapes: dict[str, tuple[tuple[float, ...], Array | None]] = {}
    grids = {effect.id: effect.shape_grid(observations) for effect in curved}
    # One after the other, and once more each with the others at their best.
    for _ in range(2 if len(curved) > 1 else 1):
        for effect in curved:
            others = [effect_term(e, observations, *shapes[e.id]) for e in curved if e.id in shapes and e is not effect]
            fit = fit_models([base.with_terms(others)]).fits[0]
            shape, found = common_shape(fit.joint, effect, grids[effect.id])
            shapes[effect.id] = shape, found[fit.index]
    full = base.with_terms([effect_term(effect, observations, *shapes[effect.id]) for effect in curved])
    moving = [effect for effect in curved if not all(shape.discrete for shape in effect.shapes)]
    fitted = fit_models([full]).fits[0].joint if moving else None
    loose = [effect for effect in moving if fitted and unbounded(fitted, effect)]
    if loose:
        # A nonlinear coefficient that nothing bounds is no number: it is held where the readings like it best.
        shapes |= {e.id: (within_grid(shapes[e.id][0], grids[e.id]), None) for e in loose}
        held = [effect_term(effect, observations, *shapes[effect.id]) for effect in curved]
        left = tuple(one for effect in loose for one in held_at(effect, shapes[effect.id][0]))
        full = replace(base, left_out=base.left_out + left).with_terms(held)
    return full.reestimated()


def held_at(effect: Effect, shape: tuple[float, ...]) -> tuple[NotDetermined, ...]:
    """Nonlinear coefficients of an effect that are held, and at what."""
    return tuple(
        NotDetermined(f"{effect.id}.{c.name}", say("undetermined.held_at", value=f"{value:.3g} {c.unit}"), effect.id)
        for c, value in zip(effect.shapes, shape, strict=True)
        if not c.discrete
    )


def unbounded(fit: JointFit, effect: Effect) -> bool:
    """Whether a nonlinear coefficient of an effect in the fit comes out impossible, or less certain than large."""
    wanted = {f"{effect.id}.{s.name}" for s in effect.shapes if not s.discrete}
    # By least squares, and as they are published: with what does not reproduce, and what is known of effects' sizes.
    ways = ((fit.solution, fit.birge_ratio), (fit.published, 1.0))
    for k, parameter in enumerate(fit.assembly.parameters):
        if parameter.name in wanted:
            moved = [float(solution.theta[k]) for solution, _ in ways]
            u = [scatter * float(solution.covariance[k, k]) ** 0.5 for solution, scatter in ways]
            known = zip(moved, u, strict=True)
            sure = all(parameter.reference + m > s and abs(m) <= abs(parameter.reference) for m, s in known)
            if not (fit.solution.determined[k] and sure):
                return True
    return False
