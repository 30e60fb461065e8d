"""The smallest detectable effects as rows of text for the command line."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from orthoglide.prospects.detectable import Detectability


def detectable_rows(found: Detectability, width: int, beyond: float = 0.0) -> list[str]:
    """Return a row for the parameters of an effect that are found from about the same size: the
    largest sizes that one of them takes to be found, and to be named.

    Args:
        found: of a sheet.
        width: in characters; what is nearest stands below its row where that is too narrow.
        beyond: tolerances; effects that are found and named from less have no row.
    """
    head = f"{'effect':<20}{'tolerance':>11}{'found from':>12}{'named from':>12}  unit"
    rows = list(_effect_rows(found, beyond))
    if max((len(size) + len(near) + 2 for size, near in rows), default=0) <= width:
        lines = [f"{head}  nearest", *(f"{size}  {near}" for size, near in rows)]
    else:
        lines = [
            head,
            *(text for size, near in rows for text in (size.rstrip(), f"    nearest: {near}")),
        ]
    if found.invisible:
        groups: dict[str, list[str]] = {}
        for name in found.invisible:
            groups.setdefault(name.effect, []).append(name.behind)
        listed = [f"{effect} ({', '.join(members)})" for effect, members in groups.items()]
        lines.append(f"not detectable: {', '.join(listed)}")
    return lines


def _effect_rows(seen: Detectability, beyond: float) -> Iterator[tuple[str, str]]:
    """Sizes of each row, and what its hardest is taken for; which parameters, where not all."""
    for row in zip(*seen.columns.values(), strict=True):
        effect, unit, tolerance, found, named, hardest, nearest, parameters = row
        if max(found, named) <= beyond * tolerance:
            continue
        size = f"{named:.2g}" if np.isfinite(named) else "never"
        sizes = f"{effect:<20}{tolerance:>11.2g}{found:>12.2g}{size:>12}"
        of = f" (of {parameters})" if parameters and parameters != hardest.behind else ""
        yield f"{sizes}  {unit:<4}", f"{nearest} for {hardest}{of}"
