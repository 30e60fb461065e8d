"""Make the pictures of the README again: ``python docs/images/render.py [machine] [report]``.

``machine.png`` is the URDF of the package in MuJoCo (with no display: ``MUJOCO_GL=egl``);
``report.png`` the top of the demo's first report in headless Chromium.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

os.environ.setdefault("MUJOCO_GL", "egl")
HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path.insert(0, str(ROOT))

WIDTH, HEIGHT = 800, 800
REPORT = (1100, 1180)
COMMAND_MM = (-40.0, 30.0, -50.0)  # travel of the posture shown


def machine() -> None:
    """The URDF, as a viewer shows it."""
    import matplotlib.image
    import mujoco
    import numpy as np

    from orthoglide import Geometry, Mechanism
    from orthoglide.urdf import to_urdf

    geometry = Geometry()
    whole = '<mujoco><compiler discardvisual="false" fusestatic="false"/></mujoco></robot>'
    spec = mujoco.MjSpec.from_string(to_urdf(geometry).replace("</robot>", whole))
    getattr(spec.visual, "global").offwidth = WIDTH
    getattr(spec.visual, "global").offheight = HEIGHT
    spec.visual.headlight.ambient = [0.45] * 3
    spec.visual.headlight.diffuse = [0.5] * 3
    sky = spec.add_texture(name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX)
    sky.builtin = mujoco.mjtBuiltin.mjBUILTIN_FLAT
    sky.rgb1, sky.rgb2, sky.width, sky.height = [0.86, 0.9, 0.94], [0.86, 0.9, 0.94], 64, 64
    spec.worldbody.add_light(pos=[-1, -1, 2], dir=[0.5, 0.5, -1])
    model = spec.compile()
    data = mujoco.MjData(model)
    mechanism = Mechanism(geometry)
    closed = mechanism.close(geometry.L + np.array(COMMAND_MM) * 1e-3)
    tree = mechanism.tree.model
    for k in range(model.njnt):
        name = model.joint(k).name
        data.joint(name).qpos = closed.q[tree.joints[tree.getJointId(name)].idx_q]
    mujoco.mj_forward(model, data)
    camera = mujoco.MjvCamera()
    camera.lookat[:] = (0.18, 0.18, 0.14)
    camera.distance, camera.azimuth, camera.elevation = 1.4, 50, -22
    with mujoco.Renderer(model, HEIGHT, WIDTH) as renderer:
        renderer.update_scene(data, camera)
        matplotlib.image.imsave(HERE / "machine.png", renderer.render())


def report() -> None:
    """The first screen of what the demo finds on the machine with a known fault."""
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        raise SystemExit("report.png needs chromium: install it (apt-get install chromium)")
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "demo"
        words = [sys.executable, "-m", "orthoglide", "demo", "--quiet", "--out", str(out)]
        subprocess.run(words, check=True, cwd=ROOT)
        subprocess.run(
            [
                browser, "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run",
                "--disable-background-networking", f"--user-data-dir={folder}/profile",
                "--hide-scrollbars", f"--window-size={REPORT[0]},{REPORT[1]}",
                f"--screenshot={HERE / 'report.png'}", (out / "simulated" / "report.html").as_uri(),
            ],
            check=True,
            stderr=subprocess.DEVNULL,
        )  # fmt: skip


if __name__ == "__main__":
    pictures = {"machine": machine, "report": report}
    for name in sys.argv[1:] or pictures:
        pictures[name]()
        print(f"written: {HERE / name}.png")
