"""Machines of a user's own dimensions and tolerances, each with something wrong or nothing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from orthoglide.effects.free_form import FreeForm
from orthoglide.effects.wording import cause_short
from orthoglide.explanation import visible_free_form_errors, with_all_parameters
from orthoglide.machine import Machine
from orthoglide.observations import Readings
from orthoglide.parameters import Parameter
from orthoglide.planning import predicted_problem


@dataclass(frozen=True)
class Kind:
    """What is wrong with some of the machines."""

    name: str  # for tables
    share: float = 0.0  # of their tolerances by which all effects are off
    extra_error: str = ""  # significant error besides: "effect", "outside" the catalogue, or none


NOTHING, EFFECT = Kind("nothing"), Kind("one effect", extra_error="effect")
OUTSIDE = Kind("outside the catalogue", extra_error="outside")
ALL_EFFECTS = tuple(Kind(f"everything, f = {share:g}", share) for share in (0.1, 0.3, 1.0))
KINDS = (NOTHING, EFFECT, OUTSIDE, *ALL_EFFECTS)
"""In the order of tables."""

KIND_SEQUENCE = (
    EFFECT, ALL_EFFECTS[0], OUTSIDE,
    EFFECT, ALL_EFFECTS[1], NOTHING,
    EFFECT, OUTSIDE, ALL_EFFECTS[2],
)  # fmt: skip
"""Kinds of successive campaigns: a small rehearsal is a fair sample of a larger one."""

EFFECT_SIZES = (3.0, 10.0)
"""Sizes of a single effect, in tolerances."""

FREE_FORM_SIZES = (0.5, 2.0)
"""Root mean squares of a free-form error, in its prior standard deviations."""


@dataclass(frozen=True, eq=False)
class Scope:
    """Everything that may be wrong with a machine and that a sheet may show."""

    machine: Machine  # dimensions, tolerances and instruments; without errors
    sheets: tuple[Readings, ...]  # rows to be read, of dials and of instruments at the tool
    # beyond zeros and lengths, of effects whose conditions the sheets vary, of instruments too
    parameters: tuple[Parameter, ...]
    free_forms: tuple[FreeForm, ...]  # that the sheets may show

    @classmethod
    def of(cls, machine: Machine, *sheets: Readings) -> Scope:
        """Return the scope of sheets, whose readings do not count, on a machine without errors."""
        bare = machine.with_only({})
        full_model = with_all_parameters(predicted_problem(bare, sheets))
        names = (n.plain for n in full_model.names if n.effect not in bare.catalogue.base)
        setups = [s.name for sheet in sheets for s in sheet.setups]
        parameters = tuple(bare.catalogue.parameter(n, setups) for n in names)
        errors = visible_free_form_errors(full_model)
        errors = tuple(e for e in errors if e.in_model and not (e.is_local or e.is_line))
        return cls(bare, sheets, parameters, errors)


@dataclass(frozen=True, eq=False)
class DrawnMachine:
    """One machine as it is."""

    kind: Kind  # what is wrong
    machine: Machine  # with all its errors
    sizes: Mapping[str, float] = field(default_factory=dict)  # beyond zeros, lengths; tolerances
    cause: str = ""  # the active cause, as verdicts call it; empty if there is none
    size: float = 0.0  # of that, in tolerances or in prior deviations of a free-form error
    words: str = ""  # what that is, as a clause


def kind_of_campaign(scope: Scope, number: int) -> Kind:
    """Return what is wrong in a campaign; an effect if the sheets show no free-form error."""
    kind = KIND_SEQUENCE[number % len(KIND_SEQUENCE)]
    return EFFECT if kind == OUTSIDE and not scope.free_forms else kind


def draw_machine(scope: Scope, kind: Kind, rng: np.random.Generator) -> DrawnMachine:
    """Return a machine with zeros and lengths off by their tolerances, and what its kind adds."""
    bare = scope.machine
    values = {
        str(n): bare.tolerance(n) * float(rng.standard_normal())
        for n in bare.catalogue.expand(bare.catalogue.base)
    }
    if kind.extra_error == "outside":
        return _draw_free_form_error(scope, kind, values, rng)
    sizes, cause, size, words = dict[str, float](), "", 0.0, ""
    if kind.share:
        sizes = {str(n): kind.share * float(rng.standard_normal()) for n in scope.parameters}
    if kind.extra_error == "effect":
        cause, size, sizes = _draw_effect(scope, rng)
        words = cause_short(bare.catalogue, cause)
    values |= {n: v * bare.tolerance(n) for n, v in sizes.items()}
    return DrawnMachine(kind, bare.with_only(values), sizes, cause, size, words)


def _draw_effect(scope: Scope, rng: np.random.Generator) -> tuple[str, float, dict[str, float]]:
    """Return the name of an effect, its size, and sizes by parameter, all effects as likely."""
    effects = list(dict.fromkeys(n.effect for n in scope.parameters))
    effect = scope.machine.catalogue[effects[int(rng.integers(len(effects)))]]
    members = [n for n in scope.parameters if n.effect == effect.name]
    parameter, size = members[int(rng.integers(len(members)))], float(rng.uniform(*EFFECT_SIZES))
    if not effect.paired:
        return str(parameter), size, {str(parameter): size * float(rng.choice([-1.0, 1.0]))}
    parts = [n for n in members if n.undirected == parameter.undirected]
    direction = rng.standard_normal(len(parts))
    direction *= size / np.linalg.norm(direction)
    sizes = dict(zip(map(str, parts), direction.tolist(), strict=True))
    return str(parameter.undirected), size, sizes


def _draw_free_form_error(
    scope: Scope, kind: Kind, values: dict[str, float], rng: np.random.Generator
) -> DrawnMachine:
    """Return a machine with a free-form error that no shape of the catalogue describes."""
    error = scope.free_forms[int(rng.integers(len(scope.free_forms)))]
    u = np.linspace(-1, 1, 201)
    functions = np.stack(error.kernel.functions(u), axis=1)
    weights = rng.standard_normal((functions.shape[1],))
    # Level, slope and curvature are removed.
    parabola = np.polynomial.legendre.legvander(u, 2).T @ functions / len(u)
    weights -= np.linalg.pinv(parabola) @ (parabola @ weights)
    size = float(rng.uniform(*FREE_FORM_SIZES))
    weights *= size * error.prior_sd / np.sqrt(np.mean((functions @ weights) ** 2))
    effect = error.effect
    values = values | dict(zip(effect.motions, weights.tolist(), strict=True))
    machine = scope.machine.with_effects([effect]).with_only(values)
    return DrawnMachine(kind, machine, {}, error.name, size, error.words)
