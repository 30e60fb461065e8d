"""The candidates: every effect that these readings could show, alone, structured, or whole."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from orthoglide.effects import Catalogue, Effect
from orthoglide.parameters import Parameter


@dataclass(frozen=True)
class Candidate:
    """A cause that may be added to the model."""

    name: str  # `axis_tilt.y.z`, `axis_tilt.cyclic`, an effect's own, or `screw_error.x`
    effect: str  # name of its effect
    parameters: tuple[Parameter, ...]  # what is freed if it is added, as `with_free` takes it
    # of the elementary unknowns, one mapping for each of `parameters`
    weights: tuple[Mapping[str, float], ...]

    @property
    def size(self) -> int:
        """Number of parameters."""
        return len(self.parameters)

    @property
    def relative_prior(self) -> float:
        """How often it goes wrong, over a cause of one part. A pattern counts as the parts that it
        moves, as each would have to be wrong; a common error counts as one, as parts of one drawing
        and one supplier have it together.
        """
        if self.size > 1 or self.parameters[0].plain.endswith("common"):
            return 1.0
        return 1.0 / len(self.weights[0])


def candidates(
    names: Sequence[Parameter], effects: Sequence[Effect], catalogue: Catalogue
) -> tuple[Candidate, ...]:
    """All candidates made of elementary unknowns, campaigns included: single, structured, and
    effects whole.
    """
    found: dict[str, Candidate] = {}
    for effect in effects:
        mine = [n for n in names if n.effect == effect.name]
        single = (
            _dial_candidates(effect, mine, catalogue)
            if effect.of_dial
            else _machine_candidates(effect, mine, catalogue)
        )
        for candidate in (*single, *_family_candidates(effect, mine)):
            # The same parameters under two names would be one cause twice.
            each = (sorted((str(n), w) for n, w in c.items()) for c in candidate.weights)
            found.setdefault(repr(sorted(each)), candidate)
    return tuple(found.values())


def _dial_candidates(
    effect: Effect, names: list[Parameter], catalogue: Catalogue
) -> list[Candidate]:
    """Candidates of dials: each campaign has its own."""
    members = [Candidate(n, effect.name, (n,), ({n: 1.0},)) for n in names]
    if effect.of_body:  # shared by all campaigns, and of each setup only where there is one
        shared = catalogue.structured_members(effect.name, tuple({n.setup for n in names}))
        return (
            [
                _pattern_candidate(effect, member, seen)
                for member, weights in shared.items()
                if (seen := {n: 1.0 for n in names if n.plain in weights})
            ]
            if len(set(names)) > len({n.direction for n in names})
            else members
        )
    for campaign in dict.fromkeys(n.campaign for n in names):
        here = [n.plain for n in names if n.campaign == campaign]
        setups = tuple(n.setup for n in here)
        for member, weights in catalogue.structured_members(effect.name, setups).items():
            full = {n.at(campaign): w for n, w in weights.items()}
            members.append(_pattern_candidate(effect, member.at(campaign), full))
    return members


def _machine_candidates(
    effect: Effect, names: list[Parameter], catalogue: Catalogue
) -> list[Candidate]:
    """Candidates of the machine: what campaigns have for themselves makes one cause together."""
    parts: dict[Parameter, list[Parameter]] = {}
    for name in names:
        parts.setdefault(name.plain, []).append(name)
    members = [
        Candidate(plain, effect.name, tuple(full), tuple({n: 1.0} for n in full))
        for plain, full in parts.items()
    ]
    shared = {plain for plain, full in parts.items() if full == [plain]}
    patterns = catalogue.structured_members(effect.name)
    separate = {tuple(n.campaign for n in full) for full in parts.values()}
    if shared or len(separate) != 1:
        return members + [
            _pattern_candidate(effect, m, w) for m, w in patterns.items() if set(w) <= shared
        ]
    (campaigns,) = separate
    for member, weights in patterns.items():
        if set(weights) <= set(parts):
            copies = tuple({str(n.at(c)): w for n, w in weights.items()} for c in campaigns)
            freed = tuple(member.at(c) for c in campaigns)
            members.append(Candidate(member, effect.name, freed, copies))
    return members


def _pattern_candidate(
    effect: Effect, member: Parameter, weights: Mapping[Parameter, float]
) -> Candidate:
    return Candidate(member, effect.name, (member,), ({str(n): w for n, w in weights.items()},))


def _family_candidates(effect: Effect, names: list[Parameter]) -> list[Candidate]:
    """An effect whole; and where a leg has several parameters of one cause, those of each leg."""
    if effect.of_dial or len(names) < 2:
        return []
    # Where legs share their directions an effect whole is patterns of its own: the common ones.
    patterned = len({n.direction for n in names}) > 1 and effect.names.same_directions
    blocks = {} if patterned else {effect.name: names}
    if effect.paired:
        for name in names:
            blocks.setdefault(f"{effect.name}.{name.leg}", []).append(name)
    return [
        Candidate(name, effect.name, tuple(members), tuple({m: 1.0} for m in members))
        for name, members in blocks.items()
    ]
