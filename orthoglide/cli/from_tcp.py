"""``identify --fit-tcp``: parameters from measured TCP points instead of dial readings."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from orthoglide.cli.options import load_machine, noise_metres
from orthoglide.cli.progress import progress
from orthoglide.cli.writing import write_results
from orthoglide.progress import Step

if TYPE_CHECKING:
    from orthoglide.fit.from_tcp import Frame, TcpEstimate
    from orthoglide.observations import TcpPoints

FRAMES = ("rigid", "translation", "none")


def run_fit_tcp(
    path: Path,
    out: Path,
    free: Sequence[str],
    machine_path: Path | None,
    *,
    frame: Frame,
    priors: bool,
    noise_mm: float | None,
    quiet: bool,
    as_json: bool,
) -> None:
    """Read the points, identify, write the folder and say what was found."""
    from orthoglide.effects import BASE_FAMILIES
    from orthoglide.observations import read_tcp
    from orthoglide.report.folder import check_folder

    noise = noise_metres(noise_mm)
    check_folder(out)
    with progress(quiet or as_json) as step:
        step(Step("reading"))
        machine = load_machine(machine_path)
        points = read_tcp(path, machine.spec)
        step(Step("identifying", f"from {len(points)} TCP points"))
        from orthoglide.fit.from_tcp import identify_tcp

        estimate = identify_tcp(
            points,
            machine,
            free or BASE_FAMILIES,
            frame=frame,
            priors=priors,
            sigma=noise,
        )
        files = _files(estimate, points, path, frame, priors)
        write_results(out, files)
    if as_json:
        click.echo(files["result.json"], nl=False)
    elif not quiet:
        click.echo(_summary(estimate))
        click.echo(f"\nResults: {click.format_filename(out)}")


def _summary(estimate: TcpEstimate) -> str:
    from orthoglide.fit.from_tcp import table

    lines = [
        f"The points lie {estimate.before * 1e3:.4f} mm rms from the machine as it was, "
        f"{estimate.after * 1e3:.4f} mm from the calibrated one."
    ]
    lines += [
        f"  {name:<22} {value:>12} +- {sigma} {unit}"
        for name, value, sigma, unit in table(estimate)
    ]
    if estimate.sigma_scale > 1:
        lines.append(
            f"What is left is {estimate.sigma_scale:.1f} times the noise: the machine has an error "
            f"that these parameters do not describe."
        )
    return "\n".join(lines)


def _files(
    estimate: TcpEstimate, points: TcpPoints, path: Path, frame: str, priors: bool
) -> dict[str, str | bytes]:
    from orthoglide import __version__
    from orthoglide.machine_file import machine_files

    source = {"file": path.name, "sha256": points.sha256}
    provenance: dict[str, Any] = {"version": __version__, "command": "identify", "points": [source]}
    calibrated = replace(estimate.machine.spec, provenance=provenance)
    result = _result(estimate, source, frame, priors, __version__)
    return {
        **machine_files(calibrated, "calibrated.toml"),
        "residuals.csv": _residuals(estimate, points),
        "result.json": json.dumps(result, indent=1) + "\n",
    }


def _result(
    estimate: TcpEstimate, source: dict[str, str], frame: str, priors: bool, version: str
) -> dict[str, Any]:
    from orthoglide.effects import family_of
    from orthoglide.report.result_json import number

    parameters = {}
    for name, value in estimate.values.items():
        unit = family_of(name).unit
        sigma = number(estimate.sigmas[name] / unit.si)
        parameters[name] = {"value": number(value / unit.si), "sigma": sigma, "unit": unit.name}
    return {
        "schema": 1,
        "version": version,
        "command": "identify",
        "arguments": {"fit_tcp": source["file"], "frame": frame, "priors": priors},
        "seed": 0,
        "inputs": [source],
        "sigma_scale": number(estimate.sigma_scale),
        "verdict": None,
        "before": {"rms_mm": number(estimate.before * 1e3)},
        "after": {
            "rms_mm": number(estimate.after * 1e3),
            "chi2": number(estimate.chi2),
            "dof": estimate.dof,
        },
        "parameters": parameters,
    }


def _residuals(estimate: TcpEstimate, points: TcpPoints) -> str:
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\n")
    axes = "xyz"
    writer.writerow(["line", *(f"rho_{a}_mm" for a in axes), *(f"residual_{a}_mm" for a in axes)])
    for line, rho, rest in zip(points.line, points.command, estimate.residuals, strict=True):
        shown = ["" if r != r else f"{r * 1e3:.6f}" for r in rest.tolist()]
        writer.writerow([int(line), *(f"{v * 1e3:.6f}" for v in rho.tolist()), *shown])
    return stream.getvalue()
