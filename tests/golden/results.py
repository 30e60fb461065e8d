"""Run the golden cases, and reduce what they leave to the numbers that are frozen.

Only the command line, the files that it writes and ``Machine.forward`` are used, so that nothing
here depends on how the package is built.
"""

from __future__ import annotations

import csv
import itertools
import json
import runpy
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

import orthoglide as og
from tests.command_line import done

HERE = Path(__file__).parent
SEEN = 0.6
"""A parameter is frozen where its sigma is below this share of its tolerance."""

FOLDERS = {"tests": HERE.parent, "inputs": HERE / "inputs", "package": files("orthoglide")}
"""Names that command lines and files of a case may have in braces."""

_SIGNIFICANT = 0.003  # lack of fit, as the verdicts count it
Frozen = dict[str, Any]


@dataclass(frozen=True)
class Case:
    """One case of ``cases.toml``.

    Attributes:
        name: of the case and of its golden file.
        run: command lines.
        machine: nominal machine file, or empty for the nominal Orthoglide.
        effects: file of a user's effects, or empty.
        thorough: whether it runs with ``--thorough`` only.
        tolerance: by name.
        levels_mm: of the commands at which the TCP is compared.
    """

    name: str
    run: tuple[str, ...]
    machine: str
    effects: str
    thorough: bool
    tolerance: Mapping[str, float]
    levels_mm: list[float]

    @property
    def file(self) -> Path:
        """The golden file."""
        return HERE / "expected" / f"{self.name}.json"

    @property
    def own_effects(self) -> list[og.Effect]:
        """Effects of the user's own file."""
        if not self.effects:
            return []
        values = runpy.run_path(self.effects.format_map(FOLDERS)).values()
        return [value for value in values if isinstance(value, og.Effect)]

    @property
    def golden(self) -> Frozen:
        """What the case gave when it was frozen."""
        return dict(json.loads(self.file.read_text(encoding="utf-8")))


def cases() -> list[Case]:
    """Return all cases in the order of their file."""
    found = tomllib.loads((HERE / "cases.toml").read_text(encoding="utf-8"))
    return [
        Case(
            one["name"],
            tuple(one["run"]),
            one.get("machine", ""),
            one.get("effects", ""),
            one.get("thorough", False),
            found["tolerance"] | one.get("tolerance", {}),
            found["grid"][one.get("commands", "rho_mm")],
        )
        for one in found["case"]
    ]


def result_of(case: Case, out: Path) -> Frozen:
    """Run a case in an empty folder and return what of its result is frozen."""
    folders = FOLDERS | {"out": out}

    def filled(text: str) -> str:
        return text.format_map(folders)

    *first, last = case.run
    for command in first:
        done(*map(filled, command.split()))
    done(*map(filled, last.split()), "--out", out / "result", "--quiet")
    result = json.loads((out / "result" / "result.json").read_text(encoding="utf-8"))
    effects = case.own_effects
    nominal = (
        og.Machine.load(filled(case.machine), effects) if case.machine else og.Machine.nominal()
    )
    calibrated = og.Machine.load(out / "result" / "calibrated.toml", effects)
    changes = out / "result" / "changes.csv"
    return {
        "verdict": result["verdict"],
        "scores": dict(scores(result)),
        "effects": [effect(one) for one in result["effects"]],
        "located": [located(one) for one in result["located"]],
        "data_faults": [{"kind": b["kind"], "rows": b["rows"]} for b in result["blunders"]],
        "changed": [changed(one) for one in result["changed"]],
        "compared": list(compared(changes)) if changes.exists() else [],
        "parameters": dict(parameters(result)),
        "tool": dict(tool(result)),
        "tcp_mm": tcp(nominal, calibrated, case),
    }


def rounded(value: float | None) -> float | None:
    """Return a number to six digits, which is more than any tolerance asks for."""
    return None if value is None else float(f"{value:.6g}")


def scores(result: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield rms of the readings, and whether the lack of fit is significant."""
    for fit in ("nominal", "before", "after"):
        p = result[fit]["lack_of_fit_p"]
        yield f"{fit}_rms_mm", rounded(result[fit]["rms_mm"])
        yield f"{fit}_lack_of_fit", None if p is None else p < _SIGNIFICANT


def member(one: Mapping[str, Any]) -> Frozen:
    """Return a member of a credible set: a cause, a located error or a fault of the data."""
    if "data" in one:  # an alternative in the readings themselves
        return {"name": f"data {one['data']}", "probability": rounded(one.get("probability"))}
    if "part" in one:
        return {"name": place(one), "probability": rounded(one["probability"])}
    size = {key: rounded(one[key]) for key in ("probability", "value", "sigma")}
    return {"name": one["name"], **size, "unit": one["unit"]}


def effect(one: Mapping[str, Any]) -> Frozen:
    """Return the credible set of a cause, the one that is named first."""
    others = [*one["rivals"], *one.get("places", ())]
    return {"set": [member(one), *map(member, others)]}


def place(one: Mapping[str, Any]) -> str:
    """Name the place of a located error and what it depends on."""
    words = [f"{one['part']} {one['leg'] or one['setup'] or 'all'}"]
    if one["direction"]:
        words.append(f"toward {one['direction']}")
    words.append(f"against {one['against']}")
    if one["by_leg"]:
        words.append(f"of {one['by_leg']}")
    return " ".join(words)


def located(one: Mapping[str, Any]) -> Frozen:
    """Return a located error with its class, the one that is named first."""
    return {
        "probability": rounded(one.get("class_probability", one["probability"])),
        "rms_mm": rounded(one["rms_mm"]),
        "set": [member(each) for each in one["class"]],
        "causes": sorted(str(cause) for cause in one.get("resembling", ())),
    }


def changed(one: Mapping[str, Any]) -> Frozen:
    """Return a change between campaigns."""
    numbers = {key: rounded(one[key]) for key in ("from", "to", "sigma")}
    return {"parameter": one["parameter"], **numbers, "unit": one["unit"]}


def compared(file: Path) -> Iterator[Frozen]:
    """Yield the rows of ``changes.csv``."""
    with open(file, newline="", encoding="utf-8") as rows:
        for row in csv.DictReader(rows):
            numbers = {key: float(row[key]) for key in ("old", "new", "sigma")}
            yield {"parameter": row["parameter"], **numbers, "changed": row["changed"]}


def parameters(result: Mapping[str, Any]) -> Iterator[tuple[str, Frozen]]:
    """Yield value and sigma of the parameters that the readings see."""
    for name, one in result["parameters"].items():
        if one["sigma"] < SEEN * one["tolerance"]:
            yield name, {key: rounded(one[key]) for key in ("value", "sigma")}


def tool(result: Mapping[str, Any]) -> Iterator[tuple[str, float | None]]:
    """Yield mean errors of the tool to expect, after the best translation, millimetres."""
    for state in ("now", "zeros", "compensated"):
        if state in (result["tool"] or {}):
            yield state, rounded(result["tool"][state]["shape_mm"])


def tcp(nominal: og.Machine, calibrated: og.Machine, case: Case) -> list[list[float]]:
    """Return rows of a command, the nominal TCP and the calibrated machine's error there."""
    commands = np.array(list(itertools.product(case.levels_mm, repeat=3)))
    expected = nominal.forward(commands * 1e-3) * 1e3
    error = calibrated.forward(commands * 1e-3) * 1e3 - expected
    return [
        [*map(float, command), *np.round(p, 8).tolist(), *np.round(e, 6).tolist()]
        for command, p, e in zip(commands, expected, error, strict=True)
    ]


def text(frozen: Frozen) -> str:
    """Return JSON with one entry of each list or table a line, for differences that can be read."""
    blocks = []
    for key, value in frozen.items():
        if isinstance(value, dict):
            inner = ",\n".join(f"  {json.dumps(k)}: {json.dumps(v)}" for k, v in value.items())
            body = f"{{\n{inner}\n }}" if inner else "{}"
        elif isinstance(value, list) and value:
            entries = ",\n".join(f"  {entry(one)}" for one in value)
            body = f"[\n{entries}\n ]"
        else:
            body = json.dumps(value)
        blocks.append(f" {json.dumps(key)}: {body}")
    return "{\n" + ",\n".join(blocks) + "\n}\n"


def entry(one: Any) -> str:
    """Return an entry of a list, a credible set with one member a line."""
    if isinstance(one, dict) and "set" in one:
        rest = {key: value for key, value in one.items() if key != "set"}
        members = ",\n    ".join(json.dumps(m) for m in one["set"])
        head = json.dumps(rest)[1:-1] + ", " if rest else ""
        return f'{{{head}"set": [\n    {members}\n  ]}}'
    return json.dumps(one)
