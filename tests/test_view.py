"""Pinocchio's viewer on a machine: its page, its closed postures, and errors as they are drawn."""

from __future__ import annotations

import base64
import re
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import orthoglide as og
from orthoglide.errors import FileError, InputError
from orthoglide.machine_file import MachineFile
from orthoglide.viewer import MagnifiedMachine, show, static_page
from tests.engines import DELTA
from tests.test_cli import done
from tests.test_report import browsed

umsgpack = pytest.importorskip("umsgpack", reason="the viewer needs meshcat")
pytest.importorskip("meshcat")

ERRORS = {
    "orthoglide": {
        "axis_tilt.x.y": 2e-3, "rail_bow.y.z": 3e-4, "leg_length.z": 4e-4, "bar_mismatch.x": 2e-4,
        "parallelogram_width.y": 3e-4, "mount_tilt.z.a": 2e-3,
    },
    "delta": {"axis_tilt.a.x": 2e-3, "leg_length.b": 1e-3, "mount_tilt.c.a": 3e-3},
}  # fmt: skip
KINDS = tuple(ERRORS)
FACTOR = 10.0


def nominal(kind: str) -> og.Machine:
    return og.Machine(MachineFile(geometry=DELTA)) if kind == "delta" else og.Machine.nominal()


def worn(kind: str) -> og.Machine:
    own = nominal(kind)
    names = own.catalogue.legs.across  # directions across a tower have names of their own
    values = {
        n.replace("a.x", f"a.{names[0][0]}") if kind == "delta" else n: v
        for n, v in ERRORS[kind].items()
    }
    return own.with_parameters(values)


def posture(kind: str) -> np.ndarray:
    return nominal(kind).geometry.zero + np.array([0.01, -0.02, 0.015])


class Scene:
    """What a static page draws, by meshcat's own commands."""

    def __init__(self, page: str) -> None:
        self.objects: dict[str, dict[str, Any]] = {}
        self.places: dict[str, np.ndarray] = {}
        self.animations: dict[str, dict[str, Any]] = {}
        for text in re.findall(r'fetch\("data:application/octet-binary;base64,([^"]+)"\)', page):
            command = umsgpack.unpackb(base64.b64decode(text))
            path = command.get("path", "").removeprefix("/meshcat/")
            if command["type"] == "set_object":
                self.objects[path] = command["object"]
            elif command["type"] == "set_transform":
                self.places[path] = np.reshape(command["matrix"], (4, 4)).T
            elif command["type"] == "set_animation":
                for one in command["animations"]:
                    name = one["path"].removeprefix("/meshcat/")
                    self.animations[name] = {t["name"]: t["keys"] for t in one["clip"]["tracks"]}

    def at(self, name: str, root: str = "machine") -> np.ndarray:
        """Placement of a solid ``(4, 4)``."""
        return self.places[f"{root}/visuals/{name}"]

    def tools(self, geometry: og.Geometry, root: str = "machine") -> np.ndarray:
        """The tool ``(3, 3)`` as each leg's end carries it."""
        found = []
        for leg in geometry.legs:
            place = self.at(f"{leg.name}_platform_1", root)
            centre = -np.array([0.375 * geometry.r, 0.0, 0.0])
            if geometry.layout.hanging:
                centre = np.array([0.0, -0.45 * geometry.r, 0.0])
            link = place[:3, 3] - place[:3, :3] @ centre
            found.append(link - place[:3, :3] @ (leg.axes.T @ leg.platform))
        return np.array(found)


@cache
def page_of(kind: str, factor: float) -> str:
    own = worn(kind)
    drawn = MagnifiedMachine(own.model, own.values, {}, factor)
    return static_page(show(drawn, posture(kind)), drawn, "A & B")


@cache
def scene(kind: str, factor: float) -> Scene:
    return Scene(page_of(kind, factor))


# --- The page ---------------------------------------------------------------------------------


SEEN = """<script>addEventListener("load", () => setTimeout(() => {
  viewer.render();
  const canvas = document.querySelector("canvas"), flat = document.createElement("canvas");
  flat.width = canvas.width; flat.height = canvas.height;
  const paper = flat.getContext("2d"), { width: w, height: h } = flat;
  paper.drawImage(canvas, 0, 0);
  const ink = (...box) => paper.getImageData(...box).data.some((v, k) => k % 4 < 3 && v < 200);
  document.title = JSON.stringify({ middle: ink(0, 0, w, h),
    edges: ink(0, 0, w, 3) || ink(0, h - 3, w, 3) || ink(0, 0, 3, h) || ink(w - 3, 0, 3, h),
    moves: viewer.animator.actions.length, wide: document.documentElement.scrollWidth > innerWidth,
    asked: performance.getEntriesByType("resource").map(e => e.name.slice(0, 5)),
    words: document.querySelector("p").textContent });
}, 1500));</script></body>"""


@pytest.mark.thorough(except_for=["orthoglide"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_browser_draws_all_of_it_and_asks_nothing_of_a_network(kind: str, tmp_path: Path) -> None:
    page = page_of(kind, FACTOR).replace("</body>", SEEN)
    (tmp_path / "page.html").write_text(page, encoding="utf-8")
    drawing = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")
    told = browsed(tmp_path / "page.html", "1280,900", 6000, *drawing)
    assert told["middle"]
    assert not told["edges"]
    assert not told["wide"]
    assert told["moves"] > 20
    assert told["asked"] == []
    assert "default-src 'none'" in page
    assert told["words"].startswith("A & B Errors are drawn 10 times as large")


# --- The posture ------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_the_platform_stands_where_the_machine_has_it(kind: str) -> None:
    """On all three legs, so the loops are closed as they are drawn."""
    own = worn(kind)
    wanted = own.forward(posture(kind))
    assert np.abs(wanted - nominal(kind).forward(posture(kind))).max() > 1e-4
    for tool in scene(kind, 1.0).tools(own.geometry):
        np.testing.assert_allclose(tool, wanted, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_errors_are_magnified_and_the_nominal_machine_stands_beside(kind: str) -> None:
    geometry, start = nominal(kind).geometry, nominal(kind).forward(posture(kind))
    one = scene(kind, 1.0).tools(geometry)[0] - start
    many = scene(kind, FACTOR).tools(geometry)[0] - start
    np.testing.assert_allclose(many, FACTOR * one, atol=0.1 * FACTOR * np.abs(one).max())
    for tool in scene(kind, FACTOR).tools(geometry, "nominal"):
        np.testing.assert_allclose(tool, start, atol=1e-9)
    assert not any(path.startswith("nominal/visuals/") for path in scene(kind, 1.0).objects)


@pytest.mark.parametrize("kind", KINDS)
def test_the_tool_moves_to_and_fro_along_each_axis(kind: str) -> None:
    keys = scene(kind, 1.0).animations[
        f"machine/visuals/{nominal(kind).geometry.leg_names[0]}_platform_1"
    ]
    assert [key["time"] for key in keys[".position"]] == list(range(len(keys[".position"])))
    points = np.array([key["value"] for key in keys[".position"]])
    np.testing.assert_allclose(points[0], points[-1], atol=1e-6)
    for axis, part in enumerate(np.split(points[1:], 3) - points[0]):
        reach = np.abs(part).max(axis=0)
        assert reach[axis] > 0.02
        assert np.delete(reach, axis).max() < 0.1 * reach[axis]
        assert part[:, axis].min() < -0.01 < 0.01 < part[:, axis].max()


# --- In Python, and what is refused -------------------------------------------------------------


def test_a_machine_shows_itself_and_writes_its_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own, out = worn("orthoglide"), tmp_path / "machine.html"
    viewer = own.show(magnify=5.0, out=out)
    assert type(viewer).__name__ == "MeshcatVisualizer"
    assert viewer.viewer.url() in capsys.readouterr().out
    drawn = Scene(out.read_text(encoding="utf-8"))
    start = nominal("orthoglide").forward(own.geometry.zero)
    np.testing.assert_allclose(drawn.tools(own.geometry, "nominal")[0], start, atol=1e-9)
    with pytest.raises(FileError, match=r"machine\.html"):
        own.show(out=out)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"magnify": 5000.0}, "do not close with errors 5000 times as large: choose a smaller"),
        ({"magnify": -1.0}, "a magnification is a number from 0 on, not -1.0"),
        ({"magnify": float("nan")}, "a magnification is a number from 0 on"),
        ({"rho": np.full((2, 3), 0.31)}, r"one command of shape \(3,\), not \(2, 3\)"),
    ],
)
def test_what_cannot_be_shown_is_refused(options: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        worn("orthoglide").show(**options)


# --- On the command line ------------------------------------------------------------------------


def test_view_writes_a_page(tmp_path: Path) -> None:
    own, out = worn("orthoglide"), tmp_path / "worn.html"
    own.save(tmp_path / "worn.toml")
    asked = ["view", str(tmp_path / "worn.toml"), "--magnify", "20", "--out", str(out)]
    assert "the machine, errors 20 times as large" in done(*asked)
    page = out.read_text(encoding="utf-8")
    assert "20 times as large" in page
    assert "nominal/visuals/x_bar1_0" in Scene(page).objects
