"""Close the loop: from a residual to the effect that the model lacked, and the error afterwards.

``python examples/close_the_loop.py`` takes readings of an independent simulated machine with an
error that nobody declared (``tests/data/rig``, rig-4), and what a tracker says of its tool.
"""

from pathlib import Path

import numpy as np

import orthoglide as og

DATA = Path(__file__).parents[1] / "tests" / "data" / "rig"
machine = og.Machine.load(DATA / "machine.toml")
readings = og.read_campaign(DATA / "rig-4.csv")

# 1. Identify what the simplified model has: joint offsets and leg lengths.
base = og.identify(readings, machine)
print(f"noise of a reading      {1e3 * base.problem.declared_noise:.3f} mm")
print(f"residual, rms           {1e3 * base.scores.rms:.3f} mm")
residual = readings.reading - base.predicted
for number, setup in enumerate(readings.setups):
    print(f"  setup {setup.name:8} {1e3 * np.std(residual[readings.setup == number]):.3f} mm")

# 2. Trace it to a cause, add that cause, identify again. The tracker only judges the result.
verdict = og.close_loop([readings], machine, tcp=DATA / "rig-4.tcp.csv")
print(f"\nverdict: {verdict.word}")
for effect in verdict.effects:
    print(f"  {effect.name}, probability {effect.probability:.2f}")
    for other in effect.rivals:
        print(f"    or {other.name}, probability {other.probability:.2f}")

# 3. The error before and after, in the readings and at the tool.
before, after = verdict.before.scores, verdict.after.scores
tool = verdict.tcp["translation"]
print("\n                        before    after")
print(f"readings, rms           {1e3 * before.rms:.3f}     {1e3 * after.rms:.3f} mm")
print(f"tool, mean              {1e3 * tool.before_mean:.3f}     {1e3 * tool.after_mean:.3f} mm")
verified = verdict.verification
print(f"Pinocchio closes all {verified.postures} postures again: TCP within {verified.tcp:.0e} m")
