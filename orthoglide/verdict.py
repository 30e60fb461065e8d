"""``Verdict``: a result with a report and figures, and the functions that compute one."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from orthoglide.arguments import public
from orthoglide.effects import Effect
from orthoglide.errors import as_path, check_list
from orthoglide.fit import points_of, read_tables, readings_of
from orthoglide.frames import html_table
from orthoglide.instruments import Frame
from orthoglide.machine import Machine, MachineSource
from orthoglide.observations import Readings, ReadingsOrPath
from orthoglide.progress import Progress, no_progress
from orthoglide.result import Command, Request, Result
from orthoglide.threads import on_one_thread

if TYPE_CHECKING:
    from orthoglide.figures.style import Drawing


@public
class Verdict(Result):
    """A result that writes its report and draws its figures; returned by :func:`close_loop`."""

    @on_one_thread
    def report(self, folder: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write the report into a folder, as the command line does.

        Args:
            folder: the folder; new or empty.
            overwrite: whether an earlier report there is replaced.

        Raises:
            FileError: if the folder is not empty and not replaced, or cannot be written.
        """
        from orthoglide.report import report_files, write_folder
        from orthoglide.report.folder import check_folder

        out = as_path(folder)
        check_folder(out, overwrite)
        write_folder(out, report_files(self), overwrite)

    @on_one_thread
    def plot(self, what: str = "residuals") -> Drawing:
        """Return a figure of the report, which notebooks show and ``save`` writes.

        Args:
            what: ``"residuals"`` or ``"readings"`` by setup, or the errors of the tool over the
                ``"workspace"``, which ``identify`` does not compute.

        Raises:
            InputError: if this result has no such figure.
        """
        from orthoglide.figures.draw import draw_one

        return draw_one(self, what)

    def rerun(self, progress: Progress | None = None) -> Verdict:
        """Run it again from the readings in the result.

        Args:
            progress: callable that receives each step.

        Raises:
            NumericsError: if the base model cannot be identified.
        """
        return run(self.request, progress)

    @on_one_thread
    def __str__(self) -> str:
        from orthoglide.report import summary

        return summary(self)

    @on_one_thread
    def _repr_html_(self) -> str:
        from orthoglide.report.sentences import headline

        table = html_table(headline(self), self.columns)
        return f'<div style="max-width: 30rem">{self.picture.svg()}</div>{table}'


@public
def close_loop(
    campaigns: ReadingsOrPath | Sequence[ReadingsOrPath],
    machine: MachineSource | None = None,
    *,
    own: Sequence[str] = (),
    noise: float | None = None,
    holdout: ReadingsOrPath | Sequence[ReadingsOrPath] | None = None,
    tcp: Readings | str | os.PathLike[str] | None = None,
    effects: Sequence[Effect] = (),
    seed: int = 0,
    progress: Progress | None = None,
    frame: Frame = "rigid",
) -> Verdict:
    """Calibrate a machine, test for lack of fit, and identify the causes of the residual.

    Args:
        campaigns: one or several campaigns of dial readings or TCP points; paths are read as by
            ``read_readings``.
        machine: dimensions, tolerances and dial, or the path of a machine file; by default nominal.
        own: effects or parameters that are specific to each campaign; all others are shared.
        noise: standard deviation of one reading, metres.
        holdout: readings that are not fitted and only judge the result.
        tcp: measured points that are not fitted and only judge the result, or the path of their
            file.
        effects: the user's own effects, in addition to those of the machine's catalogue.
        seed: seed of every random draw; equal seeds give equal results.
        progress: callable that receives each step.
        frame: motion allowed between the instrument of TCP points and the machine.

    Raises:
        InputError: if the campaigns cannot be used.
        NumericsError: if the base model cannot be identified.
    """
    request = build_request(
        campaigns, machine, own=own, noise=noise, holdout=holdout, tcp=tcp, effects=effects,
        seed=seed, frame=frame,
    )  # fmt: skip
    return run(request, progress)


def build_request(
    campaigns: ReadingsOrPath | Sequence[ReadingsOrPath],
    machine: MachineSource | None = None,
    *,
    own: Sequence[str] = (),
    holdout: ReadingsOrPath | Sequence[ReadingsOrPath] | None = None,
    tcp: Readings | str | os.PathLike[str] | None = None,
    effects: Sequence[Effect] = (),
    command: Command = "close-loop",
    **options: Any,
) -> Request:
    """Return the request that :func:`close_loop` runs for equal arguments; ``options`` are further
    fields of `Request`.

    Raises:
        InputError: if the campaigns cannot be used.
    """
    machine = Machine.of(machine, effects)
    check_list("own", own)
    return Request(
        command,
        tuple(read_tables(campaigns, machine)),
        machine,
        tuple(own),
        tcp=None if tcp is None else points_of(tcp, machine),
        holdout=() if holdout is None else readings_of(holdout, machine),
        **options,
    )


def run(request: Request, progress: Progress | None = None) -> Verdict:
    """Run a request and return its result.

    Raises:
        InputError: if the campaigns cannot be used.
        NumericsError: if the base model cannot be identified.
    """
    from orthoglide.closing import build_result, compute_outcome

    step = progress or no_progress
    return build_result(compute_outcome(request, step), Verdict, step)
