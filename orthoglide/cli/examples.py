"""An example for the help of every command; a test reads each as the command does."""

from __future__ import annotations

import click

EXAMPLES: dict[str, tuple[str, ...]] = {
    "demo": ("demo --out demo",),
    "close-loop": (
        "close-loop april.csv --machine machine.toml --out april",
        "close-loop april.csv may.csv --holdout june.csv --out spring",
    ),
    "diagnose": ("diagnose april.csv --machine machine.toml",),
    "identify": (
        "identify april.csv --out april",
        "identify april.csv may.csv --fit-tcp tracker.tcp.csv --noise 0.004 --out spring",
    ),
    "check": (
        "check before.csv after.csv --machine machine.toml",
        "check april/result.json after.csv --out repaired",
    ),
    "rerun": ("rerun april/result.json", "rerun april/result.json --inputs data --out again"),
    "protocol": ("protocol --kind sweep --machine machine.toml --out sheet.csv",),
    "measure": (
        "measure --machine machine.toml --out april.csv",
        "measure --sheet sheet.csv --out april.csv",
    ),
    "simulate": ("simulate --machine bent.toml --kind sweep --seed 1 --out bent.csv",),
    "design": (
        "design --machine machine.toml --count 24 --out sheet.csv",
        "design sheet.csv --want TCP=0.02 --detect",
        "design --owns plate,distance --machine machine.toml --out sheet.csv",
    ),
    "rehearse": (
        "rehearse --machine machine.toml --sheet sheet.csv --out rehearsal",
        "rehearse --machine machine.toml --campaigns 900 --dask tcp://cluster:8786 --out rehearsal",
    ),
    "compensate": ("compensate path.csv --machine april/calibrated.toml --out commands.csv",),
    "export": ("export --machine april/calibrated.toml --out controller",),
    "compare": ("compare --machine april/calibrated.toml --out comparison",),
    "forward": (
        "forward 310.25 310.25 310.25",
        "forward --csv commands.csv --out points.csv --machine april/calibrated.toml",
    ),
    "view": ("view", "view april/calibrated.toml --magnify 50 --out april.html"),
    "inverse": ("inverse 10 0 -5 --machine april/calibrated.toml",),
    "import klipper": ("import klipper printer.cfg --out printer",),
    "import plates": ("import plates heightmap.csv --machine machine.toml --out plate",),
}
"""Command lines by command, without the program's name."""


def with_examples(group: click.Group, prefix: str = "") -> None:
    """Put the examples below the help of a group's commands."""
    for name, command in group.commands.items():
        if isinstance(command, click.Group):
            with_examples(command, f"{prefix}{name} ")
        lines = [f"  orthoglide {line}" for line in EXAMPLES.get(prefix + name, ())]
        if lines:
            title = "Example" if len(lines) == 1 else "Examples"
            command.epilog = "\n".join(["\b", f"{title}:", *lines])
