"""Elastic equilibrium: the closed mechanism with stiff bars and legs, under a load."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from orthoglide.errors import ClosureError, InputError
from orthoglide.geometry import LEGS, Array
from orthoglide.mechanism.batch import BatchClosure
from orthoglide.mechanism.compiled import compiled
from orthoglide.mechanism.elastic_functions import BARS, TENSION, ElasticFunctions
from orthoglide.mechanism.mapped import Mapped
from orthoglide.mechanism.tree import RELIEF_NAMES, Tree

RELIEF_LIMIT = float(np.deg2rad(1.0))
"""Angle of a relief joint, radians, beyond which a real leg would rather jam or bend.

With every error drawn at its default tolerance the most twisted leg turns by about a quarter of
this (rms, checked by the tests), so four such standard deviations: beyond it the parts are not what
they are taken for, or the values are not real. A leg also has little to give: its bars must twist,
and its pivots' bearings run on their edges.
"""

SPRINGS: tuple[str, ...] = ("bar 1", "bar 2", "torsion")
"""The springs of a leg."""


def relief_angles(tree: Tree, x: Array) -> Array:
    """Angles of the relief joints ``(N, leg, joint)`` among unknowns ``(N, n)``, radians.

    The first joint is the leg's twist about bar 1, the second bar 2's way out of the plane.
    """
    start = len(tree.passive)
    angles = x[:, start : start + len(tree.relief)]
    return angles.reshape(len(x), len(LEGS), len(RELIEF_NAMES)).copy()


def relief_warnings(angles: Array, legs: Sequence[str] = LEGS) -> tuple[str, ...]:
    """One sentence for each leg that gives more than a leg plausibly can.

    Args:
        angles: of the relief joints ``(..., leg, joint)``, radians.
        legs: their names.
    """
    worst = np.abs(angles).reshape(-1, len(LEGS), len(RELIEF_NAMES)).max(axis=(0, 2), initial=0.0)
    limit = np.rad2deg(RELIEF_LIMIT)
    return tuple(
        f"leg {leg} must twist by {np.rad2deg(angle):.1f} degrees for the loops to close, more "
        f"than the {limit:g} degree that a leg plausibly gives: check the mounting of its carriage "
        f"and the lengths of its bars, or whether the identified values are real"
        for leg, angle in zip(legs, worst, strict=True)
        if not angle <= RELIEF_LIMIT
    )


@dataclass(frozen=True)
class Deformation:
    """What the machine fights against: how far its parts give, and what that costs."""

    relief: Array  # angles of the relief joints (..., leg, joint), radians
    stretch: Array  # elastic growth of the bars (..., leg, bar), metres
    tension: Array  # pull in the bars (..., leg, bar), newtons
    moment: Array  # torsional moment in the legs (..., leg), N m
    drive: Array  # force on each carriage along its axis (..., leg), newtons
    energy: Array  # of the springs (..., leg, spring), joules; the order is `SPRINGS`
    legs: Sequence[str] = LEGS  # their names

    @property
    def total(self) -> Array:
        """Energy of all springs ``(...)``, joules."""
        return np.asarray(self.energy.sum(axis=(-2, -1)))

    @property
    def warnings(self) -> tuple[str, ...]:
        """Legs that give more than is plausible, one sentence each."""
        return relief_warnings(self.relief, self.legs)

    def reshaped(self, shape: tuple[int, ...]) -> Deformation:
        """The same for a batch ``(N,)`` that was flattened from ``shape``."""
        parts = {n: v.reshape(*shape, *v.shape[1:]) for n, v in vars(self).items() if n != "legs"}
        return Deformation(**parts, legs=self.legs)

    def __str__(self) -> str:
        energy = self.energy.reshape(-1, len(LEGS), len(SPRINGS)).sum(axis=0)
        names = [f"leg {leg}'s {spring}" for leg in self.legs for spring in SPRINGS]
        total = float(energy.sum())
        if not total > 0:
            return "the machine fights against nothing: no spring is strained"
        ordered = sorted(zip(energy.ravel() / total, names, strict=True), reverse=True)
        told = ", ".join(f"{name} {share:.0%}" for share, name in ordered if share >= 0.05)
        return f"the machine fights against itself and the load with {total * 1e3:.3g} mJ: {told}"


class ElasticClosure(BatchClosure):
    """Closed postures of least energy, for batches.

    Bars are springs along their length, each leg is a spring in torsion, a load hangs at the TCP
    along base -z. What is *given* of a posture is ``[drives (3); virtual (30); load]``; unknown are
    ``[free joints (21); tensions of the bars (6)]``, tensions in units of ``TENSION``.

    The file's torsional stiffness of a leg acts on ``relief_bar``, the turn of the platform's short
    link against the carriage's about bar 1: that angle is the leg's twist. ``relief_link`` gets no
    spring of its own: it follows the twist in the ratio d / L, as bar 2's tip is carried along, so
    that the one number is the whole stiffness of the leg. Without torsional stiffness and load this
    is the relief closure; with rigid bars, too, whatever the torsional stiffness, for then the
    closure leaves the springs no choice.

    Args:
        tree: with relief and virtual joints.
        bar: axial stiffness of a bar, N/m; rigid bars where absent.
        torsion: torsional stiffness of a leg, N m/rad; none where absent.
        compile: see :class:`~orthoglide.mechanism.batch.BatchClosure`. Stiffness is no part of what
            is compiled: all machines of one geometry share it.

    Raises:
        InputError: for a stiffness that is no positive number (torsion may be 0), or a tree
            without relief joints.
    """

    def __init__(
        self,
        tree: Tree,
        *,
        bar: float | None = None,
        torsion: float | None = None,
        compile: bool | None = None,
    ) -> None:
        if not len(tree.relief) or not len(tree.virtual):
            raise InputError("elastic equilibrium needs the general tree, with its relief joints")
        if bar is not None and not (np.isfinite(bar) and bar > 0):
            raise InputError(f"a bar's stiffness must be positive, in N/m, not {bar}")
        if torsion is not None and not (np.isfinite(torsion) and torsion >= 0):
            raise InputError(f"torsional stiffness must not be negative, in N m/rad: {torsion}")
        self.compliance = 0.0 if bar is None else 1 / bar
        self.torsion = torsion or 0.0
        super().__init__(tree, compile=compile)

    def _build(self) -> dict[str, Any]:
        return ElasticFunctions(self.tree).by_name()

    def _compiled(self, build: bool) -> dict[str, Mapped] | None:
        found = compiled(list(self._plain.values()), build=build)
        return None if found is None else dict(zip(self._plain, map(Mapped, found), strict=True))

    def _known(self, given: Array) -> Array:
        given = np.asarray(given, dtype=float)
        wanted = len(LEGS) + len(self.tree.virtual) + 1
        if given.ndim != 2 or given.shape[1] != wanted:
            raise InputError(f"given must be [drives; virtual; load] (N, {wanted})")
        springs = np.broadcast_to([self.compliance, self.torsion], (len(given), 2))
        return np.concatenate([given, springs], axis=1)

    def _failure(self, index: int, residual: Array, count: int, known: Array) -> ClosureError:
        slack = known[index : index + 1].copy()
        slack[:, -3:] = 0.0  # no load, rigid bars, legs free to twist: do the loops close at all?
        _, without, closed = self._solved(np.zeros(len(residual)), slack, "machine")
        if not closed.all():
            return super()._failure(index, without[0, : len(self.tree.free)], count, known)
        return ClosureError(
            f"{count} of {len(known)} postures find no elastic equilibrium; the first is number "
            f"{index}, which closes without springs: a load of {known[index, -3]:g} N is too heavy "
            f"for the bars, or the legs are too stiff in torsion to be calculated as springs",
            residuals={"equilibrium": float(np.max(np.abs(residual)))},
            index=(index,),
        )

    def forces(self, x: Array, given: Array) -> Array:
        """Generalised forces ``(N, 33)`` that drives and virtual joints feel, N and N m.

        Minus the derivative of the energy, the load's included, by each of them (Castigliano).
        """
        return self._call("force", x, self._known(given))[0]

    def deformation(self, x: Array, given: Array) -> Deformation:
        """Deformation, forces and energy by joint, for unknowns as :meth:`close` returns them."""
        n, legs = len(x), len(LEGS)
        relief = relief_angles(self.tree, x)
        tension = TENSION * x[:, len(self.tree.free) :].reshape(n, legs, BARS // legs)
        stretch, moment = self.compliance * tension, self.torsion * relief[:, :, 0]
        energy = np.concatenate([stretch * tension, (moment * relief[:, :, 0])[..., None]], axis=2)
        drive = self.forces(x, given)[:, :legs]
        names = self.tree.geometry.leg_names
        return Deformation(relief, stretch, tension, moment, drive, energy / 2, names)
