"""What the published readings say once the loop is closed on them, and what they cannot say.

    python docs/tables/published_experiments.py              prints it
    python docs/tables/published_experiments.py --markdown   as docs/published-experiments.md

Readings: Pashkevich et al. 2008, tables 1 and 2.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path

import misprints

import orthoglide as og
from orthoglide.numerals import probability
from orthoglide.observations import Campaign
from orthoglide.verdict import close_loop

DATA = Path(str(files("orthoglide") / "data"))


_SAME = 0.01  # of a residual: less is no difference


def campaign(name: str) -> Campaign:
    """A packaged campaign by its file's stem."""
    return og.read_campaign(DATA / f"{name}.csv")


def main() -> None:
    """Print the page, as text or Markdown."""
    print("\n".join(markdown() if "--markdown" in sys.argv[1:] else plain()))


def plain() -> Iterator[str]:
    """The page without its Markdown."""
    for line in markdown():
        yield line.replace("**", "").replace("`", "")


def markdown() -> Iterator[str]:
    """The page, line by line."""
    yield from introduction()
    yield from alone()
    yield from together()
    yield from held_out()
    yield from sources()
    yield from misprints.markdown().rstrip().splitlines()


def introduction() -> Iterator[str]:
    """What was done."""
    yield "# The published experiments"
    yield ""
    yield (
        "Read this page to see what the closed loop says of the papers' own readings, and which "
        "of their printed figures are wrong. Printed by "
        "`python docs/tables/published_experiments.py --markdown`. Lengths are in mm, rms."
    )
    yield ""


def alone() -> Iterator[str]:
    """Each experiment by itself: deviations from Zero, and the differences Max - Min of table 1."""
    yield "## Each experiment alone"
    yield ""
    yield (
        "Table 2 has twelve averaged deviations an experiment, table 1 six differences, of which "
        "joint offsets take three degrees of freedom; the stated repeatability is 0.02 mm. *Times "
        "noise*: the residual of offsets and lengths; *chance*: the probability that noise alone "
        "leaves as much with the *background*, in tolerances."
    )
    yield ""
    yield (
        "| readings | verdict | named | deviations before, after | times noise | background | "
        "chance |"
    )
    yield "|---|---|---|---|---:|---:|---:|"
    names = [f"experiment{k}" for k in (2, 3)] + [f"experiment{k}-differences" for k in (1, 2, 3)]
    for name in names:
        verdict = close_loop(campaign(name))
        before, after = verdict.before.scores, verdict.after.scores
        named = ", ".join(f"`{e.name}` ({e.probability:.2f})" for e in verdict.effects) or "none"
        yield (
            f"| {name} | **{verdict.word}** | {named} | "
            f"{before.deviation_rms * 1e3:.3f}, {after.deviation_rms * 1e3:.3f} | "
            f"{verdict.before.sigma_scale:.1f} | {verdict.left.background:.1f} | "
            f"{probability(verdict.left.p_value)} |"
        )
    yield ""


def together() -> Iterator[str]:
    """Experiments 2 and 3 with shared geometry and their own offsets."""
    verdict = close_loop([campaign("experiment2"), campaign("experiment3")], own=["joint_offset"])
    yield "## Both experiments together"
    yield ""
    yield (
        "Offsets, which were changed in the controller between the two, are specific to each "
        "experiment; everything else is shared."
    )
    yield ""
    before, after = verdict.before.scores, verdict.after.scores
    yield (
        f"Verdict **{verdict.word}**: deviations {before.deviation_rms * 1e3:.3f} before, "
        f"{after.deviation_rms * 1e3:.3f} after; stations left out {before.cv_rms * 1e3:.3f} "
        f"and {after.cv_rms * 1e3:.3f}."
    )
    if verdict.possible:
        yield ""
        yield (
            "No effect is certain: 24 averages without repeats do not show their noise. With each "
            "of the two most probable effects:"
        )
        yield ""
        yield "| effect | probability | size | deviations | stations left out |"
        yield "|---|---|---|---|---|"
    for one in verdict.possible[:2]:
        yield (
            f"| `{one.name}` | {one.probability:.2f} | {one.words} | "
            f"{one.after.deviation_rms * 1e3:.3f} | {one.after.cv_rms * 1e3:.3f} |"
        )
    if verdict.possible:
        yield ""
    for effect in verdict.effects:
        shown = ", ".join(f"`{p}` {v:+.2e}" for p, v in effect.chosen.values.items())
        others = ", ".join(effect.indistinguishable_from) or "nothing"
        yield f"Added: {effect.name} ({shown}; SI), not to be told from {others}."
    change = [
        (verdict.before.values[f"joint_offset.{leg}@experiment3"]
         - verdict.before.values[f"joint_offset.{leg}@experiment2"]) * 1e3
        for leg in "xyz"
    ]  # fmt: skip
    yield (
        f"Change of the offsets, experiment 3 less experiment 2: {change[0]:+.2f}, "
        f"{change[1]:+.2f}, {change[2]:+.2f} mm; table 3 gives +0.48, -0.49, +1.67 mm."
    )
    yield ""


def held_out() -> Iterator[str]:
    """Does what is learned on one predict the other?"""
    yield "## Prediction of the other experiment"
    yield ""
    yield (
        "Geometry from one experiment; offsets and datums fitted to the other, each reading scored "
        "left out."
    )
    yield ""
    pairs = (("experiment2", "experiment3"), ("experiment3", "experiment2"))
    change = []
    for learned, predicted in pairs:
        verdict = close_loop(campaign(learned), holdout=campaign(predicted), own=["joint_offset"])
        score = verdict.hold_out
        assert score is not None
        change.append(score.after.length / score.before.length - 1)
        yield (
            f"- {learned} predicts {predicted}: {score.before.length * 1e3:.3f} by offsets and "
            f"lengths, {score.after.length * 1e3:.3f} with what was found."
        )
    yield ""
    yield (
        "Nothing is active in either, so the calibrated machine is that of offsets and lengths."
        if max(map(abs, change)) < _SAME
        else "It does not: what is found in one experiment makes the other's readings worse."
        if min(change) > 0
        else "It does not hold both ways."
        if max(change) > 0
        else "It does: what is found in one experiment improves the other's readings."
    )
    yield ""


def sources() -> Iterator[str]:
    """Where the readings come from, and how they may be used."""
    yield "## The printed readings"
    yield ""
    yield (
        "The readings in `orthoglide/data` are numbers typed from the tables of both papers "
        "([sources](../README.md#sources)); `orthoglide/data/SOURCE.md` lists "
        "the table behind every file. The chapter of 2008 is under CC BY-NC-SA 3.0. Its "
        "measurements are facts; of its text only the misprints below are quoted."
    )
    yield ""


if __name__ == "__main__":
    main()
