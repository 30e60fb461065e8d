"""Which readings to take and taking them: ``protocol``, ``design``, ``measure`` and others."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

import orthoglide.cli.options as opt
from orthoglide.cli.app import cli, deliver, progress, warn
from orthoglide.errors import FileError, InputError
from orthoglide.progress import Step
from orthoglide.text import printable_path, wrapped

if TYPE_CHECKING:
    from orthoglide.machine import Machine
    from orthoglide.observations import Readings
    from orthoglide.planning.detectable import Detectability

_kind_option = click.option(
    "--kind", type=click.Choice(opt.PROTOCOLS), default="standard", show_default=True,
    help="standard: Zero, Max and Min; sweep: the stroke in steps, both ways; two-gauges: a sweep "
         "at two places of a leg; parallelism: the difference of two dials on a leg at Zero, Max "
         "and Min.",
)  # fmt: skip
_OTHER_SHEETS = (
    "design --owns says what its instruments tell, and rehearse --sheet how often it would find "
    "what is wrong"
)
_INSTRUMENT_KINDS = ("leg (dials), parallelism, tcp, plate, distance, ballbar, incline", "KIND,...")


def _dial_sheet(path: Path, machine: Machine, remedy: str) -> Readings:
    """Return a measuring sheet of single dials on legs, filled in or not; if it has other readings,
    an error says what to do with them.
    """
    from orthoglide.observations import read_readings

    sheet = read_readings(path, machine.spec, require_readings=False)[-1]
    if other_kinds := dict.fromkeys(s.kind for s in sheet.setups if s.observation.dials != 1):
        contents = "readings at the tool" if sheet.of_tool else "readings of two dials at a time"
        raise FileError(f"holds {contents} ({', '.join(other_kinds)}): {remedy}", file=path)
    return sheet


def _sheet_files(
    path: Path, sheet: Readings, machine: Machine
) -> tuple[dict[Path, str], tuple[str, ...]]:
    """Return a measuring sheet and its page to print, by path, and a line on each."""
    from orthoglide.observations import campaign_text
    from orthoglide.report.sheet import sheet_page

    page = path.with_suffix(".html")
    page = page if page != path else path.with_name(f"{path.name}.html")
    page_text = sheet_page(sheet, machine, printable_path(path.name))
    return {path: campaign_text(sheet, machine.spec), page: page_text}, (
        f"{click.format_filename(path)}: {len(sheet)} readings in {len(sheet.setups)} setups, to "
        f"be filled in as reading_mm; {len(sheet.moves)} rows are moves: go there, read nothing",
        f"{click.format_filename(page)}: the same rows to print and carry to the machine",
    )


@cli.command()
@_kind_option
@opt.machine()
@opt.out("File to write, with a page to print beside it; else rows are printed.", "SHEET.csv")
def protocol(kind: str, machine: opt.MachineOption, out: Path | None) -> None:
    """Write a measuring sheet: every row but the reading, and the same rows as a page to print.

    \b
    Example:
      orthoglide protocol --kind sweep --machine machine.toml --out sheet.csv
    """
    from orthoglide.observations import campaign_text, protocol as make

    robot = machine.load()
    sheet = make(kind, robot.geometry)  # type: ignore[arg-type]
    if out is None:
        click.echo(campaign_text(sheet, robot.spec), nl=False)
        return
    files, sheet_lines = _sheet_files(out, sheet, robot)
    deliver("\n".join(sheet_lines), files)


@cli.command()
@opt.machine(required=True)
@opt.pairs("--error", "More errors of the machine, in the units of files.", "NAME=NUMBER,...")
@opt.out("Readings to write; else they are printed.", "CSV")
@_kind_option
@opt.file("--sheet", "Rows to be read in place of a protocol's; of any instruments.", "SHEET.csv")
@opt.seed
@opt.noise(minimum=0.0)
@click.option("--exact", is_flag=True,
              help="No noise, no rounding, dials exactly in place, datums zero.")  # fmt: skip
@opt.file("--tcp", "Also write 60 exact TCP points, to judge by.", "TCP.csv")
def simulate(
    machine: opt.MachineOption, error: opt.Pairs, out: Path | None, kind: str, sheet: Path | None,
    seed: int, noise: float | None, exact: bool, tcp: Path | None,
) -> None:  # fmt: skip
    """Simulate a campaign: the readings of a machine with known errors.

    Each dial has a datum and stands off its place by a placement error, each instrument at the
    tool has a datum and a frame; readings are noisy and rounded to their resolution.

    \b
    Example:
      orthoglide simulate --machine bent.toml --kind sweep --seed 1 --out bent.csv
    """
    import numpy as np

    from orthoglide import simulation
    from orthoglide.observations import campaign_text, protocol, read_campaign

    opt.exclude("sheet", "kind", because="a sheet has rows of its own")
    opt.exclude("exact", "noise", because="exact readings have none")
    if tcp is not None and out is not None and tcp.resolve() == out.resolve():
        raise InputError(f"--out and --tcp are both {str(tcp)!r}: give each a name of its own")
    robot = machine.load()
    errors = opt.values_in_si("--error", error, robot.catalogue)
    faulty_robot, rng = robot.with_parameters(errors), np.random.default_rng(seed)
    unread = (
        protocol(kind, faulty_robot.geometry)  # type: ignore[arg-type]
        if sheet is None
        else read_campaign(sheet, faulty_robot.spec, require_readings=False)
    )
    robot.catalogue.expand(errors, [setup.name for setup in unread.setups])
    campaign = simulation.simulate(faulty_robot, unread, noise=noise, seed=rng, exact=exact)
    text = campaign_text(campaign, None if faulty_robot.geometry.dialled else faulty_robot.spec)
    files = {} if out is None else {out: text}
    if tcp is not None:
        points = simulation.simulate_tcp(faulty_robot, seed=rng)
        points = points.with_readings(np.round(points.reading, 9))
        files[tcp] = campaign_text(points, faulty_robot.spec)
    invisible = simulation.invisible_parameters(faulty_robot, campaign).items()
    counts = [f"{click.format_filename(p)}: {t.count(chr(10)) - 1} rows" for p, t in files.items()]
    deliver(text.rstrip("\n") if out is None else "\n".join(counts), files)
    warn(tuple(f"{name} changes no reading, as {reason}" for name, reason in invisible))


@cli.command()
@opt.file("--out", "Readings to write, or to go on with.", "CAMPAIGN.csv", required=True)
@opt.machine()
@opt.file("--sheet", "Measuring sheet to read first; its own if absent.", "SHEET.csv")
@click.option("--most", "max_readings", type=click.IntRange(2),
              help="Readings after which no more are asked for.  [default: 126, or all of --sheet]"
              )  # fmt: skip
def measure(
    out: Path, machine: opt.MachineOption, sheet: Path | None, max_readings: int | None
) -> None:
    """Ask for one reading after another at the machine, until the verdict is settled.

    Says where each dial stands and where to go, takes what is typed or sent to its standard input
    (12.34, 12,34, 340 um; skip, undo, quit, ?), asks for an impossible reading again, and goes on
    with the readings that the verdict suggests. Every reading is on the disk before the next
    question; the same command goes on where it was.

    The verdict is settled when no significant lack of fit is left and no suggested readings would
    separate two explanations by two standard deviations; that nothing is wrong is accepted only
    after 90 readings.

    \b
    Examples:
      orthoglide measure --machine machine.toml --out april.csv
      orthoglide measure --sheet sheet.csv --out april.csv
    """
    from orthoglide.measuring import Record, Session
    from orthoglide.report import summary

    robot, name = machine.load(), click.format_filename(out)
    remedy = "measure asks for dials on legs; fill it in and give it to close-loop"
    first_sheet = None if sheet is None else _dial_sheet(sheet, robot, remedy)
    record = Record(out, robot.spec)
    session = Session(robot, record, _ask, deliver, sheet=first_sheet, max_readings=max_readings)
    if (outcome := session.run()) is None:
        count = f"{record.readings} reading" + "s" * (record.readings != 1)
        deliver(f"Stopped with {count} in {name}: the same command goes on from there.")
        return
    folder = Path(out.stem)
    summary_text = summary(
        outcome.verdict, omitted_kind="machine",
        with_paths=lambda text: machine.with_typed_paths(text, folder),
    )  # fmt: skip
    deliver(
        f"{'Settled' if outcome.settled else 'Not settled'} after {outcome.readings} readings: "
        f"{outcome.reason}.\n\n{summary_text}\n\nThe report: orthoglide close-loop "
        f"{opt.shell_path(out)}{machine.words} --out {opt.shell_path(folder)}"
    )


def _ask(question: str) -> str:
    """Print a question, and return the answer that is typed or the next line of standard input."""
    if sys.stdin.isatty():
        return input(question)
    click.echo(question)
    if not (answer := sys.stdin.readline()):
        raise EOFError
    return answer


@cli.command()
@click.argument("sheets", nargs=-1, type=opt.PATH, metavar="[SHEET.csv ...]")
@opt.machine()
@opt.out("Measuring sheet to write; for dials with a page to print.", "SHEET.csv")
@opt.names("--free", "Effects or parameters to identify.  [default: joint offsets and leg lengths]")
@click.option("--count", default=24, show_default=True, help="Readings to choose.")
@opt.pairs("--want", "Wanted accuracies, in the units of files, such as TCP=0.01: prints how often "
           "to repeat.", "NAME=SIGMA,...")  # fmt: skip
@opt.names("--owns", f"Instruments that you have ({_INSTRUMENT_KINDS[0]}): prints "
           "which effects they find and name together, and with --out writes a sheet.",
           _INSTRUMENT_KINDS[1])  # fmt: skip
@opt.flag("--detect", "Also print the smallest effects found and named.")
@opt.noise()
@opt.seed
@opt.quiet
def design(
    sheets: tuple[Path, ...], machine: opt.MachineOption, out: Path | None, free: tuple[str, ...],
    count: int, want: opt.Pairs, owns: tuple[str, ...], detect: bool, noise: float | None,
    seed: int, quiet: bool,
) -> None:  # fmt: skip
    """Choose readings before any is taken, and compare protocols and sheets by what they see.

    \b
    Examples:
      orthoglide design --machine machine.toml --count 24 --out sheet.csv
      orthoglide design sheet.csv --want TCP=0.02 --detect
      orthoglide design --owns plate,distance --machine machine.toml --out sheet.csv
    """
    from orthoglide import planning
    from orthoglide.observations import protocol

    opt.exclude(
        "owns", "sheets", "free", "count", "want", "detect", "noise",
        because="every instrument has a sheet and a noise of its own, and its smallest effects "
        "are printed anyway",
    )  # fmt: skip
    robot = machine.load()
    if owns:
        _design_for_instruments(owns, robot, out, seed, quiet)
        return
    target_sigmas = opt.values_in_si("--want", want, robot.catalogue)
    with progress(quiet) as step:
        step(Step("computing", "choosing readings"))
        chosen = planning.design(robot, free or None, count, noise=noise)
        step(Step("computing", "comparing"))
        compared = {s.name: s for s in (_dial_sheet(path, robot, _OTHER_SHEETS) for path in sheets)}
        if not sheets:
            geometry = robot.geometry
            compared = {k: protocol(k, geometry) for k in opt.DIAL_PROTOCOLS}  # type: ignore[arg-type]
        rows = [(name, planning.observability(robot, sheet, chosen.names, noise))
                for name, sheet in compared.items()]  # fmt: skip
        lines = [planning.index_table([*rows, ("design", chosen.indices)])]
        compared["design"] = chosen.campaign
        short, found_from = list[str](), list[str]()  # parts of the answer in one line
        for name, sheet in compared.items():
            step(Step("computing", f"what {name} sees"))
            lines += [f"{name}: {warning}" for warning in planning.aliasing(robot, sheet)]
            for what, sigma in target_sigmas.items():
                repeats = planning.repeats_needed(robot, sheet, chosen.names, what, sigma, noise)
                lines.append(f"{name}, {repeats}")
                short += [lines[-1]] * (bool(sheets) or name == "design")
            if detect:
                smallest = planning.smallest_effects(robot, sheet, noise=noise, seed=seed)
                found_from += ["", f"{name}:", *planning.detectable_rows(smallest)]
                short += [f"{name}, {_seen(smallest)}"] * (bool(sheets) or name == "design")
        lines += found_from
        files, sheet_lines = ({}, ()) if out is None else _sheet_files(out, chosen.campaign, robot)
    line = (
        f"{len(chosen.campaign)} readings show {chosen.indices.rank} of "
        f"{'; '.join((f'{chosen.indices.unknowns} unknowns', *short))}."
    )
    deliver(line if quiet else wrapped("\n".join([*lines, *sheet_lines])), files)


def _design_for_instruments(
    owns: tuple[str, ...], machine: Machine, out: Path | None, seed: int, quiet: bool
) -> None:
    """Print the smallest effects that instruments detect, and write their sheet at the tool."""
    from orthoglide import planning
    from orthoglide.observations import campaign_text

    with progress(quiet) as step:
        step(Step("computing", "what the instruments would tell"))
        owned_sheets = planning.sheets_by_kind(machine, owns)
        smallest = planning.smallest_effects(machine, list(owned_sheets.values()), seed=seed)
    instruments = ", ".join(
        f"{s.setups[0].observation.instrument_phrase} ({len(s)})" for s in owned_sheets.values()
    )
    lines = [f"with {instruments}:", *planning.detectable_rows(smallest)]
    files = dict[Path, str]()
    if out is not None:
        by_place = machine.spec.kinematics is not None
        if not (sheets := [s for s in owned_sheets.values() if s.of_tool]):
            raise InputError("orthoglide protocol writes the sheets of dials alone")
        files[out] = campaign_text(sheets, machine.spec, commands_as_places=True)
        moves = sum(len(sheet.moves) for sheet in sheets)
        between = f"; rows of kind move ({moves}): go there, read nothing" if moves else ""
        lines += ["", f"{click.format_filename(out)}: {sum(map(len, sheets))} readings of the "
                      f"tool, to be filled in{between}"]  # fmt: skip
        if by_place:
            lines.append("Send the tool to x_mm, y_mm, z_mm, with its numbers as they are.")
        for observation in (sheet.setups[0].observation for sheet in sheets):
            instruction = by_place and observation.sheet_instruction_place
            lines.append(
                f"{observation.instrument_phrase}: {instruction or observation.sheet_instruction}."
            )
    deliver(f"{_seen(smallest)}." if quiet else wrapped("\n".join(lines)), files)


def _seen(smallest: Detectability) -> str:
    """Return how many effects are detected, a clause."""
    effects, hidden = len(smallest.by_effect), len(smallest.invisible)
    return f"{effects} effects are seen, {hidden} parameters are not visible"


@cli.command()
@opt.machine()
@opt.file("--sheet", "Measuring sheet; the protocol sweep if absent, or a probe on a plate where "
          "no dial stands on a leg.", "SHEET.csv")  # fmt: skip
@opt.names("--owns", f"In place of a sheet, readings you can take: {_INSTRUMENT_KINDS[0]}.",
           _INSTRUMENT_KINDS[1])  # fmt: skip
@click.option("--campaigns", type=click.IntRange(1), default=90, show_default=True,
              help="How many to simulate.")  # fmt: skip
@opt.seed
@click.option("--jobs", type=int, default=-1, metavar="N",
              help="Processes side by side.  [default: one for every processor]")  # fmt: skip
@opt.file("--out", "Folder for finished campaigns and the table; a run that was stopped goes on "
          "from there.", "DIR")  # fmt: skip
@opt.quiet
def rehearse(
    machine: opt.MachineOption, sheet: Path | None, owns: tuple[str, ...], campaigns: int,
    seed: int, jobs: int, out: Path | None, quiet: bool,
) -> None:  # fmt: skip
    """Simulate campaigns on machines like yours, and count what your sheet would find.

    Machines are drawn by the dimensions and tolerances of the machine file: with nothing wrong but
    zeros and lengths, with one effect at 3 to 10 tolerances, with something that no catalogue
    knows, and with everything off by a share f of its tolerance.

    \b
    Examples:
      orthoglide rehearse --machine machine.toml --sheet sheet.csv --out rehearsal
      orthoglide rehearse --owns plate,incline --campaigns 900
    """
    from orthoglide.rehearsal import rehearse as run

    opt.exclude("owns", "sheet", because="each instrument has a sheet of its own")
    robot = machine.read()
    opt.warn_of(robot, covariance=False)  # its parameters do not count
    with progress(quiet) as step:
        rehearsal = run(
            robot, sheet, campaigns, owns=owns, seed=seed, out=out, progress=step, jobs=jobs
        )
    deliver(rehearsal.line if quiet else str(rehearsal))
