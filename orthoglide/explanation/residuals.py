"""Where what a fit leaves lives: in which readings, how much of it, and at which station most."""

from __future__ import annotations

import numpy as np

from orthoglide.fit import Estimate
from orthoglide.geometry import LEGS
from orthoglide.machine import Machine
from orthoglide.numerals import plain
from orthoglide.observations import Readings
from orthoglide.observations.approach import Ints
from orthoglide.ordering import descending, ranked
from orthoglide.result import SetupResidual

_MOST_STATIONS = 3  # at which most is left
_CLEAR_RATIO = 1.05  # ratio of the largest residual to the next from which its posture is named
_ROUNDING = 1e-6  # of the noise of a reading, root mean square


def residual_by_setup(estimate: Estimate) -> tuple[SetupResidual, ...]:
    """What a fit leaves of every mounting of a dial, and of every axis of an instrument at the
    tool, largest share first; TCP points have no mounting.
    """
    problem, found = estimate.problem, list[SetupResidual]()
    squares = problem.weighing.whiten(estimate.residuals) ** 2
    total = float(squares.sum())
    # Of readings without noise what is left is rounding, and is nowhere more than elsewhere.
    residuals = estimate.residuals * (total > len(squares) * _ROUNDING**2)
    squares = squares / total if residuals.any() else np.zeros_like(squares)
    for factor, rows in zip(problem.factors, problem.factor_rows, strict=True):
        if (given := factor.readings).by_point:
            continue
        parts = np.column_stack([given.setup, given.axis])
        for part in np.unique(parts, axis=0):
            own = np.flatnonzero((parts == part).all(axis=1))  # in the file, and among all rows
            among = rows.start + own
            setup, left = given.setups[part[0]], residuals[among]
            _, at, of = np.unique(problem.station[among], return_index=True, return_inverse=True)
            mean = np.bincount(of, given.sign[own] * left) / np.bincount(of)
            most = descending(np.abs(mean))
            where = own[at[most]]
            _, fresh = np.unique(given.command[where], axis=0, return_index=True)
            worst = where[np.sort(fresh)[:_MOST_STATIONS]]
            # Of two stations with a free datum, both residuals are equal.
            first, *others = np.abs(mean[most]).tolist()
            named = first > _CLEAR_RATIO * max(others[:1], default=0.0)
            leg = setup.leg
            one = SetupResidual(
                setup=setup.name,
                kind=setup.kind,
                leg=leg,
                axis=int(part[1]),
                share=float(squares[among].sum()),
                rms=float(np.sqrt(np.mean(left**2))),
                most=float(mean[most[0]]),
                posture=given.posture[worst[0]] if named else "",
                command=given.command[worst[0]],
                where=_tool_positions(problem.machine, given, worst) if given.of_tool else (),
            )
            found.append(one)
    return tuple(ranked(found, lambda one: one.share))


def _tool_positions(machine: Machine, campaign: Readings, rows: Ints) -> tuple[str, ...]:
    """Places of the tool in rows ``(n,)``, or from there to the second command's; of what touches a
    plate without the height.
    """
    kinematics, own = machine.spec.kinematics, campaign.setups[campaign.setup[rows[0]]].observation
    told = machine.with_only({}).forward if kinematics is None else kinematics.places
    names = LEGS[:2] if own.touches else LEGS
    each = [
        [", ".join(f"{n} {plain(v * 1e3, 0)}" for n, v in zip(names, p, strict=False))
         for p in told(ends[rows])]
        for ends in ((campaign.command, campaign.second) if own.paired else (campaign.command,))
    ]  # fmt: skip
    return tuple(" to ".join(ends) for ends in zip(*each, strict=True))
