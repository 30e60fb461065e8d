"""The candidate causes: single parameters, structured members and whole effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from orthoglide.effects import Catalogue, Effect
from orthoglide.parameters import Parameter


@dataclass(frozen=True)
class Candidate:
    """A cause that may be added to the model."""

    name: str  # as `axis_tilt.y.z`, `axis_tilt.cyclic`, `axis_tilt` or `screw_error.x`
    effect: str  # name of its effect
    parameters: tuple[Parameter, ...]  # that it frees, as `with_free` takes them
    weights: tuple[Mapping[str, float], ...]  # of elementary unknowns, for each of `parameters`

    @property
    def size(self) -> int:
        """Number of parameters."""
        return len(self.parameters)

    @property
    def relative_prior(self) -> float:
        """Prior probability, relative to a cause of one part.

        A pattern over n parts has 1/n, as each of them would have to be wrong. A common error has
        1, as parts of one drawing and one supplier share their errors.
        """
        if self.size > 1 or self.parameters[0].plain.endswith("common"):
            return 1.0
        return 1.0 / len(self.weights[0])


def candidates(
    names: Sequence[Parameter], effects: Sequence[Effect], catalogue: Catalogue
) -> tuple[Candidate, ...]:
    """Return all candidates made of elementary unknowns: single, structured, and whole effects."""
    by_weights: dict[str, Candidate] = {}
    for effect in effects:
        own_names = [n for n in names if n.effect == effect.name]
        single = (
            _dial_candidates(effect, own_names, catalogue)
            if effect.of_dial
            else _machine_candidates(effect, own_names, catalogue)
        )
        for candidate in (*single, *_family_candidates(effect, own_names)):
            # Equal weights under two names would be one cause twice.
            weights_key = (sorted((str(n), w) for n, w in c.items()) for c in candidate.weights)
            by_weights.setdefault(repr(sorted(weights_key)), candidate)
    return tuple(by_weights.values())


def _dial_candidates(
    effect: Effect, names: list[Parameter], catalogue: Catalogue
) -> list[Candidate]:
    """Return the candidates of an effect of dials: its members within each campaign."""
    members = [Candidate(n, effect.name, (n,), ({n: 1.0},)) for n in names]
    if effect.of_body:  # one plate, which all setups and campaigns share
        if len(set(names)) == len({n.direction for n in names}):
            return members
        shared = catalogue.structured_members(effect.name, tuple({n.setup for n in names}))
        weights_of = {m: {n: 1.0 for n in names if n.plain in w} for m, w in shared.items()}
        return [_pattern_candidate(effect, m, w) for m, w in weights_of.items() if w]
    for campaign in dict.fromkeys(n.campaign for n in names):
        plain_names = [n.plain for n in names if n.campaign == campaign]
        setups = tuple(n.setup for n in plain_names)
        for member, weights in catalogue.structured_members(effect.name, setups).items():
            weights_by_name = {n.at(campaign): w for n, w in weights.items()}
            members.append(_pattern_candidate(effect, member.at(campaign), weights_by_name))
    return members


def _machine_candidates(
    effect: Effect, names: list[Parameter], catalogue: Catalogue
) -> list[Candidate]:
    """Return the candidates of an effect of the machine.

    The parameters that are specific to campaigns make one cause together.
    """
    copies_by_parameter: dict[Parameter, list[Parameter]] = {}
    for name in names:
        copies_by_parameter.setdefault(name.plain, []).append(name)
    members = [
        Candidate(plain, effect.name, tuple(full), tuple({n: 1.0} for n in full))
        for plain, full in copies_by_parameter.items()
    ]
    shared = {plain for plain, full in copies_by_parameter.items() if full == [plain]}
    patterns = catalogue.structured_members(effect.name)
    campaign_sets = {tuple(n.campaign for n in full) for full in copies_by_parameter.values()}
    if shared or len(campaign_sets) != 1:
        complete = {m: w for m, w in patterns.items() if set(w) <= shared}
        return members + [_pattern_candidate(effect, m, w) for m, w in complete.items()]
    (campaigns,) = campaign_sets
    for member, weights in patterns.items():
        if set(weights) <= set(copies_by_parameter):
            copies = tuple({str(n.at(c)): w for n, w in weights.items()} for c in campaigns)
            parameters = tuple(member.at(c) for c in campaigns)
            members.append(Candidate(member, effect.name, parameters, copies))
    return members


def _pattern_candidate(
    effect: Effect, member: Parameter, weights: Mapping[Parameter, float]
) -> Candidate:
    return Candidate(member, effect.name, (member,), ({str(n): w for n, w in weights.items()},))


def _family_candidates(effect: Effect, names: list[Parameter]) -> list[Candidate]:
    """Return a whole effect and, if a leg has several of its parameters, those of each leg."""
    if effect.of_dial or len(names) < 2:
        return []
    # If all legs have the same directions, the common patterns represent the whole effect.
    has_patterns = len({n.direction for n in names}) > 1 and effect.names.same_directions
    blocks = {} if has_patterns else {effect.name: names}
    if effect.paired:
        for name in names:
            blocks.setdefault(f"{effect.name}.{name.leg}", []).append(name)
    return [
        Candidate(name, effect.name, tuple(members), tuple({m: 1.0} for m in members))
        for name, members in blocks.items()
    ]
