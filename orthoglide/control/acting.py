"""Whether the numbers of a machine are to be acted on, by the verdict that is kept with them."""

from __future__ import annotations

from orthoglide.errors import InputError
from orthoglide.machine import Machine, MachineSource

_WHY = {
    "partial": "its causes explain only part of what is wrong",
    "unexplained": "something is wrong that no cause explains",
}


def withheld(machine: Machine) -> str:
    """Why the numbers of a machine should not be put to use, as a clause; empty where they may."""
    kept = machine.spec.provenance
    verdict = str(kept.get("verdict", ""))
    if verdict in _WHY and kept.get("command") != "identify":  # which looks for no cause
        return f"the verdict on this machine is {verdict}: {_WHY[verdict]}"
    cautions = kept.get("cautions", ())
    return f"the verdict on this machine warns: {cautions[0]}" if cautions else ""


def not_withheld(given: MachineSource, force: bool) -> Machine:
    """The machine, refused where the verdict says not to act on its numbers, unless forced.

    Raises:
        InputError: saying why.
    """
    machine = Machine.of(given)
    why = "" if force else withheld(machine)
    if why:
        raise InputError(
            f"{why.rstrip('.')}. Its numbers are withheld: confirm the cause first, or force them "
            f"(--force, force=True)"
        )
    return machine
