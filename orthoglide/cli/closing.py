"""``identify``, ``close-loop``, ``diagnose`` and ``demo``: from readings to values and causes."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import orthoglide.cli.options as opt
from orthoglide.cli.running import execute, performed, read_request

if TYPE_CHECKING:
    from orthoglide.result import Request

DEMO_FOLDER = "orthoglide-demo"
DEMO_CAMPAIGN, DEMO_SECOND = "experiment2.csv", "experiment3.csv"
DEMO_MACHINE = "made-up.toml"


judge_options = opt.together(
    click.option("--holdout", type=opt.PATH, metavar="FILE",
                 help="Readings that only judges the finished result."),
    click.option("--tcp", type=opt.PATH, metavar="FILE",
                 help="Measured TCP points that only judge the finished result."),
)  # fmt: skip


@click.command()
@click.argument("campaigns", nargs=-1, type=opt.PATH)
@opt.out()
@click.option("--free", type=opt.Names(), default=(), metavar="NAME,...",
              help="Effects or parameters to identify.  [default: zeros and bar lengths]",
              )  # fmt: skip
@click.option("--no-priors", is_flag=True, help="Do not use the tolerances as priors.")
@opt.fit_options
@click.option("--reduced", is_flag=True, help="Identify with the analytic reduction.")
@opt.run_options
def identify(**options: Any) -> None:
    """Identify joint offsets and leg lengths (or more) from campaigns of dial readings."""
    execute("identify", **options)


@click.command("close-loop")
@click.argument("campaigns", nargs=-1, type=opt.PATH)
@opt.out()
@judge_options
@opt.fit_options
@opt.run_options
def close_loop(**options: Any) -> None:
    """Calibrate, trace what is left beyond the noise to a cause, and write the report."""
    execute("close-loop", **options)


@click.command()
@click.argument("campaigns", nargs=-1, type=opt.PATH)
@opt.out_or_nothing
@judge_options
@opt.fit_options
@opt.run_options
def diagnose(**options: Any) -> None:
    """Print the verdict of close-loop and the ranked causes; write nothing without --out."""
    execute("diagnose", **options)


@click.command()
@opt.out(required=False, help=f"Folder for the results.  [default: {DEMO_FOLDER}]")
@opt.run_options
def demo(out: Path | None, seed: int, quiet: bool, as_json: bool) -> None:
    """Close the loop on the published Orthoglide (2008), and on a machine with a known fault.

    The first machine is that of the papers, from its authors' own readings: what offsets and
    lengths leave, the effects that may be behind it, the error before and after each is added, and
    what would tell which it is. The second is made up, so that its fault is known: its dials are
    simulated over a whole sweep, and the fault is found.
    """
    import json

    from orthoglide.cli.progress import progress
    from orthoglide.cli.terminal import say
    from orthoglide.cli.writing import next_free, write_results
    from orthoglide.report.folder import check_folder
    from orthoglide.report.rows import if_it_were_so
    from orthoglide.text import sentence

    folder = check_folder(out or next_free(Path(DEMO_FOLDER)))
    files: dict[str, str | bytes] = {}
    told, results = [], {}
    with ExitStack() as stack:
        for name, (intro, read) in _demo_runs(stack, seed, files).items():
            with progress(quiet or as_json) as step:
                result, report = performed(read, step)
            files |= {f"{name}/{file}": content for file, content in report.items()}
            results[name] = json.loads(report["result.json"])
            path = click.format_filename((out or Path(folder.name)) / name / "report.html")
            lines = [intro, f"Verdict {result.word}: {results[name]['summary']}"]
            lines += [f"If it were so: {text}" for text in if_it_were_so(result)]
            lines += [f"What to do: {sentence(one.words)}" for one in result.actions[:1]]
            told.append("\n".join((*lines, f"Report: {path}")))
        write_results(folder, files)
    if as_json:
        say(json.dumps(results, indent=1, ensure_ascii=False), needed=False)
    elif not quiet:
        say("\n\n".join(told), needed=False)


def _demo_runs(
    stack: ExitStack, seed: int, files: dict[str, str | bytes]
) -> dict[str, tuple[str, Callable[[], Request]]]:
    """What each run of the demo is, and its request; what the first starts from goes to files."""
    from importlib.resources import as_file, files as packaged
    from tempfile import TemporaryDirectory

    from orthoglide.effects.wording import cause_words
    from orthoglide.machine import Machine
    from orthoglide.observations import campaign_text
    from orthoglide.simulation import simulate

    names = (DEMO_MACHINE, DEMO_CAMPAIGN, DEMO_SECOND)
    data = packaged("orthoglide") / "data"
    made, first, held = (stack.enter_context(as_file(data / name)) for name in names)
    worn = Machine.load(made)
    base = worn.catalogue.base
    (fault,) = (n for n in worn.values if worn.catalogue.effect_of(n).name not in base)
    hidden = cause_words(worn.catalogue, fault, worn.values)
    campaign = simulate(worn, "sweep", seed=seed)
    sheet = Path(stack.enter_context(TemporaryDirectory())) / "simulated.csv"
    sheet.write_text(campaign_text(campaign, worn.spec), encoding="utf-8")
    files |= {sheet.name: sheet.read_text("utf-8"), DEMO_MACHINE: made.read_text("utf-8")}
    return {
        "published": (
            "1. The machine of the papers, from the 24 averages that its authors published: "
            "Experiments 2 and 3, between which new offsets were set.",
            lambda: read_request(
                "demo", (first, held), own=worn.catalogue.held_as("zero"), seed=seed
            ),
        ),
        "simulated": (
            f"2. A machine made up, so that its fault is known: {hidden}. {len(campaign)} readings "
            f"of a whole sweep were simulated and nothing else was told.",
            lambda: read_request("close-loop", (sheet,), seed=seed),
        ),
    }
