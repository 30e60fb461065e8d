"""URDF with loops in the convention of Gepetto's parallel robots: a folder with two files.

``robot.urdf`` holds the tree, ``robot.yaml`` what closes it: ``closed_loop``, pairs of frames that
coincide; ``type`` of each, ``3d`` (origins) or ``6d`` (axes too); ``name_mot``, the joints that are
driven; ``joint_name`` and ``joint_type``, joints of the tree that stand for others, such as
spherical ones (here none, and none are read: a tree read without them is another machine). See
github.com/Gepetto/example-parallel-robots and arXiv 2504.04767; the code is our own.
"""

from __future__ import annotations

import ast
import os
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from orthoglide import files
from orthoglide.errors import FileError
from orthoglide.geometry import Geometry
from orthoglide.text import brief, shown
from orthoglide.urdf.tree import Closure, closures, to_urdf

ROBOT_URDF, ROBOT_YAML = "robot.urdf", "robot.yaml"

_KINDS: dict[str, Literal["point", "frame"]] = {"3d": "point", "6d": "frame"}


@dataclass(frozen=True)
class ParallelRobot:
    """A machine with loops as its two files say it."""

    urdf: str  # text of the tree
    closures: tuple[Closure, ...]  # what closes it, in the order of the file
    motors: tuple[str, ...]  # names of the joints that are driven


def parallel_robot_files(geometry: Geometry, urdf: str = "") -> dict[str, str]:
    """Both files of a machine, by name.

    Args:
        geometry: the machine's dimensions.
        urdf: text of its tree, calibrated or not; the nominal one where absent.
    """
    loops = closures(geometry)
    kinds = {kind: name for name, kind in _KINDS.items()}
    lists: dict[str, Any] = {
        "closed_loop": [[loop.frame_1, loop.frame_2] for loop in loops],
        "type": [kinds[loop.kind] for loop in loops],
        "name_mot": [f"{leg}_slide" for leg in geometry.leg_names],
        "joint_name": [],
        "joint_type": [],
    }
    text = "".join(f"{key}: {value}\n" for key, value in lists.items())
    return {ROBOT_URDF: urdf or to_urdf(geometry), ROBOT_YAML: text}


def read_parallel_robot(folder: str | os.PathLike[str]) -> ParallelRobot:
    """Read the two files of a folder.

    Raises:
        FileError: where one is missing, or says what cannot be: a frame or motor that the tree
            lacks, a loop without its kind, joints that stand for others.
    """
    urdf_path, yaml_path = (Path(folder) / name for name in (ROBOT_URDF, ROBOT_YAML))
    urdf = files.decode(files.read_bytes(urdf_path), urdf_path)
    names = _names(urdf, shown(urdf_path))
    found = _Lists(files.decode(files.read_bytes(yaml_path, files.TEXT), yaml_path), yaml_path)
    pairs, kinds, motors = (found.of(key) for key in ("closed_loop", "type", "name_mot"))
    if replaced := found.of("joint_name"):
        found.fail(
            "joint_name",
            f"replaces joints such as {brief(str(replaced[0]))} by others, which is not read: "
            f"write those joints into {ROBOT_URDF} and leave the list empty",
        )
    if len(kinds) != len(pairs):
        found.fail("type", f"has {len(kinds)} kinds for {len(pairs)} loops: give one for each")
    loops = []
    for k, (pair, kind) in enumerate(zip(pairs, kinds, strict=True), start=1):
        if not (isinstance(pair, list) and len(pair) == 2 and all(n in names for n in pair)):
            found.fail("closed_loop", f"names in {brief(str(pair))} no two frames of {ROBOT_URDF}")
        if str(kind).lower() not in _KINDS:
            found.fail("type", f"has {brief(str(kind))}, which is neither 3d nor 6d: correct it")
        loops.append(Closure(f"loop{k}", _KINDS[str(kind).lower()], pair[0], pair[1]))
    for motor in motors:
        if motor not in names:
            found.fail("name_mot", f"names {brief(str(motor))}, no joint of {ROBOT_URDF}")
    return ParallelRobot(urdf, tuple(loops), tuple(motors))


def _names(urdf: str, file: str) -> frozenset[str]:
    try:
        root = ET.fromstring(urdf)
    except (ET.ParseError, ValueError) as error:
        raise FileError(f"is no URDF ({brief(str(error))}): correct it", file=file) from None
    return frozenset(str(e.get("name")) for e in root if e.tag in ("link", "joint"))


class _Lists:
    """Keys with lists in YAML's flow style, over several lines or one: all that such files hold."""

    def __init__(self, text: str, path: Path) -> None:
        self.file = shown(path)
        self.lines: dict[str, int] = {}
        self.texts: dict[str, str] = {}
        key = ""
        for number, line in enumerate(text.split("\n"), start=1):
            bare = line.split("#")[0].rstrip()
            name, colon, rest = bare.partition(":")
            if colon and bare[0] not in " \t-" and "[" not in name:
                key = name.strip()
                self.lines[key], self.texts[key] = number, rest
            elif bare.strip() and key:
                self.texts[key] += f" {bare.strip()}"

    def fail(self, key: str, message: str) -> Any:
        """Refuse the value of a key, or its absence."""
        raise FileError(f"{key} {message}", file=self.file, line=self.lines.get(key))

    def of(self, key: str) -> list[Any]:
        """The list of a key; empty where ``joint_name`` is not there."""
        if key not in self.texts:
            return [] if key == "joint_name" else list(self.fail(key, "is missing: add it"))
        try:
            value = ast.literal_eval(self.texts[key].strip())
        except (ValueError, SyntaxError, MemoryError, RecursionError):
            value = None
        if not isinstance(value, list):
            self.fail(key, "is no list in brackets, with names in quotes: write it so")
        return list(value)
