"""The posterior of everything about a fit: what it knows of the machine, and where it was taken.

The readings are linearised at the posterior's own mean, again until that no longer moves.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from orthoglide.effects.places import Place
from orthoglide.errors import ClosureError, NumericsError, SolverError
from orthoglide.explanation.columns import Everything, everything
from orthoglide.explanation.faults import Fault
from orthoglide.explanation.mixture import LEAST_SHARE, Averaged, Mixture
from orthoglide.explanation.suspects import Key, Suspect, with_commands
from orthoglide.fit import Estimate
from orthoglide.fit.factors import Block
from orthoglide.fit.least_squares import about_machine, linearise, nuisances
from orthoglide.fit.solving import assessed, solve, widened
from orthoglide.geometry import Array
from orthoglide.machine import Machine
from orthoglide.machine_file import Posterior
from orthoglide.notes import Note
from orthoglide.ordering import best_of
from orthoglide.parameters import Parameter

_LINEARISATIONS = 3
_DOUBT = 3.0
"""Log of the odds, twenty to one, that a base beyond its tolerances has to have against all else,
or all else against it, for the other not to count."""

_SETTLED = 0.1
"""Root mean square, in sigmas of a reading, by which the prediction may still differ from its
linearisation: a hundredth of a chi2 a reading, next to nothing of any cause."""

_UNSETTLED = 1.25
"""Root mean square, in sigmas, from which a prediction is another than its linearisation: more than
noise. Machines off by all their tolerances come to 1.1; what a command typed wrong was taken for,
to 1.3 and more."""

_COMMAND = 2e-6
"""Metres by which the size of a wrong command may still change."""

_HELD = 1e-10
"""Variance, in tolerances, of what another parameter stands for: nothing is known of it apart."""

TOLERANCES, _SHOWN = 3.0, 3.0
"""What shows less than three sigmas of all readings together at three tolerances is invisible."""


@dataclass(frozen=True, eq=False, repr=False)
class FullPosterior:
    """Everything that could be wrong, as the readings have it."""

    before: Estimate  # the fit of the base
    about: Everything  # the readings linearised at the mean
    mixture: Mixture  # of the explanations
    # a fit of the base, far beyond its tolerances, that the readings do not rule out
    instead: Estimate | None = None

    @property
    def mean(self) -> Array:
        """Of all coefficients, in their units ``(C,)``."""
        return self.mixture.mean

    @property
    def evidence(self) -> float:
        """Log evidence of the best explanation; a base many tolerances off was expected less."""
        widths = np.array([u.width for u in self.before.problem.unknowns])
        fit = self.mixture.total(self.mixture.best) - self.about.outside / 2
        return float(fit - np.log(widths).sum())

    @property
    def quiet(self) -> float:
        """Chi2 a degree of freedom of the best explanation, its priors counted."""
        return self.mixture.chi2 / max(len(self.mixture.linear.residual), 1)

    @property
    def standing(self) -> tuple[Suspect, ...]:
        """Faults of the data and changes of the best explanation."""
        by_name = {s.name: s for s in self.about.suspects}
        names = [self.mixture.linear.groups[k].name for k, _ in self.mixture.best]
        return tuple(by_name[name] for name in names if name in by_name)

    def fault(self, suspect: Suspect) -> Fault:
        """A fault of the best explanation, with its size in it."""
        mixture = self.mixture
        names = [g.name for g in mixture.linear.groups]
        at = mixture.linear.groups[names.index(suspect.name)].places
        return suspect.sized(mixture.likeliest_mean(mixture.best)[at])

    @property
    def next_point(self) -> Array:
        """Parameters about which readings are linearised again ``(P,)``, SI: the mean, but dials
        that do not stand out do nothing.
        """
        known, effect_of = self.about.known, self.before.problem.machine.catalogue.effect_of
        of_dial = np.array([effect_of(n).of_dial for n in self.about.problem.names])
        for group, _ in self.mixture.best:
            places = self.mixture.linear.groups[group].places
            of_dial[places[places < known]] = False
        return np.where(of_dial, 0.0, (self.mean * self.about.scale)[:known])

    @cached_property
    def known(self) -> Averaged:
        """Of all coefficients, in their units; of use where the mean has settled."""
        return self.mixture.averaged(self.about.known)

    @cached_property
    def covariance(self) -> Array:
        """Of these ``(C, C)``.

        Where the machine as a whole sits is known to the full tolerances, whatever the background,
        and as well as the readings tell.
        """
        count, along = self.about.known, self.about.translations
        seen = self.mixture.linear.columns[:, :count] @ along
        missing = max(1 - min(self.share, 1.0) ** 2, 1e-6)
        spread = np.linalg.inv(np.eye(along.shape[1]) / missing + seen.T @ seen)
        found = self.known.covariance.copy()
        found[:count, :count] += along @ spread @ along.T
        return found

    @cached_property
    def _alone(self) -> Array:
        """Variance of each coefficient that the background holds back, were it alone off by about
        its tolerance ``(C,)``; 0 of others.

        Small scales are learned from what the readings see; of what they do not see they are a
        guess, and at a later visit with another sheet no more may be held against that.
        """
        found, at = np.zeros(len(self.covariance)), np.arange(self.about.known)
        variance, spike = self.mixture.likeliest_variance(at)
        held = (spike < 1.0) & (variance < spike) & (spike > _HELD)
        precision = 1 / variance[held] - 1 / spike[held] + 1.0
        found[at[held]] = 1 / precision
        return found

    @property
    def settled(self) -> bool:
        """Whether the machine found predicts the readings about as its linearisation does, and no
        worse than the base: else what it leaves was never looked at.
        """
        before, after = self.before.scores, self.after.scores
        # A few readings have no degree of freedom left: less than one in chi2 is nothing.
        near = after.chi2 <= before.chi2 + max(after.dof, 1.0)
        return near and self.about.apart < _UNSETTLED

    @property
    def share(self) -> float:
        """Of their tolerances, by which effects that do not stand out are off."""
        return self.mixture.shares[0]

    @cached_property
    def invisible(self) -> tuple[Parameter, ...]:
        """Parameters beyond the base that would not show at three tolerances: what they draw is
        drawn by the base, by the instruments' nuisances or by a plate's own shape, or is too small.
        """
        columns = self.mixture.scales[0].basis.columns
        place = {n: k for k, n in enumerate(self.about.problem.names)}
        plate = {e.name for e in self.about.problem.machine.catalogue.effects if e.of_body}

        def shown(name: Parameter) -> float:
            # One plate has one shape, in how many setups it may have been probed.
            same = [n for n in place if (n.effect, n.direction) == (name.effect, name.direction)]
            each = same if name.effect in plate else [name]
            return TOLERANCES * float(np.linalg.norm(columns[:, [place[n] for n in each]].sum(1)))

        return tuple(n for n in self.about.asked if shown(n) < _SHOWN)

    @cached_property
    def places(self) -> tuple[Place, ...]:
        """Places that belong to the machine and are probable enough to be part of it."""
        likely = {
            g.name
            for g, p in zip(self.mixture.linear.groups, self.mixture.inclusion, strict=True)
            if g.free and p > LEAST_SHARE
        }
        return tuple(p for p in self.about.places if p.name in likely and p.of_machine)

    def machine_with(self, mean: Array) -> tuple[tuple[str, ...], Array, Array]:
        """Names of the last campaign's machine parameters, values SI, and weights by coefficient.

        Args:
            mean: of all coefficients ``(C,)``.
        """
        names, matrix = self.about.problem.of_machine(self.about.problem.last)
        scale, start = self.about.scale, self.about.known
        weights = np.hstack([matrix, np.zeros((len(names), len(scale) - start))])
        found = list(names)
        for place in self.places:
            at = self.about.coefficients(place)
            rows = np.zeros((len(at), len(scale)))
            rows[np.arange(len(at)), at] = 1.0
            weights, found = np.vstack([weights, rows]), [*found, *place.effect.motions]
        weights = weights * scale
        return tuple(found), weights @ mean, weights

    @cached_property
    def machine(self) -> Machine:
        """The calibrated machine: its mean, with its covariance."""
        start = self.before.problem.machine
        known = start.catalogue
        start = start.with_effects(p.effect for p in self.places if p.effect.name not in known)
        names, values, weights = self.machine_with(self.mean)
        spread, alone = weights @ self.covariance @ weights.T, weights**2 @ self._alone
        kept = dict(zip(names, values.tolist(), strict=True))
        return start.with_posterior(kept, Posterior(names, values, spread, alone))

    @cached_property
    def after(self) -> Estimate:
        """The readings as the mean has them, scored; what was learned in place of tolerances."""
        about, mixture, prior = self.about, self.mixture, self.known.prior
        count, scale = about.known, about.scale
        known = _rows(prior[:count, :count]) / scale[:count]
        earlier = self.before.problem
        rows, target = [known], [np.zeros(len(known))]
        if earlier.earlier is not None:
            matrix, goal = about.known_rows
            rows, target = [*rows, matrix], [*target, goal]
        problem = replace(
            about.problem,
            prior=(np.vstack(rows), np.concatenate(target)),
            curves=self._curves(prior),
        )
        x = (self.mean * scale)[:count]
        at = linearise(problem, x)
        if (near := about_machine(problem, at)) is not problem:
            problem, at = near, linearise(near, x)
        estimate = assessed(problem, nuisances(problem, at.seen), at, "posterior",
                            len(mixture.children), self.about.apart)  # fmt: skip
        # What of the base could be wrong in place of what is told.
        far = () if self.instead is None else self.instead.warnings
        instead = [n.partition(":")[0] for n in far if n.kind == "tolerance"]
        told = [Note(f"these readings fit as well if {n}: measure it", "instead") for n in instead]
        return replace(
            estimate,
            covariance=self.covariance[:count, :count] * scale[:count] * scale[:count, None],
            weak=self.before.weak,
            warnings=(*estimate.warnings, *told),
        )

    def _curves(self, prior: Array) -> Block | None:
        """Rows by the places that may stand out and by the plates' own shapes, as nuisances: the
        mean is over explanations, each of which needs its own.
        """
        linear, best = self.mixture.linear, {k for k, _ in self.mixture.best}
        likely = [k in best or p > LEAST_SHARE for k, p in enumerate(self.mixture.inclusion)]
        each = zip(linear.groups, likely, strict=True)
        out = [g.places for g, out in each if (g.free or g.of_data) and out]
        at = np.concatenate([*out, np.flatnonzero(linear.unnamed)]).astype(np.intp)
        if not len(at):
            return None
        sd = np.where(linear.unnamed, 1.0, np.sqrt(np.diag(prior)))[at]
        return Block(self.about.rows[:, at], sd)


def glance(before: Estimate) -> FullPosterior:
    """Everything weighed about the fit of the base alone."""
    return _about(before, (), faults=True)


def first_look(before: Estimate) -> FullPosterior:
    """As :func:`glance`, with wrong commands put right and everything weighed again."""
    try:
        return _looked(before)
    except ClosureError as error:
        raise SolverError(_unreached(before)) from error


def _looked(before: Estimate) -> FullPosterior:
    found, done = glance(before), dict[str, float]()
    for _ in range(_LINEARISATIONS):
        told = {s.name: s for s in found.standing if s.fault.commands}
        sizes = {name: found.fault(one).size for name, one in told.items()}
        if sizes.keys() == done.keys() and all(
            abs(size - done[name]) < _COMMAND for name, size in sizes.items()
        ):
            break
        done, wrong = sizes, [found.fault(one) for one in told.values()]
        problem = with_commands(before.problem, wrong)
        fit = solve(problem, method="nested", widen=False) if wrong else before
        found = _about(fit, (), corrected=wrong, faults=True)
    return found


def full_posterior(
    before: Estimate,
    given: Sequence[str] = (),
    look: FullPosterior | None = None,
    unsure: Collection[Key] = (),
) -> FullPosterior:
    """Weigh everything that could be wrong against the readings; causes that are given stand out
    whatever these say.

    A base fitted far beyond its tolerances may be bent by what stands within its own: both are
    weighed, the base with its priors as wide as it asks for and everything at its tolerance. The
    result's own fit of it may keep the tolerances that ``before`` left.

    Args:
        before: the fit.
        given: names of causes.
        look: what was seen at first of the same fit, or of that at its tolerances.
        unsure: faults that the data may have.

    Raises:
        SolverError: where the mean does not settle.
    """
    # What changed since a calibration, or between campaigns, is known to be no such base.
    unknowns = before.problem.unknowns
    if before.problem.earlier is not None or any(u.name.campaign for u in unknowns):
        return _settled(before, given, look, unsure)
    at_tolerance = before.problem.at_tolerance()
    held = at_tolerance is before.problem
    try:
        narrow = before
        if not held:
            narrow = solve(at_tolerance, widen=False) if look is None else look.before
        other = _settled(narrow, given, look, unsure)
    except NumericsError:
        if held:
            raise
        return _settled(before, given, None, unsure)
    wide = widened(before) if held else before
    if held and wide is before:
        return other
    unsettled = other.about.apart >= _SETTLED
    try:
        found = _settled(wide, given, None, unsure)
    except SolverError:
        if unsettled and not held:
            raise
        return other
    if unsettled:
        # What a wide base needs causes beside it for may be what bent it.
        return other if held and found.mixture.best else found
    less = found.evidence - other.evidence
    if less > _DOUBT:
        return found
    return replace(other, instead=wide if less > -_DOUBT else None)


def _settled(
    before: Estimate,
    given: Sequence[str],
    look: FullPosterior | None = None,
    unsure: Collection[Key] = (),
) -> FullPosterior:
    """The posterior linearised at its own mean, from a first look at the same fit on."""
    try:
        found = look if look is not None and not given else _about(before, given, faults=unsure)
        best = found
        for _ in range(_LINEARISATIONS - 1):
            if found.about.apart < _SETTLED:
                break
            found = _about(before, given, found, faults=unsure)
            # Two explanations may take turns, each where the other is linearised.
            best = best_of((best, found), lambda one: -one.about.apart)
    except ClosureError as error:
        raise SolverError(_unreached(before)) from error
    return best


def _about(
    before: Estimate,
    given: Sequence[str],
    last: FullPosterior | None = None,
    corrected: Sequence[Fault] = (),
    faults: bool | Collection[Key] = False,
) -> FullPosterior:
    """The posterior of readings linearised at the fit of the base, or at the last mean."""
    at, start = (None, ()) if last is None else (last.next_point, last.mixture.standing)
    about = everything(before, at, corrected, faults)
    found = FullPosterior(before, about, Mixture(about.linear, given, start))
    return replace(found, about=replace(about, apart=about.distance(found.mean)))


def _unreached(before: Estimate) -> str:
    """Why a machine does not close over its stroke, and what to do, in a sentence."""
    far = [note.partition(":")[0] for note in before.warnings if note.kind == "tolerance"]
    if not far:
        return (
            "the machine found does not close: the readings, or their units, are not those "
            "of this machine"
        )
    return (
        f"the machine found does not reach all of its stroke: {'; '.join(far)}: put these right "
        f"in the controller or on the machine, or give a shorter stroke in the machine file"
    )


def _rows(covariance: Array) -> Array:
    """Rows ``W`` with ``W^T W`` the inverse of a covariance ``(P, P)``."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray((vectors / np.sqrt(np.maximum(values, 1e-12 * values.max()))).T)
