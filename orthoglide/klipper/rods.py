"""Arms of different lengths: those of rods, or of a fit that put other errors there."""

from __future__ import annotations

from orthoglide.machine import Machine
from orthoglide.machine_file import TOWERS, Firmware

SPREAD = 5e-4  # metres by which rods of one set do not differ
_EVEN = 5e-5  # within which they are taken as alike
_NEAR = 1.5e-4  # of the stored ones: less than half of the spread


def rods_words(firmware: Firmware) -> str:
    """What is to be known of arms that differ; empty where they do not."""
    if (spread := _spread(firmware)) <= _EVEN:
        return ""
    shown = ", ".join(f"{v * 1e3:.3f}" for v in firmware.arm)
    doubt = (
        ", more than rods of one set do: the fit that gave them has put other errors there. "
        "Measure the rods side by side before you trust any of its numbers"
    )
    return (
        f"The arms that the firmware stores ({shown} mm) differ by {spread * 1e3:.2f} mm"
        f"{doubt if spread > SPREAD else ''}. They are taken as alike to {_EVEN * 1e3:g} mm: if "
        f"you did measure them, give the sigma of your measurement under [parameters] of "
        f"machine.toml."
    )


def doubted_rods(machine: Machine) -> str:
    """The same of an imported machine whose arms cannot be those of one set of rods, unless its
    file says that they were measured: by a sigma beside lengths near the stored ones.
    """
    firmware = machine.spec.printer
    if firmware is None or _spread(firmware) <= SPREAD or _measured(machine, firmware):
        return ""
    return rods_words(firmware)


def _spread(firmware: Firmware) -> float:
    return max(firmware.arm) - min(firmware.arm)


def _measured(machine: Machine, firmware: Firmware) -> bool:
    length = next(e.name for e in machine.catalogue.effects if e.controller == "bar_length")
    for tower, arm in zip(TOWERS, firmware.arm, strict=True):
        own = machine.spec.parameters.get(f"{length}.{tower}")
        if own is None or not own.sigma > 0:
            return False
        if abs(machine.geometry.L + own.value - arm) > _NEAR:
            return False
    return True
