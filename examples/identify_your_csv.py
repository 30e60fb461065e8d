"""From your own dial readings to joint offsets and leg lengths.

``python examples/identify_your_csv.py CAMPAIGN.csv [MACHINE.toml]``: the columns of the file are
those of ``orthoglide protocol --out SHEET.csv``, which writes a sheet to fill in. Lengths in files
are millimetres; everything in Python is SI. Without an argument the published Experiment 2 is used.
"""

from __future__ import annotations

import sys
from importlib.resources import files

import orthoglide as og

MM = 1e-3


def run(campaign_file: str, machine_file: str | None = None) -> og.Estimate:
    """Read, identify, say what came out; the estimate holds the calibrated machine."""
    machine = og.Machine.load(machine_file) if machine_file else og.Machine.nominal()
    campaign = og.read_campaign(campaign_file, machine)
    print(f"{campaign_file}: {len(campaign)} readings in {len(campaign.setups)} setups")

    # What is free, and whether the tolerances count as knowledge, is yours to say:
    # free=["joint_offset"], priors=False, noise=0.01 * MM, bounds={"leg_length": 0.5 * MM} ...
    estimate = og.identify(campaign, machine, free=["joint_offset", "leg_length"])
    print(f"noise of a reading {estimate.problem.noise.typical / MM:.3f} mm", end=", ")
    print(f"from: {estimate.problem.noise.source}\n\n{estimate}\n")

    check = estimate.check
    if check is not None:
        print(
            f"cross-check: mechanism and reduction agree to {check.reduction / MM:.1e} mm, "
            f"system (11) fits readings within {check.linear / MM:.2g} mm of them"
        )
    low, high = estimate.interval("joint_offset.x")
    print(f"95 % interval of joint_offset.x: {low / MM:+.3f} to {high / MM:+.3f} mm")

    # The machine as identified: its commands, or estimate.machine.save("calibrated.toml")
    zero = estimate.machine.inverse([0.0, 0.0, 0.0])
    print("commands that bring the TCP to its zero:", " ".join(f"{v / MM:.3f}" for v in zero), "mm")
    return estimate


def main() -> None:
    if len(sys.argv) > 3 or sys.argv[1:] in (["-h"], ["--help"]):
        raise SystemExit(__doc__)
    published = str(files("orthoglide") / "data" / "experiment2.csv")
    try:
        run(*(sys.argv[1:] or [published]))
    except og.OrthoglideError as error:
        raise SystemExit(f"{error}") from None


if __name__ == "__main__":
    main()
