"""What a user should know of a fit, in sentences."""

from __future__ import annotations

from orthoglide.fit.estimate import Estimate
from orthoglide.fit.noise import copied
from orthoglide.notes import Note
from orthoglide.numerals import compact


def notes(estimate: Estimate) -> tuple[Note, ...]:
    """Notes of a fit: what was noticed on reading, lack of fit, bounds, tolerances, the check."""
    problem, scores = estimate.problem, estimate.scores
    noticed = [c.warnings for c in problem.campaigns] + [f.points.warnings for f in problem.points]
    found = [Note(text, "campaign") for texts in noticed for text in texts]
    for campaign in problem.campaigns:
        if count := copied(campaign):
            text = (
                f"all {count} repeats of {campaign.name} are the same to the last digit as the "
                f"visit before: if they are copies they say nothing of the noise, so leave them "
                f"out and declare it with --noise"
            )
            found.append(Note(text, "copies"))
    if estimate.sigma_scale > 1:
        text = (
            f"the residuals are {estimate.sigma_scale:.1f} times the noise of "
            f"{problem.noise.typical * 1e3:.3f} mm (chi2 {scores.chi2:.0f} on {scores.dof:.0f} "
            f"degrees of freedom): the model lacks something, and all sigmas take the readings for "
            f"{estimate.sigma_scale:.1f} times as noisy"
        )
        found.append(Note(text, "lack_of_fit"))
    for name in estimate.on_bound:
        text = f"{name} ended on its bound: it is not identified; check the readings and the units"
        found.append(Note(text, "bound"))
    for unknown, value, far in zip(
        problem.unknowns, estimate.x, problem.far(estimate.x), strict=True
    ):
        if far:
            unit = estimate.unit(unknown.name)
            text = (
                f"{unknown.name} is {abs(value) / unknown.tolerance:.1f} times its tolerance of "
                f"{compact(unknown.tolerance / unit.si, 2)} {unit.name}: measure it, or correct "
                f"the tolerance in the machine file"
            )
            found.append(Note(text, "tolerance"))
    check = estimate.check
    if check is not None and not check.second_order:
        text = (
            f"the linear system (11) fits readings that differ by {check.linear * 1e3:.3g} mm, "
            f"more than second-order terms explain: treat the result with care"
        )
        found.append(Note(text, "second_order"))
    return tuple(found)
