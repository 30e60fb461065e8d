"""``identify``: from readings to a folder of results."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import orthoglide.cli.options as opt
from orthoglide.cli.running import execute, read_request

if TYPE_CHECKING:
    from orthoglide.request import Request


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
def identify(
    campaigns: tuple[Path, ...],
    out: Path,
    free: tuple[str, ...],
    no_priors: bool,
    reduced: bool,
    quiet: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Identify joint offsets and leg lengths (or more) from campaigns of dial readings."""

    def read() -> Request:
        from dataclasses import replace

        asked = read_request("identify", campaigns, **options)
        return replace(asked, free=free or asked.free, priors=not no_priors, reduced=reduced)

    execute(read, out, quiet=quiet, as_json=as_json)
