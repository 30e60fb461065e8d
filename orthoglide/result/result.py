"""``Result``: the result of a run as plain values."""

from __future__ import annotations

import os
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, Literal, Self

from orthoglide import __version__
from orthoglide.add_ons import Corrections, Section
from orthoglide.arguments import public
from orthoglide.control import ControllerNumbers
from orthoglide.effects import Catalogue, Effect
from orthoglide.errors import FileError, as_path
from orthoglide.files import result_file
from orthoglide.frames import Framed
from orthoglide.machine import Machine
from orthoglide.machine_file import Controller
from orthoglide.notes import Note
from orthoglide.observations import Readings
from orthoglide.observations.reading import readings_of_table, rows_table
from orthoglide.parameters import effect_name
from orthoglide.result.codec import Key, Metres, decoded, encoded
from orthoglide.result.display import (
    Action,
    Picture,
    Proposal,
    ReadingsShown,
    Withheld,
    Workspace,
    advice_rows,
)
from orthoglide.result.findings import CandidateScore, Cause, Explanation, Located, Possible
from orthoglide.result.fits import (
    BudgetItem,
    Change,
    CrossCheck,
    DataFault,
    Fit,
    HoldOut,
    Identified,
    LackOfFit,
    Noise,
    Scores,
    SetupNoise,
    TcpErrors,
    Verification,
    WeakDirection,
)
from orthoglide.result.request import (
    EDITED_FILE_ERRORS,
    Request,
    edited_file_error,
    machine_of,
    read_result,
    request_of,
    stored_machine,
    version_text,
)

SCHEMA = 2

Word = Literal["adequate", "diffuse", "explained", "ambiguous", "located", "partial", "unexplained"]

_IMPROVED_RATIO = 0.95  # ratio of residuals above which a fit is reported as no improvement
_NEGLIGIBLE_RMS = 1e-6  # millimetres or milliradians: smaller residuals are rounding


@dataclass(frozen=True)
class Unseen:
    """What the readings cannot detect, with the reason."""

    # effects that could not be detected at three tolerances, as clauses, each with the parameters
    # concerned, of an effect that was found the other parameters; empty means all
    effects: tuple[tuple[str, tuple[str, ...]], ...]
    # effects for which the readings vary no condition, each with the conditions that it needs, such
    # as `approach` or `load`; empty after `identify`
    unvaried: Mapping[str, tuple[str, ...]]
    # why lost motion cannot be detected: the instruments have one side only (`fixed`), all commands
    # are approached from the `same` side, or the side is `unknown`; empty if it can be detected
    one_sided: str
    unexcited: tuple[str, ...]  # names of all effects for which no condition varies


class Judged:
    """Findings with a verdict: whether there are any, and whether they are conclusive."""

    request: Request
    word: Word
    effects: tuple[Any, ...]
    located: tuple[Any, ...]
    changed: tuple[Any, ...]
    after: Any
    machine: Any  # the calibrated `Machine`

    @property
    def catalogue(self) -> Catalogue:
        """Effects of the calibrated machine, free-form errors that were found included."""
        catalogue: Catalogue = self.machine.catalogue
        return catalogue

    @property
    def values(self) -> dict[str, float]:
        """Parameters of the calibrated machine by name, SI."""
        return dict(self.machine.values)

    @property
    def found(self) -> bool:
        """Whether a cause or a free-form error was found."""
        return bool(self.effects or self.located)

    @property
    def stands(self) -> bool:
        """Whether the causes found are conclusive.

        They are not if significant residuals remain: the error that is missing from the model may
        have been attributed to them.
        """
        return self.word not in ("partial", "unexplained")

    @property
    def moved(self) -> tuple[Any, ...]:
        """Changes that no cause reports, of the parameters that the machine had before the run: the
        size of an error that was located in it is reported with that error.
        """
        reported = {n for c in self.effects for e in (c.chosen, *c.same) for n in e.parameters}
        reported = {self.catalogue.parameter(n).plain for n in reported}
        known = self.request.machine.catalogue
        return tuple(
            c for c in self.changed
            if c.parameter not in reported and effect_name(c.parameter) in known
        )  # fmt: skip

    @property
    def scattering(self) -> tuple[str, ...]:
        """Warnings that repeats scatter by more than the declared noise."""
        return tuple(w for w in self.after.warnings if w.kind == "scatter")


@dataclass(frozen=True, eq=False, repr=False)
class Result(Judged, Framed):
    """The result of a run.

    It consists of values, which :meth:`load` reads from the ``result.json`` of a report. Two
    results are equal only if they are the same object; compare their values.

    Attributes:
        request: readings, machine and options of the run.
        machine: the calibrated machine with its covariance.
        word: the verdict: adequate, diffuse, explained, ambiguous, located, partial or
            unexplained.
        noise: noise of the readings.
        nominal: scores of the machine before calibration.
        before: fit of the base model: joint offsets and leg lengths, or what ``identify`` frees.
        after: fit at the posterior mean; after ``identify`` equal to ``before``.
        rms_of_all: root mean square residual of the base model before data faults were excluded.
        hold_out: scores on readings held out, or ``None``.
        tcp: errors at measured TCP points by alignment, or ``None``.
        effects: causes that were found.
        located: free-form errors that were found.
        alone: if nothing was found, the causes that could each explain the residuals as the only
            error of the machine.
        budget: error budget, largest gain first; empty after ``identify``.
        identified: parameters of the base model and of the causes found, by name.
        candidates: causes and free-form errors considered, most probable first.
        blunders: data faults.
        changed: parameters that differ between files.
        weak: directions in the parameters that the readings hardly determine.
        check: cross-check against the analytic reduction and the linear system (11) of the papers;
            ``None`` if these cannot represent the fit.
        verification: postures closed again by Pinocchio.
        firmware: numbers and advice for the firmware of an imported machine, or ``None``.
        next_measurements: readings to take next; empty after ``identify``.
        sheet: all proposed readings as rows of one file, commands in joint coordinates.
        left: residuals of the last fit against the noise.
        workspace: TCP errors over the workspace; ``None`` after ``identify``.
        numbers: zeros for the controller, and the TCP errors to expect.
        actions: what to do, largest gain first.
        invisible: names of parameters that the readings cannot detect; they may still be nonzero.
        unseen: what the readings cannot detect, with the reason.
        instruments: instruments used, by kind of readings.
        cautions: reasons not to act on the result, a sentence each.
        warnings: warnings of the last fit except lack of fit, which the verdict reports.
        calibrated_before: whether the machine file contains an earlier calibration.
        shapes_of_plate: whether a probed plate may have a shape that no effect describes.
        picture: drawing of the machine with the causes marked.
        readings: measured and predicted readings.
        noise_by_setup: noise that the residuals show, by setup; empty in results of earlier
            versions.
        withheld: what is not advised, with the reason.
        contradicted: how readings or points held out contradict the result, a sentence; else empty.
        possible: causes that are not certain enough to be added, each conditional on its being
            present: the most probable ones if the model does not fit and nothing was found, else
            those more probable than not.
        compared: after ``check``, what changed since the old state and what did not, in sentences.
    """

    request: Annotated[Request, Key(in_file=False)]
    machine: Machine
    word: Annotated[Word, Key("verdict")]
    noise: Annotated[Noise, Key(inline=True)]
    nominal: Scores
    before: Fit
    after: Fit
    rms_of_all: Metres
    hold_out: Annotated[HoldOut | None, Key("holdout")]
    tcp: Mapping[str, TcpErrors] | None
    effects: tuple[Cause, ...]
    located: tuple[Located, ...]
    alone: Annotated[tuple[Explanation, ...], Key("single_causes")]
    budget: tuple[BudgetItem, ...]
    identified: Annotated[Mapping[str, Identified], Key("parameters")]
    candidates: tuple[CandidateScore, ...]
    blunders: tuple[DataFault, ...]
    changed: tuple[Change, ...]
    weak: Annotated[tuple[WeakDirection, ...], Key("weak_directions")]
    check: Annotated[CrossCheck | None, Key("cross_check")]
    verification: Verification | None
    firmware: Section | None
    next_measurements: tuple[Proposal, ...]
    sheet: Annotated[tuple[Mapping[str, str], ...], Key("next_sheet")]
    left: LackOfFit
    workspace: Workspace | None
    numbers: Annotated[ControllerNumbers, Key("controller")]
    actions: tuple[Action, ...]
    invisible: tuple[str, ...]
    unseen: Unseen
    instruments: Mapping[str, str]
    cautions: tuple[str, ...]
    warnings: Annotated[tuple[Note, ...], Key("notes")]
    calibrated_before: bool
    shapes_of_plate: bool
    picture: Picture
    readings: ReadingsShown
    noise_by_setup: Annotated[tuple[SetupNoise, ...], Key("noise")] = ()
    withheld: tuple[Withheld, ...] = ()
    contradicted: str = ""
    possible: tuple[Possible, ...] = ()
    compared: tuple[str, ...] = ()
    _index = "parameter"

    @classmethod
    @public
    def load(cls, path: str | os.PathLike[str], effects: Sequence[Effect] = ()) -> Self:
        """Return the result of an earlier run.

        Args:
            path: of its ``result.json``, or the folder of its report.
            effects: the user's own effects, if the run had any.

        Raises:
            FileError: if there is no such file, or it was edited or is of an earlier version.
        """
        file, own_effects = result_file(as_path(path), "result.json"), tuple(effects or ())
        keys = read_result(file)
        request = request_of(keys, str(file), own_effects)
        try:
            stored = {"file": None, "sha256": None, **keys["calibrated_machine"]}
            return cls.read(keys, request, machine_of(stored, own_effects))
        except KeyError as error:
            raise FileError(
                f"lacks {error.args[0]}: an earlier state of the package, {version_text(keys)}, "
                f"wrote it, or it was edited; take the original, or run it again with orthoglide "
                f"rerun {shlex.quote(str(file))} --out DIR",
                file=str(file),
            ) from None
        except EDITED_FILE_ERRORS as error:
            raise edited_file_error(error, str(file)) from None

    @classmethod
    def read(cls, keys: Mapping[str, Any], request: Request, machine: Machine) -> Self:
        """Return a result from decoded JSON.

        Args:
            keys: keys of ``result.json``.
            request: readings, machine and options of the run.
            machine: the calibrated machine.

        Raises:
            KeyError, TypeError, ValueError: if the keys are not as they were written.
        """
        names = machine.geometry.layout.names
        shared = [request, machine, machine.catalogue, machine.geometry, names]
        result: Self = decoded(cls, keys, {type(one): one for one in shared})
        return result

    def as_dict(self, summary: str) -> dict[str, Any]:
        """Return all keys of ``result.json``; ``summary`` is the result in a few sentences."""
        head = {"schema": SCHEMA, "version": __version__, **self.request.as_dict()}
        machine = {"calibrated_machine": stored_machine(self.machine.spec)}
        values: dict[str, Any] = encoded(self)
        return head | {"summary": summary} | values | machine

    def derived(self) -> dict[str, Any]:
        """Return keys of ``result.json`` that follow from the fields."""
        values = {}
        for name, entry in self.machine.spec.parameters.items():
            unit, number = self.catalogue.effect_of(name).unit, Key().number
            value, sigma = number(entry.value / unit.si), number(entry.sigma / unit.si)
            values[name] = {"value": value, "sigma": sigma, "unit": unit.name}
        return {
            "sigma_scale": Key().number(self.after.sigma_scale),
            "calibrated": values,
            "tool": {name: expected.as_dict() for name, expected in self.numbers.expected.items()},
            "advice": advice_rows(self.actions),
            "method": {
                "name": self.after.method,
                "iterations": self.after.iterations,
                "last_step_in_sigmas": Key(digits=3).number(self.after.optimality),
            },
            "warnings": [*self.cautions, *map(str, self.after.warnings)],
        }

    def __repr__(self) -> str:
        causes = ", ".join(e.name for e in self.effects) or "no cause"
        return f"<{type(self).__name__} {self.word}: {causes}; {self.request.command}>"

    @property
    def searches(self) -> bool:
        """Whether the run searched for causes; ``identify`` does not."""
        return self.request.searches

    @property
    def further_cautions(self) -> tuple[str, ...]:
        """Cautions without `contradicted`, which the headline begins with."""
        return tuple(c for c in self.cautions if c != self.contradicted)

    @property
    def improved(self) -> bool:
        """Whether a cause was found, or the full model reduces the residuals by 5 % or more."""
        before, after = (fit.scores.left.shown for fit in (self.before, self.after))
        return self.found or any(
            after[unit] < _IMPROVED_RATIO * was and was > _NEGLIGIBLE_RMS
            for unit, was in before.items()
        )

    @property
    def start(self) -> Scores:
        """Scores that reports compare the last fit with: of the base model if a search `improved`
        it, else of the machine before calibration.
        """
        return self.before.scores if self.improved and self.searches else self.nominal

    @property
    def loses(self) -> bool:
        """Whether anything found may be lost motion, which the expected TCP errors exclude."""
        findings = (self.effects, self.located, self.moved)
        return any(finding.loses for group in findings for finding in group)

    @property
    def corrections(self) -> Corrections | None:
        """New numbers for the firmware of an imported machine, or ``None``."""
        return None if self.firmware is None else self.firmware.corrections

    @property
    def columns(self) -> dict[str, list[Any]]:
        """Identified parameters in the units of files, a row each.

        ``sigma`` and the 95 % interval from ``lower`` to ``upper`` are those of the full model;
        after ``identify`` they count the noise alone.
        """
        rows = [
            (name, one.value, one.sigma, *one.interval_95, one.tolerance, one.unit)
            for name, one in self.identified.items()
        ]
        titles = ("parameter", "value", "sigma", "lower", "upper", "tolerance", "unit")
        return dict(zip(titles, map(list, zip(*rows, strict=True)), strict=True))

    @cached_property
    def next_sheet(self) -> Readings | None:
        """All proposed readings as one sheet to fill in; ``None`` if there are none."""
        return sheet_of(self.sheet, self.request.machine) if self.sheet else None


def sheet_of(rows: Sequence[Mapping[str, str]], machine: Machine) -> Readings:
    """Return the rows of a sheet, commands in joint coordinates, as readings to be taken."""
    spec = replace(machine.spec, controller=Controller())
    table = rows_table(rows, "next_measurements.csv")
    return readings_of_table(table, "next", spec, require_readings=False)
