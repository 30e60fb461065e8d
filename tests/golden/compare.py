"""Compare a result with its golden, by tolerances that say what may change."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

Frozen = Mapping[str, Any]


class Difference(NamedTuple):
    """A difference between a golden and a result.

    Attributes:
        what: is different.
        was: in the golden.
        now: in the result.
        share: of its tolerance; above 1 it is no longer the same result.
    """

    what: str
    was: Any
    now: Any
    share: float

    def __str__(self) -> str:
        share = "" if np.isinf(self.share) else f" ({self.share:.2g} of its tolerance)"
        return f"{self.what}: {shown(self.was)} -> {shown(self.now)}{share}"


def shown(value: Any) -> str:
    """Return a value for a line of text."""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def beyond(found: Sequence[Difference]) -> list[Difference]:
    """Return the differences that are larger than their tolerance."""
    return [one for one in found if one.share > 1]


def differences(was: Frozen, now: Frozen, tolerance: Mapping[str, float]) -> list[Difference]:
    """Return everything that differs, the largest share of its tolerance first."""
    within = Compared(tolerance)
    found = [
        *within.equal("verdict", was["verdict"], now["verdict"]),
        *within.scores(was["scores"], now["scores"]),
        *within.sets("cause", was["effects"], now["effects"]),
        *within.sets("located error", was["located"], now["located"]),
        *within.faults(was["data_faults"], now["data_faults"]),
        *within.rows("change", was["changed"], now["changed"], ("from", "to")),
        *within.rows("compared", was["compared"], now["compared"], ("old", "new"), printed=0.001),
        *within.parameters(was["parameters"], now["parameters"]),
        *within.tool(was["tool"], now["tool"]),
        *within.tcp(was["tcp_mm"], now["tcp_mm"]),
    ]
    return sorted(found, key=lambda one: -one.share)


class Compared:
    """Comparisons of one case.

    Attributes:
        tolerance: by name, as in ``cases.toml``.
    """

    def __init__(self, tolerance: Mapping[str, float]) -> None:
        self.tolerance = tolerance

    def equal(self, what: str, was: Any, now: Any) -> Iterator[Difference]:
        """Yield a difference of what must be equal."""
        if was != now:
            yield Difference(what, was, now, np.inf)

    def near(self, what: str, was: Any, now: Any, allowed: float) -> Iterator[Difference]:
        """Yield a difference of numbers; null is equal to null only."""
        if was is None or now is None:
            yield from self.equal(what, was, now)
        elif was != now:
            yield Difference(what, was, now, abs(now - was) / allowed if allowed else np.inf)

    def sized(
        self, what: str, was: Frozen, now: Frozen, keys: Sequence[str], printed: float = 0.0
    ) -> Iterator[Difference]:
        """Yield differences of values in standard deviations, and of these in parts.

        Args:
            what: they belong to.
            was: entry of the golden.
            now: entry of the result.
            keys: of the values.
            printed: last digit of the file, which may differ by one.
        """
        sigma = was["sigma"]
        for key in keys:
            allowed = (sigma or 0.0) * self.tolerance["value_sigmas"] + printed
            yield from self.near(f"{what}, {key}", was[key], now[key], allowed)
        allowed = (sigma or 0.0) * self.tolerance["sigma_relative"] + printed
        yield from self.near(f"{what}, sigma", sigma, now["sigma"], allowed)

    def scores(self, was: Frozen, now: Frozen) -> Iterator[Difference]:
        """Yield differences of the rms of the readings and of the lack of fit."""
        for key, value in was.items():
            if key.endswith("_rms_mm"):
                allowed = self.tolerance["rms_relative"] * (value or 0.0)
                yield from self.near(key, value, now[key], allowed)
            else:
                yield from self.equal(key, value, now[key])

    def sets(self, what: str, was: Sequence[Frozen], now: Sequence[Frozen]) -> Iterator[Difference]:
        """Yield differences of credible sets, each held against the one it shares most with."""
        left = list(now)
        for one in was:
            names = {member["name"] for member in one["set"]}
            best = max(left, key=lambda other: len(names & _names(other)), default=None)
            if best is None or not names & _names(best):
                yield Difference(what, one["set"][0]["name"], "absent", np.inf)
                continue
            left.remove(best)
            yield from self.one_set(f"{what} {one['set'][0]['name']}", one, best)
        for other in left:
            yield Difference(what, "absent", other["set"][0]["name"], np.inf)

    def one_set(self, what: str, was: Frozen, now: Frozen) -> Iterator[Difference]:
        """Yield differences of the members of a credible set and of their order."""
        before = {member["name"]: member for member in was["set"]}
        after = {member["name"]: member for member in now["set"]}
        for name in dict.fromkeys((*before, *after)):
            if name in before and name in after:
                yield from self.member(f"{what}: {name}", before[name], after[name])
            else:
                member = before.get(name) or after[name]
                words = ("a member", "none") if name in before else ("no member", "one")
                share = member["probability"] / self.tolerance["rare"]
                yield Difference(f"{what}: {name}", *words, share)
        first, second = was["set"][0], before.get(now["set"][0]["name"])
        if second is not None and second is not first:
            gap = first["probability"] - second["probability"]
            share = gap / self.tolerance["probability"]
            yield Difference(f"{what}, first", first["name"], second["name"], share)
        if "rms_mm" in was:
            allowed = self.tolerance["probability"]
            yield from self.near(
                f"{what}, probability", was["probability"], now["probability"], allowed
            )
            allowed = self.tolerance["tcp_relative"] * (was["rms_mm"] or 0.0)
            yield from self.near(f"{what}, rms_mm", was["rms_mm"], now["rms_mm"], allowed)
            yield from self.equal(f"{what}, causes alike", was["causes"], now["causes"])

    def member(self, what: str, was: Frozen, now: Frozen) -> Iterator[Difference]:
        """Yield differences of a member's probability and size."""
        allowed = self.tolerance["probability"]
        yield from self.near(
            f"{what}, probability", was["probability"], now["probability"], allowed
        )
        if "value" in was and "value" in now:
            yield from self.equal(f"{what}, unit", was["unit"], now["unit"])
            yield from self.sized(what, was, now, ("value",))

    def faults(self, was: Sequence[Frozen], now: Sequence[Frozen]) -> Iterator[Difference]:
        """Yield differences of the faults of the data: kind and rows."""
        before, after = ({(f["kind"], *f["rows"]) for f in each} for each in (was, now))
        for kind, *rows in sorted(before - after):
            yield Difference("fault of the data", f"{kind} in rows {rows}", "absent", np.inf)
        for kind, *rows in sorted(after - before):
            yield Difference("fault of the data", "absent", f"{kind} in rows {rows}", np.inf)

    def rows(
        self,
        what: str,
        was: Sequence[Frozen],
        now: Sequence[Frozen],
        keys: Sequence[str],
        printed: float = 0.0,
    ) -> Iterator[Difference]:
        """Yield differences of tables of parameters, in standard deviations."""
        before, after = ({row["parameter"]: row for row in each} for each in (was, now))
        for name in dict.fromkeys((*before, *after)):
            if name not in after or name not in before:
                words = ("listed", "absent") if name in before else ("absent", "listed")
                yield Difference(f"{what} {name}", *words, np.inf)
                continue
            yield from self.sized(f"{what} {name}", before[name], after[name], keys, printed)
            for key in ("unit", "changed"):
                yield from self.equal(
                    f"{what} {name}, {key}", before[name].get(key), after[name].get(key)
                )

    def parameters(self, was: Frozen, now: Frozen) -> Iterator[Difference]:
        """Yield differences of the parameters that the golden has; others may be seen besides."""
        for name, one in was.items():
            if name in now:
                yield from self.sized(name, one, now[name], ("value",))
            else:
                yield Difference(name, "seen", "not seen", np.inf)

    def tool(self, was: Frozen, now: Frozen) -> Iterator[Difference]:
        """Yield differences of the tool's mean errors to expect."""
        for state, value in was.items():
            allowed = self.tolerance["tool_relative"] * abs(value or 0.0)
            allowed = max(allowed, self.tolerance["tcp_mm"])
            yield from self.near(f"tool, {state}", value, now.get(state), allowed)

    def tcp(self, was: Any, now: Any) -> Iterator[Difference]:
        """Yield the largest differences of the nominal TCP and of the calibrated machine's."""
        before, after = np.array(was), np.array(now)
        yield from self.equal("commands", before[:, :3].tolist(), after[:, :3].tolist())
        far = np.abs(after[:, 3:6] - before[:, 3:6]).max(axis=1)
        worst = int(far.argmax())
        share = far[worst] / self.tolerance["nominal_mm"]
        if share > 0:
            points = (before[worst, 3:6].tolist(), after[worst, 3:6].tolist())
            yield Difference("nominal TCP, mm", *points, share)
        largest = float(np.linalg.norm(before[:, 6:], axis=1).max())
        allowed = max(self.tolerance["tcp_relative"] * largest, self.tolerance["tcp_mm"])
        far = np.linalg.norm(after[:, 6:] - before[:, 6:], axis=1)
        worst = int(far.argmax())
        if far[worst] > 0:
            points = (before[worst, 6:].tolist(), after[worst, 6:].tolist())
            place = before[worst, :3].tolist()
            yield Difference(f"TCP error at {place}, mm", *points, far[worst] / allowed)


def _names(one: Frozen) -> set[str]:
    return {member["name"] for member in one["set"]}
