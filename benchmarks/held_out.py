"""Real printers, held against readings that were not used: ``python -m benchmarks.held_out``.

    python -m benchmarks.held_out [FOLDER ...]

Of every ``printer.cfg`` in the folders each set of readings (heights with distances, every mesh) is
used alone, and the machine and the shape of the plate that were found predict each of the others;
only their own height and slopes are fitted, and the reading scored is left out of that. The files
of ``tests/data/delta/held`` were found after the methods were made; only how rare a wide background
is was settled with them in sight.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import orthoglide as og
from benchmarks import public

DATA = Path(__file__).parents[1] / "tests" / "data" / "delta"


@dataclass(frozen=True)
class Predicted:
    """One set of readings, predicted from another; root mean squares in millimetres.

    Attributes:
        machine: name of the file.
        used: set of readings that the machine was calibrated from, and how many.
        other: set that was predicted, and how many.
        word: of the verdict.
        stored: by the numbers that the firmware stores.
        base: by zeros, radii, angles and arms fitted, as by ``identify``.
        closed: by the closed loop.
        sigma: standard deviation of what the closed loop predicts.
        cause: first cause that was found, with how many rivals; empty where none was.
        advised: whether new numbers for the firmware are advised.
    """

    machine: str
    used: str
    other: str
    word: str
    stored: float
    base: float
    closed: float
    sigma: float
    cause: str
    advised: bool


def predictions(path: Path) -> Iterator[Predicted]:
    """Of one printer."""
    found = og.import_printer(path)
    machine = og.Machine(found.machine)
    sets = [c for c in found.campaigns if c.name in found.together]
    for used in sets:
        verdict = og.close_loop([used], machine)
        for other in sets:
            if other is used:
                continue
            yield Predicted(
                path.stem, f"{used.name}, {len(used)}", f"{other.name}, {len(other)}",
                verdict.word, *public.predicted_rms_mm(verdict, machine, used, other),
                public.predicted_sd_mm(verdict, other), _first(verdict),
                any(action.kind == "zeros" for action in verdict.actions),
            )  # fmt: skip


def _first(verdict: og.Verdict) -> str:
    """The first cause or place, and how many others may be in its place."""
    found = [(one.name, len(one.indistinguishable_from)) for one in verdict.effects]
    found += [(one.name, len(one.members) - 1) for one in verdict.located]
    if not found:
        return ""
    name, others = found[0]
    return f"{name} or {others} more" if others else name


def table(found: Sequence[Predicted]) -> Iterator[str]:
    """The table, in Markdown, and what it comes to."""
    yield "| machine | used | predicted | stored | base | closed | verdict | first | numbers |"
    yield "|---|---|---|---:|---:|---:|---|---|---|"
    for p in found:
        figures = " | ".join(f"{one:.3f}" for one in (p.stored, p.base, p.closed))
        advised = "new" if p.advised else "keep"
        yield (
            f"| {p.machine} | {p.used} | {p.other} | {figures} ± {p.sigma:.3f} | {p.word} | "
            f"{p.cause} | {advised} |"
        )
    yield ""
    yield conclusion(found)


def summary(found: Sequence[Predicted]) -> Iterator[str]:
    """A row a machine, in Markdown, and what it comes to."""
    yield "| machine | better than base | closed/base | closed/stored | new numbers | first |"
    yield "|---|---:|---:|---:|---:|---|"
    for machine in dict.fromkeys(p.machine for p in found):
        chosen = [p for p in found if p.machine == machine]
        closed, base, stored = np.array([(p.closed, p.base, p.stored) for p in chosen]).T
        yield (
            f"| {machine} | {np.sum(closed < base)}/{len(chosen)} | "
            f"{np.median(closed / base):.2f} | {np.median(closed / stored):.2f} | "
            f"{sum(p.advised for p in chosen)}/{len(chosen)} | "
            f"{next((p.cause for p in chosen if p.cause), chosen[0].word)} |"
        )
    yield ""
    yield conclusion(found)


def conclusion(found: Sequence[Predicted]) -> str:
    """How many predictions are better, and by how much in the median and at worst."""
    closed, base, stored = np.array([(p.closed, p.base, p.stored) for p in found]).T
    return (
        f"The closed loop predicts {np.sum(closed < base)} of {len(found)} better than the base, "
        f"by a factor of {np.median(closed / base):.2f} in the median (the worst: "
        f"{np.max(closed / base):.2f}), and {np.sum(closed < stored)} better than what is stored "
        f"({np.median(closed / stored):.2f}; {np.max(closed / stored):.2f}). It is worse than the "
        f"base by more than its sigma in {sum(p.closed > p.base + p.sigma for p in found)}, and "
        f"than what is stored in {sum(p.closed > p.stored + p.sigma for p in found)}."
    )


def every(folders: Sequence[Path] = (DATA, DATA / "held")) -> list[Predicted]:
    """Of all printers in some folders."""
    files = [path for folder in folders for path in sorted(folder.glob("*.cfg"))]
    return [one for path in files for one in predictions(path)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="*", type=Path, default=[DATA, DATA / "held"])
    print("\n".join(table(every(parser.parse_args().folders))))


if __name__ == "__main__":
    main()
