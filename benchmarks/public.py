"""The only door from the benchmarks to the package: `import orthoglide` and what is documented.

Verdicts are turned into plain mappings whose keys and units are those of ``result.json``; a test
compares them with that file. Where the package's attributes change, this module alone follows.

Attributes used beside ``og.__all__``:

- of a verdict: ``word``, ``effects``, ``located``, ``blunders``, ``changed``, ``budget``, ``tcp``,
  ``before``, ``after``, ``machine``, ``columns``, ``numbers``, ``left``, ``readings``,
  ``warnings``, ``invisible``, ``unseen``, ``next_measurements``, ``report``;
- of a check: ``changes``; of a machine: ``forward``, ``inverse``, ``values``, ``spec``.
"""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import orthoglide as og
from benchmarks.independent import MACHINE_FILE, PER_UNIT, Array
from tests import rig_campaigns as rc

Result = dict[str, Any]


@cache
def machine() -> og.Machine:
    """Return the machine file of the tests' rig."""
    return og.Machine.load(MACHINE_FILE)


def campaign(rows: Sequence[rc.Row], name: str = "case", **more: Any) -> og.Campaign:
    """Return rows as a campaign."""
    columns = {key: [row[key] for row in rows] for key in rows[0]}
    return og.Campaign.from_frame(columns, name=name, **more)


def tcp_points(rows: Sequence[rc.Row]) -> og.Readings:
    """Return rows of a TCP file as measured points."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "points.tcp.csv"
        rc.write_csv(rows, path)
        return og.read_tcp(path)


def tool_campaign(rows: Sequence[Mapping[str, str]], machine: og.Machine) -> og.Readings:
    """Return rows of readings of the tool, cells as text, as a campaign."""
    columns = {key: [row[key] for row in rows] for key in rows[0]}
    return og.Readings.from_frame(columns, name="case", machine_file=machine.spec)


def error_text(error: Exception) -> str:
    """Return the class and message of an error of the package."""
    return f"{type(error).__name__}: {error}"


# -- verdicts ------------------------------------------------------------------------------------


def verdict_of(verdict: og.Verdict) -> Result:
    """Return verdict, causes, places, data faults and lack of fit, keyed as ``result.json``."""
    return {
        "verdict": verdict.word,
        "effects": [_cause(cause) for cause in verdict.effects],
        "located": [
            {
                "class": [_place(member) for member in found.members],
                "class_probability": found.probability,
                "resembling": list(found.resembling),
            }
            for found in verdict.located
        ],
        "blunders": [
            {"kind": b.kind, "rows": [row for _, row in b.rows_in_request],
             "setups": list(b.setups), "message": b.message}
            for b in verdict.blunders
        ],
        "before": _scores(verdict.before.scores),
        "after": _scores(verdict.after.scores),
        "left": {
            "lack_of_fit_p": verdict.left.p_value, "background": verdict.left.background,
            "stopped": verdict.left.stopped,
        },
    }  # fmt: skip


def _cause(cause: Any) -> Result:
    first, *others = (
        {"name": one.name, "parameters": list(one.parameters), "probability": one.probability,
         "values": {str(n): float(v) for n, v in one.values.items()}}
        for one in cause.explanations
    )  # fmt: skip
    return {**first, "set": [first, *others]}


def _place(curve: Any) -> Result:
    keys = ("leg", "part", "direction", "against", "by_leg", "setup", "short_waves")
    return {key: getattr(curve, key) for key in keys}


def _scores(scores: Any) -> Result:
    return {
        "chi2": scores.chi2, "dof": scores.dof, "rms_mm": 1e3 * scores.rms,
        "lack_of_fit_p": scores.lack_of_fit_p,
    }  # fmt: skip


def place_name(place: Mapping[str, Any]) -> str:
    """Return the one-line name of a place of ``located``, such as ``rail.z.y/travel``."""
    if place["part"] == "dial":
        return f"dial{'.' if place['setup'] else ''}{place['setup'] or ''}/{place['against']}"
    against = "waves" if place["short_waves"] else place["against"]
    if against == "command":
        against = f"command.{place['by_leg']}"
    where = ".".join(str(p) for p in (place["part"], place["leg"], place["direction"]) if p)
    return f"{where}/{against}"


def said(result: Mapping[str, Any]) -> dict[str, list[dict[str, Any]]]:
    """Return causes with their credible sets, and classes of places, ready for JSON."""
    effects = [
        {
            "name": str(e["name"]),
            "family": e["name"].partition(".")[0],
            "members": [[str(m["name"]), m["parameters"], m["probability"]] for m in e["set"]],
        }
        for e in result["effects"]
    ]
    located = [
        {
            "places": [place_name(p) for p in found["class"]],
            "resembling": [str(n) for n in found["resembling"]],
            "probability": found["class_probability"],
        }
        for found in result["located"]
    ]
    return {"effects": effects, "located": located}


def tcp_of(verdict: og.Verdict) -> Result:
    """Return TCP errors after the best translation, mean and largest, millimetres."""
    errors = (verdict.tcp or {})["translation"]
    figures = {k: [1e3 * x for x in getattr(errors, k)] for k in ("nominal", "before", "after")}
    return {**figures, "inside": errors.inside, "stated": stated_mm(verdict)}


def stated_mm(verdict: og.Verdict) -> float:
    """Return the mean TCP error that the result expects of its compensated commands."""
    return float(1e3 * verdict.numbers.expected["compensated"].shape)


def parameters_of(verdict: og.Verdict) -> dict[str, tuple[float, float]]:
    """Return value and sigma of the identified parameters, SI: ``parameters`` of the result."""
    columns = verdict.columns
    rows = zip(columns["parameter"], columns["value"], columns["sigma"], strict=True)
    return {str(n): (v * unit_of(n), s * unit_of(n)) for n, v, s in rows}


def calibrated_of(verdict: og.Verdict) -> dict[str, tuple[float, float]]:
    """Return value and sigma of all parameters of the calibrated machine, SI: those that
    ``calibrated.toml`` leaves out have their sigma in ``calibrated.npz``.
    """
    values, known = verdict.machine.values, verdict.machine.posterior
    sigmas = known.sigmas if known is not None else {}
    return {str(n): (float(values.get(n, 0.0)), float(s)) for n, s in sigmas.items()}


def unit_of(name: str) -> float:
    """Return the size of a parameter's unit in files, SI."""
    return PER_UNIT.get(str(name).partition(".")[0], 1.0)


def base_of(verdict: og.Verdict, families: Collection[str]) -> dict[str, float]:
    """Return the machine's parameters of the base model, SI: those of the families given."""
    values = verdict.before.values
    return {str(n): float(v) for n, v in values.items()
            if str(n).partition(".")[0] in families and not str(n).startswith("plate")}  # fmt: skip


def budget_of(verdict: og.Verdict) -> list[Result]:
    """Return the items of the error budget with their gains, millimetres."""
    return [
        {
            "cause": str(item.cause),
            "members": [str(n) for n in item.members],
            "gain_mm": 1e3 * item.gain,
            "gain_sigma_mm": 1e3 * item.gain_sigma,
            "compensated_mm": 1e3 * item.compensated,
            "compensated_sigma_mm": 1e3 * item.compensated_sigma,
        }
        for item in verdict.budget
    ]


def changes_of(found: og.Verdict | og.Check) -> list[Result]:
    """Return what changed, by a verdict or by a check, SI."""
    changed: list[Result] = []
    for c in found.changed if isinstance(found, og.Verdict) else found.changes:
        si = found.catalogue.effect_of(c.parameter).unit.si if isinstance(found, og.Verdict) else 1
        changed.append({
            "parameter": str(c.parameter), "members": [str(n) for n in c.members],
            "from": c.before * si, "to": c.after * si, "sigma": c.sigma * si,
        })  # fmt: skip
    return changed


def command_faults(result: Mapping[str, Any]) -> Iterator[tuple[str, float]]:
    """Yield drive and size in millimetres of each wrong command, as its message states them."""
    for blunder in result["blunders"]:
        if blunder["kind"] == "command":
            yield from commands_in(blunder["message"])


_COMMAND = re.compile(r"rho_([a-z]) = (-?[\d.]+) mm where (-?[\d.]+)")


def commands_in(message: str) -> Iterable[tuple[str, float]]:
    """Return drive and size (the likely command less the written one, millimetres) of each command
    that the message of a data fault states.
    """
    stated = _COMMAND.findall(message.replace("−", "-"))
    return [(drive, float(likely) - float(written)) for drive, likely, written in stated]


def warned_of_noise(verdict: og.Verdict) -> bool:
    """Whether a warning says that the readings are far noisier than is usual."""
    return any(note.kind == "loud" for note in verdict.warnings)


def unseen_of(verdict: og.Verdict) -> list[str]:
    """Return the effects that the readings cannot show."""
    return [*verdict.invisible, *verdict.unseen.unexcited]


def result_json(verdict: og.Verdict) -> Result:
    """Return ``result.json`` of a verdict, as a report writes it."""
    with tempfile.TemporaryDirectory() as folder:
        verdict.report(Path(folder) / "out")
        text = (Path(folder) / "out" / "result.json").read_text(encoding="utf-8")
    loaded: Result = json.loads(text)
    return loaded


# -- without a public name -----------------------------------------------------------------------

INSIDE = (
    "orthoglide.accuracy", "orthoglide.cli", "orthoglide.closing.judging",
    "orthoglide.fit.factors", "orthoglide.machine_file", "orthoglide.measuring",
    "orthoglide.observations",
)  # fmt: skip
"""Modules of the package that the functions below import, as nothing public does the same."""


def command_line() -> Any:
    """Return the command line, a click group."""
    from orthoglide.cli import cli

    return cli


def asked_by_measure(
    answer: Callable[[str], str], tell: Callable[[str], None]
) -> tuple[int, og.Verdict]:
    """Return the number of readings and the verdict of a session of ``orthoglide measure``.

    Args:
        answer: to a question.
        tell: called with everything that is said.
    """
    from orthoglide.measuring import Record, Session

    seconds = iter(range(0, 10**6, 10))
    with tempfile.TemporaryDirectory() as folder:
        record = Record(Path(folder) / "case.csv", machine().spec)
        end = Session(
            machine(), record, answer, tell, clock=lambda: float(next(seconds))
        ).run()  # fmt: skip
    return end.readings, end.verdict


def predicted_rms_mm(
    verdict: og.Verdict, machine: og.Machine, used: og.Readings, other: og.Readings
) -> tuple[float, float, float]:
    """Return by how much readings that were not used are off, root mean squares in millimetres: by
    the machine given, by the base model and by the verdict's machine.

    The base model is that of ``identify``. That of an *unexplained* verdict is none to compare
    with: the closed loop has fitted it to noise as large as the residual, and takes it over.
    """
    from orthoglide.closing.judging import held_out_rms

    base = {**machine.values, **og.identify([used], machine).values}
    stored, before, after = (
        held_out_rms(values, machine, [other]).length * 1e3 for values in ({}, base, verdict.values)
    )
    return stored, before, after


def predicted_sd_mm(verdict: og.Verdict, other: og.Readings) -> float:
    """Return the standard deviation, root mean square in millimetres, that a verdict's machine
    states for readings that were not used; what their instruments' nuisances take up is left out.
    """
    from orthoglide.fit.factors import Factor

    machine = verdict.machine
    known = machine.posterior
    kept = [k for k, name in enumerate(known.names) if name in machine.catalogue.motions]
    names = [known.names[k] for k in kept]
    factor = Factor.from_planned(other, machine)
    seen = factor.linearise(machine.model, machine.values, names)
    rows = seen.jacobian @ known.covariance_root[kept]
    turn, _ = np.linalg.qr(factor.nuisances(seen.reading_poses).columns)
    past = rows - turn @ (turn.T @ rows)
    return float(np.sqrt(np.mean(np.sum(past**2, axis=1)))) * 1e3


def firmware_of(found: og.Imported) -> Any:
    """Return the firmware's numbers of a printer that was imported."""
    return found.machine.printer.numbers


def residual_sigmas(verdict: og.Verdict) -> Array:
    """Return the residuals of the last fit, in stated sigmas ``(n,)``."""
    read = verdict.readings
    return np.asarray((read.measured - read.after) / np.hypot(read.sigma, read.common))


def tool_map(verdict: og.Verdict) -> tuple[Array, Array, Array]:
    """Return commands, predicted TCP and its 95 % radius over the workspace, metres."""
    from orthoglide.accuracy import tcp_map

    known = tcp_map(verdict.machine)
    return known.commands, known.p, known.uncertainty


def machine_text(machine: og.Machine) -> str:
    """Return the text of a machine file."""
    from orthoglide.machine_file import machine_text

    return str(machine_text(machine.spec))


def campaign_text(campaign: Any, machine: og.Machine | None = None) -> str:
    """Return the text of a campaign file."""
    from orthoglide.observations import campaign_text

    return str(campaign_text(campaign, *([machine.spec] if machine else [])))


def tcp_text(points: og.Readings) -> str:
    """Return the text of a TCP file."""
    return campaign_text(points)
