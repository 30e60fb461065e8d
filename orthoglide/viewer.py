"""A machine in Pinocchio's meshcat viewer: loops closed, errors magnified, and as a static page."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from html import escape
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from orthoglide.errors import ClosureError, InputError, UnreachableError
from orthoglide.geometry import Array
from orthoglide.mechanism.mechanism import Posture
from orthoglide.mechanism.perfect_legs import commands as commands_of
from orthoglide.mechanism.tree import visual_model
from orthoglide.prediction import Conditions, Model

_KEY_FRAMES, _FRAMES_PER_SECOND = 5, 8  # key frames from the middle to the end of a motion
_NOMINAL_COLOUR = [0.45, 0.5, 0.55, 0.3]  # red, green, blue, opacity of the nominal machine
_EYE_DISTANCE = 0.85  # in diagonals of the machine, which then fits meshcat's 75 degrees
_CONTENT_SECURITY_POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; "
    "connect-src data:; img-src data: blob:"
)


@dataclass(frozen=True, eq=False)
class MagnifiedMachine:
    """A machine with its errors magnified."""

    model: Model  # model of the machine
    values: Mapping[str, float]  # its parameters, SI
    # conditions besides the command, as for :meth:`orthoglide.Machine.pose`
    conditions: Mapping[str, ArrayLike]
    factor: float  # factor of the displacements of virtual joints

    def displacements(self, rho: Array) -> Array:
        """Return displacements of the virtual joints ``(3, 10)`` at a command ``(3,)``."""
        conditions = Conditions.from_commands(rho, **self.conditions)
        moves = self.model.loaded_displacements(self.values, conditions)
        return self.factor * moves.reshape(3, -1)

    def close(self, rho: Array, guess: Posture | None = None) -> Posture:
        """Close the loops at a command ``(3,)``, metres.

        Raises:
            InputError: if they do not close with errors this large.
        """
        mechanism = self.model.mechanism
        try:
            return mechanism.close(rho, self.displacements(rho), guess=guess)
        except ClosureError as error:
            if self.factor <= 1:
                raise
            raise InputError(
                f"the loops do not close with errors {self.factor:g} times as large: choose a "
                f"smaller magnification"
            ) from error

    def commands_along_axes(self, rho: Array) -> Iterator[Array]:
        """Yield commands ``(3,)`` that move the nominal tool to and fro along x, y and z."""
        mechanism = self.model.mechanism
        start, outward = mechanism.close(rho).p, np.arange(1, _KEY_FRAMES + 1) / _KEY_FRAMES
        for direction in np.stack([np.eye(3), -np.eye(3)], axis=1).reshape(6, 3):
            shares = self._reach(start, direction) * np.array([*outward, *(1 - outward)])
            yield from commands_of(mechanism.spheres, start + np.outer(shares, direction))

    def _reach(self, start: Array, direction: Array) -> float:
        """Return the reach of the nominal tool along a unit vector, metres, with all carriages
        within their strokes; at most half a stroke.
        """
        geometry = self.model.geometry
        for reach in np.linspace(0.5, 0.05, 10) * np.ptp(geometry.stroke):
            with suppress(UnreachableError):
                rho = commands_of(self.model.mechanism.spheres, (start + reach * direction)[None])
                if geometry.in_stroke(rho, 0.0).all():
                    return float(reach)
        return 0.0


def show(machine: MagnifiedMachine, rho: Array, *, open_browser: bool = False) -> Any:
    """Return Pinocchio's ``MeshcatVisualizer`` with a machine at a command ``(3,)``, metres,
    animated along each axis.

    Raises:
        InputError: if meshcat is not installed, or the loops do not close with errors this large.
    """
    try:
        import meshcat  # noqa: F401
    except ImportError:
        raise InputError("the viewer needs meshcat: pip install orthoglide[viewer]") from None
    from pinocchio.visualize import MeshcatVisualizer

    if rho.shape != (3,):
        raise InputError(f"the viewer shows one command of shape (3,), not {rho.shape}")
    if not (np.isfinite(machine.factor) and machine.factor >= 0):
        raise InputError(f"a magnification is a number from 0 on, not {machine.factor}")
    mechanism, geometry = machine.model.mechanism, machine.model.geometry
    tree, posture = mechanism.tree, machine.close(rho)
    viewer = MeshcatVisualizer(tree.model, None, visual_model(tree, mechanism.nominal))
    viewer.initViewer()
    viewer.loadViewerModel("machine")
    viewer.display(posture.q)
    if machine.factor > 1 and machine.displacements(rho).any():
        nominal = visual_model(tree, mechanism.nominal)
        for name in [str(o.name) for o in nominal.geometryObjects if o.parentJoint == 0]:
            nominal.removeGeometryObject(name)
        ghost = MeshcatVisualizer(tree.model, None, nominal)
        ghost.initViewer(viewer=viewer.viewer)
        ghost.loadViewerModel("nominal", visual_color=_NOMINAL_COLOUR)
        ghost.display(mechanism.close(rho).q)
    _animate(viewer, machine, rho, posture)
    _set_camera(viewer, 270.0 if geometry.layout.hanging else 230.0)
    if open_browser:
        viewer.viewer.open()
    return viewer


def _animate(viewer: Any, machine: MagnifiedMachine, rho: Array, posture: Posture) -> None:
    """Animate the viewer along each axis, which its controls play."""
    import pinocchio as pin
    from meshcat.animation import Animation

    animation = Animation(default_framerate=_FRAMES_PER_SECOND)
    moving = [item for item in viewer.visual_model.geometryObjects if item.parentJoint > 0]
    data, geometry_data = viewer.model.createData(), viewer.visual_model.createData()
    for k, command in enumerate([rho, *machine.commands_along_axes(rho)]):
        posture = machine.close(command, posture)
        pin.updateGeometryPlacements(
            viewer.model, data, viewer.visual_model, geometry_data, posture.q
        )
        with animation.at_frame(viewer.viewer, k) as frame:
            for item in moving:
                node = viewer.getViewerNodeName(item, pin.GeometryType.VISUAL)
                place = geometry_data.oMg[viewer.visual_model.getGeometryId(item.name)]
                frame[node].set_transform(place.homogeneous)
    viewer.viewer.set_animation(animation, play=False)


def _set_camera(viewer: Any, azimuth: float) -> None:
    """Look at the machine from an azimuth in degrees, on white paper."""
    corners = []
    items, placed = viewer.visual_model.geometryObjects, viewer.visual_data.oMg
    for item, place in zip(items, placed, strict=True):
        item.geometry.computeLocalAABB()
        box = item.geometry.aabb_local
        for corner in product(*zip(box.min_, box.max_, strict=True)):
            corners.append(place.act(item.meshScale * np.array(corner)))
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    # Meshcat's camera turns about the origin, so the machine's middle is put there.
    transform = np.eye(4)
    transform[:3, 3] = -(low + high) / 2
    turn, rise = np.deg2rad([azimuth, 22.0])
    cos_rise = np.cos(rise)
    toward_eye = np.array([cos_rise * np.cos(turn), cos_rise * np.sin(turn), np.sin(rise)])
    x, y, z = (_EYE_DISTANCE * float(np.linalg.norm(high - low)) * toward_eye).tolist()
    scene = viewer.viewer
    scene.set_transform(transform)
    # The camera's y points up, the machine's z does.
    scene["/Cameras/default/rotated/<object>"].set_property("position", [x, z, -y])
    viewer.setBackgroundColor("white")
    for helper in ("/Grid", "/Axes"):
        scene[helper].set_property("visible", False)


def static_page(viewer: Any, machine: MagnifiedMachine, title: str) -> str:
    """Return meshcat's static page of a viewer from :func:`show`: one file that needs no
    network.
    """
    head = (
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<meta http-equiv="Content-Security-Policy" content="{_CONTENT_SECURITY_POLICY}">'
        f"<title>{escape(title)}</title>"
    )
    red, green, blue = machine.model.geometry.leg_names
    scale = f"Errors are drawn {machine.factor:g} times as large as they are."
    errors = f"{scale} Grey: the nominal machine." if machine.factor > 1 else "True to scale."
    caption = (
        f"{errors} Carriages: {red} red, {green} green, {blue} blue. Drag to turn. Under Open "
        f"Controls, Animations, the tool moves along x, y and z."
    )
    foot = (
        '<p style="position:fixed;left:0;bottom:0;margin:0;padding:.5rem .8rem;'
        "background:rgba(255,255,255,.85);color:#1f2a33;font:.875rem/1.4 'Segoe UI','Noto Sans',"
        f"'DejaVu Sans',Arial,sans-serif\"><strong>{escape(title)}</strong> "
        f"{escape(caption)}</p>"
    )
    page = textwrap.dedent(viewer.viewer.static_html()).strip()
    if "<title>MeshCat</title>" not in page or "</body>" not in page:
        raise InputError("meshcat writes another page than 0.3 does: pip install 'meshcat<0.4'")
    page = page.replace("<title>MeshCat</title>", head, 1)
    before, body, after = page.rpartition("</body>")
    return f"{before}{foot}{body}{after}\n"
