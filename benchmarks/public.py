"""The only door from the benchmarks to the package: `import orthoglide` and what is documented.

Verdicts are read as ``result.json`` has them. Where the package's attributes change, this module
alone follows.

Attributes used beside ``og.__all__``:

- of a verdict: ``as_dict``, ``word``, ``effects``, ``blunders``, ``changed``, ``machine``,
  ``before``, ``after``, ``readings``, ``values``;
- of a check: ``changes``; of a machine: ``forward``, ``inverse``, ``values``, ``spec``.
"""

from __future__ import annotations

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
    """Return the keys of ``result.json``; each cause has its credible ``set`` besides, and data
    faults have ``rows`` of the readings and no lines of their file.
    """
    result = verdict.as_dict("")
    for cause in result["effects"]:
        cause["set"] = [cause, *cause["same"], *cause["rivals"]]
    for fault in result["blunders"]:
        fault["rows"] = [row for _, row in fault["rows_in_request"]]
    return result


_VARIANT = re.compile(r"(@.*|-line)$")


def place_name(name: str) -> str:
    """Return the name of a place without that of a variant, such as ``rail.z.y/travel``."""
    return _VARIANT.sub("", name)


def said(result: Mapping[str, Any]) -> dict[str, list[dict[str, Any]]]:
    """Return causes with their credible sets, and classes of places, ready for JSON."""
    effects = [
        {
            "name": e["name"],
            "family": e["name"].partition(".")[0],
            "members": [[m["name"], m["parameters"], m["probability"]] for m in e["set"]],
        }
        for e in result["effects"]
    ]
    located = [
        {
            "places": [place_name(p["name"]) for p in found["class"]],
            "resembling": found["resembling"],
            "probability": found["class_probability"],
        }
        for found in result["located"]
    ]
    return {"effects": effects, "located": located}


def tcp_of(result: Mapping[str, Any]) -> Result:
    """Return TCP errors after the best translation, mean and largest, and the mean that is stated
    of compensated commands, millimetres.
    """
    errors, stated = result["tcp"]["translation"], result["tool"]["compensated"]["shape_mm"]
    figures = {state: [errors[f"{state}_{k}_mm"] for k in ("mean", "max")]
               for state in ("nominal", "before", "after")}  # fmt: skip
    return {**figures, "inside": errors["inside_95"], "stated": stated}


def parameters_of(result: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """Return value and sigma of the identified parameters, SI."""
    return {n: (p["value"] * unit_of(n), p["sigma"] * unit_of(n))
            for n, p in result["parameters"].items()}  # fmt: skip


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


def base_of(result: Mapping[str, Any], families: Collection[str]) -> dict[str, float]:
    """Return the machine's parameters of the base model, SI: those of the families given."""
    values = result["before"]["values_si"]
    return {n: v for n, v in values.items()
            if n.partition(".")[0] in families and not n.startswith("plate")}  # fmt: skip


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


def warned_of_noise(result: Mapping[str, Any]) -> bool:
    """Whether a warning says that the readings are far noisier than is usual."""
    return any(note["kind"] == "loud" for note in result["notes"])


def unseen_of(result: Mapping[str, Any]) -> list[str]:
    """Return the effects that the readings cannot show."""
    return [*result["invisible"], *result["unseen"]["unexcited"]]


# -- without a public name -----------------------------------------------------------------------

INSIDE = (
    "orthoglide.accuracy", "orthoglide.cli", "orthoglide.closing.validation",
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
    The shape of the plate that the verdict found is that of both lists: they are of one bed.
    """
    from orthoglide.closing.validation import held_out_rms

    def off(values: Mapping[str, float], readings: og.Readings) -> float:
        return held_out_rms(values, machine, [readings]).length * 1e3

    base = {**machine.values, **og.identify([used], machine).values}
    same_bed = _less_shape(verdict, machine, other)
    return off({}, other), off(base, other), off(verdict.values, same_bed)


def _less_shape(verdict: og.Verdict, machine: og.Machine, other: og.Readings) -> og.Readings:
    """Return readings less what the plate's shape, as a verdict found it, adds to them."""
    shape = {}
    for name, value in verdict.after.values.items():
        effect, _, rest = name.partition(".")
        if machine.catalogue[effect].of_body:
            direction = rest.partition(".")[2]
            for setup in other.setups:
                if setup.kind == "plate":
                    shape[".".join(filter(None, (effect, setup.name, direction)))] = value
    flat, shaped = (
        og.simulate(one, other, exact=True).reading
        for one in (machine, machine.with_parameters(shape))
    )
    return other.with_readings(other.reading - (shaped - flat))


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
    return np.asarray((read.measured - read.after) / read.sigma)


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
