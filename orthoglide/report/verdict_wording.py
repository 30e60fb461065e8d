"""A verdict in words: the sentence that its report begins with, and what follows from it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from orthoglide.effects import family_of
from orthoglide.numerals import compact, decimals_for
from orthoglide.report.causes import short
from orthoglide.report.wording import explained_by, sentence

if TYPE_CHECKING:
    from orthoglide.report.verdict_view import Explained, View

_MOST_RIVALS = 2
_SLIGHT = 0.9  # of what was left before: a fit that leaves more explains little


def headline(view: View) -> str:
    """The verdict in a few sentences, for somebody with a spanner in hand."""
    verdict = view.verdict
    begin = {
        "adequate": _adequate,
        "unexplained": _unexplained,
        "partial": _partial,
    }.get(verdict.word, _explained)
    return begin(view) + _faults(view)


def _faults(view: View) -> str:
    """Faults of the data belong to the verdict: a reader of the first lines must know."""
    count = len(view.verdict.blunders)
    changed = "".join(f" {sentence(c.message)}" for c in view.verdict.changed)
    if not count:
        return changed
    return (
        f" {count} fault{'s' if count > 1 else ''} in the data had to be dealt with first.{changed}"
    )


def _adequate(view: View) -> str:
    base = view.verdict.base
    return (
        f"Nothing is wrong that these readings could show beyond the {explained_by(base)}: with "
        f"these set right, {_fall(view, 'nominal')}, which is the noise of the dial."
    )


def _unexplained(view: View) -> str:
    base = view.verdict.base
    return (
        f"Something is wrong that no cause known to this program explains: with the "
        f"{explained_by(base)} set right, {_fall(view, 'nominal')}, where the dial's noise is "
        f"{_noise(view)} a reading."
    )


def _explained(view: View) -> str:
    return (
        f"{_causes(view)} With this in the model, {_fall(view, 'before')}, "
        f"which is the noise of the dial."
    )


def _partial(view: View) -> str:
    return (
        f"{_causes(view)} This is not all: with it in the model, {_fall(view, 'before')}, where "
        f"the dial's noise is {_noise(view)} a reading, and no cause known to this program "
        f"explains the rest."
    )


def _causes(view: View) -> str:
    said = [sentence(f"{e.words}{alternatives(e)}") for e in view.effects]
    return " ".join([said[0], *(f"Besides, {s[:1].lower()}{s[1:]}" for s in said[1:])])


def alternatives(explained: Explained) -> str:
    """Rivals of a cause, in brackets; empty where there are none."""
    rivals = explained.effect.rivals
    if not rivals:
        return ""
    chosen = explained.effect.name
    named = [short(r.trial.candidate.name, chosen) for r in rivals[:_MOST_RIVALS]]
    rest = len(rivals) - len(named)
    text = ", or ".join(named)
    if rest:
        text += f", or {rest} further cause{'s' if rest > 1 else ''} named below"
    return f" (or {text}: these readings cannot tell)"


def _fall(view: View, since: str) -> str:
    base = view.verdict.base
    first = (base.nominal if since == "nominal" else base.scores).deviation_rms * 1e3
    after = _after(view)
    places = decimals_for(after, 3)
    verb = "hardly falls" if after > _SLIGHT * first else "falls"
    return f"what prediction leaves of the readings {verb} from {first:.{places}f} to " + (
        f"{after:.{places}f} mm rms"
    )


def _after(view: View) -> float:
    return view.verdict.fit.scores.deviation_rms * 1e3


def _noise(view: View) -> str:
    return f"{compact(view.verdict.fit.problem.noise.typical * 1e3, 2)} mm"


def look_at(view: View) -> list[tuple[str, str]]:
    """What to look at on the machine: the causes of one family, and where to look."""
    by_family: dict[str, list[str]] = {}
    for explained in view.effects:
        for name, _ in explained.fits:
            family = by_family.setdefault(family_of(name).name, [])
            if name not in family:
                family.append(name)
    return [
        (sentence("; or ".join(short(n) for n in names)), sentence(family_of(family).look_at))
        for family, names in by_family.items()
    ]


def cautions(view: View) -> tuple[str, ...]:
    """What speaks against acting on the causes as they stand, a sentence each."""
    verdict, found = view.verdict, []
    if verdict.word == "partial":
        causes = "causes named explain" if len(view.effects) > 1 else "cause named explains"
        found.append(
            f"The {causes} only part of what is wrong, and may stand in for something that this "
            f"program does not know: do not act on it, nor put its numbers in a controller, before "
            f"it is confirmed."
        )
    held = verdict.hold_out
    if view.effects and held is not None and held.after_rms > held.before_rms:
        found.append(
            "The readings held out are predicted worse with the cause than without it: it does not "
            "carry over to them, so do not act on it before it is confirmed."
        )
    return tuple(found)


_TOLD = {
    "adequate": "adequate: nothing significant is left, and nothing was added",
    "explained": "explained: a cause was added, and nothing significant is left",
    "ambiguous": "ambiguous: explained, but other causes fit these readings as well",
    "partial": "partial: a cause was added, and something significant is left",
    "unexplained": "unexplained: something significant is left, and no cause deserves its name",
}


def told(word: str) -> str:
    """What the verdict's word means."""
    return _TOLD[word]
