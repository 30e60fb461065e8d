"""URDF with loops, read from a folder with two files: the tree and its closures.

There are two formats. ``orthoglide.urdf`` with ``orthoglide.closures.toml`` is this package's
own. ``robot.urdf`` with ``robot.yaml`` follows the convention of Gepetto's parallel robots:
``closed_loop``, pairs of frames that coincide; ``type`` of each, ``3d`` (origins) or ``6d`` (axes
too); ``name_mot``, the joints that are driven; ``joint_name`` and ``joint_type``, joints of the
tree that replace others, ``SPHERICAL`` or ``FIXED``. See
github.com/Gepetto/example-parallel-robots and arXiv 2504.04767; no code is taken from there.
"""

from __future__ import annotations

import ast
import os
import tomllib
import xml.etree.ElementTree as ET
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from orthoglide import files
from orthoglide.errors import FileError
from orthoglide.geometry import Geometry
from orthoglide.text import abbreviated, printable_path
from orthoglide.urdf.tree import (
    CLOSURES_ENDING,
    CLOSURES_FILE,
    URDF_FILE,
    Closure,
    closures,
    to_urdf,
)

ROBOT_URDF, ROBOT_YAML = "robot.urdf", "robot.yaml"

_KINDS: dict[str, Literal["point", "frame"]] = {"3d": "point", "6d": "frame"}
_REPLACEMENTS = ("SPHERICAL", "FIXED")
_OPTIONAL = ("joint_name", "joint_type")


@dataclass(frozen=True)
class ParallelRobot:
    """A machine with loops, the content of its two files."""

    path: Path  # of the URDF
    urdf: str  # its text
    closures: tuple[Closure, ...]  # of the tree, in the order of the file
    motors: tuple[str, ...]  # names of the joints that are driven
    # joints of the tree to replace: name to "SPHERICAL" or "FIXED"
    replaced: Mapping[str, str] = field(default_factory=dict)


def parallel_robot_files(
    geometry: Geometry, urdf: str = "", loops: Sequence[Closure] | None = None
) -> dict[str, str]:
    """Return both files of a machine, by name, with the text of its tree, calibrated or not, and
    its closures; those of the nominal machine where absent.
    """
    loops = closures(geometry) if loops is None else loops
    kind_names = {kind: name for name, kind in _KINDS.items()}
    lists: dict[str, Any] = {
        "closed_loop": [[loop.frame_1, loop.frame_2] for loop in loops],
        "type": [kind_names[loop.kind] for loop in loops],
        "name_mot": [f"{leg}_slide" for leg in geometry.leg_names],
        "joint_name": [],
        "joint_type": [],
    }
    text = "".join(f"{key}: {value}\n" for key, value in lists.items())
    return {ROBOT_URDF: urdf or to_urdf(geometry), ROBOT_YAML: text}


def generated_files(geometry: Geometry) -> ParallelRobot:
    """Return the content of both files of the nominal machine with these dimensions."""
    motors = tuple(f"{leg}_slide" for leg in geometry.leg_names)
    return ParallelRobot(Path(URDF_FILE), to_urdf(geometry), closures(geometry), motors)


def read_looped_urdf(folder: str | os.PathLike[str]) -> ParallelRobot:
    """Read the pair of files of a folder, in the format of this package or of Gepetto.

    Raises:
        FileError: where a file is missing or invalid.
    """
    foreign = not _package_files(folder)[0].exists() and (Path(folder) / ROBOT_URDF).exists()
    return read_parallel_robot(folder) if foreign else _read_package_files(folder)


def urdf_digests(folder: str | os.PathLike[str]) -> dict[str, str]:
    """Return the sha256 of this package's two files in a folder, by path.

    Raises:
        FileError: where a file is missing.
    """
    paths = _package_files(folder)
    return {str(path): files.sha256(files.read_bytes(path)) for path in paths}


def _package_files(folder: str | os.PathLike[str]) -> tuple[Path, Path]:
    """Return URDF and closures of a folder: ``orthoglide.urdf``, or the one that has closures."""
    base = Path(folder)
    closure_files = sorted(base.glob(f"*{CLOSURES_ENDING}"))
    if (base / URDF_FILE).exists() or len(closure_files) != 1:
        return base / URDF_FILE, base / CLOSURES_FILE
    (closure_file,) = closure_files
    return base / f"{closure_file.name.removesuffix(CLOSURES_ENDING)}.urdf", closure_file


def held_parameters(folder: str | os.PathLike[str]) -> dict[str, float]:
    """Return the parameters of a calibrated machine, SI, that the URDF of a folder contains.

    Raises:
        FileError: where the file of closures is missing, or is no TOML.
    """
    table = _read_closures(_package_files(folder)[1]).get("held", {})
    numbers = table.items() if isinstance(table, dict) else ()
    return {name: float(value) for name, value in numbers if isinstance(value, int | float)}


def _read_closures(path: Path) -> dict[str, Any]:
    text = files.decode(files.read_bytes(path, files.TEXT_LIMIT), path)
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        text = f"must be TOML ({abbreviated(str(error))})"
        raise FileError(text, file=printable_path(path)) from None


def _read_package_files(folder: str | os.PathLike[str]) -> ParallelRobot:
    """Read the two files of a folder in the format of this package."""
    urdf_path, toml_path = _package_files(folder)
    urdf, names = _read_urdf(urdf_path)
    file, tables = printable_path(toml_path), _read_closures(toml_path).get("closure", [])
    loops = []
    for table in tables if isinstance(tables, list) else []:
        if not isinstance(table, dict):
            raise FileError("closure must be tables [[closure]]: write them so", file=file)
        frames = [table.get("frame_1"), table.get("frame_2")]
        name, kind = str(table.get("name", "")), table.get("kind")
        if problem := _closure_problem(frames, kind, _KINDS.values(), names):
            raise FileError(f"closure {abbreviated(name)!r} {problem}", file=file)
        loops.append(Closure(name, kind, *frames))  # type: ignore[arg-type]
    if not loops:
        raise FileError("has no table [[closure]], so no loop is closed: add them", file=file)
    motors = tuple(name for name, kind in names.items() if kind == "prismatic")
    return ParallelRobot(urdf_path, urdf, tuple(loops), motors)


def read_parallel_robot(folder: str | os.PathLike[str]) -> ParallelRobot:
    """Read ``robot.urdf`` and ``robot.yaml`` of a folder.

    Raises:
        FileError: where one is missing or invalid: a frame, joint or motor that the tree lacks, a
            loop without its kind, an unknown kind of joint.
    """
    urdf_path, yaml_path = (Path(folder) / name for name in (ROBOT_URDF, ROBOT_YAML))
    urdf, names = _read_urdf(urdf_path)
    text = files.decode(files.read_bytes(yaml_path, files.TEXT_LIMIT), yaml_path)
    lists = _YamlLists(text, yaml_path)
    pairs, kinds, motors = (lists.list_of(key) for key in ("closed_loop", "type", "name_mot"))
    if len(kinds) != len(pairs):
        lists.fail("type", f"has {len(kinds)} kinds for {len(pairs)} loops: give one for each")
    if not pairs:
        lists.fail("closed_loop", "has no pair of frames, so no loop is closed: add them")
    loops = []
    for k, (pair, kind) in enumerate(zip(pairs, kinds, strict=True), start=1):
        if problem := _closure_problem(pair, str(kind).lower(), _KINDS, names):
            lists.fail("closed_loop" if "frames" in problem else "type", problem)
        loops.append(Closure(f"loop{k}", _KINDS[str(kind).lower()], pair[0], pair[1]))
    if not motors:
        lists.fail("name_mot", "has no joint, so nothing drives the machine: add its motors")
    for k, motor in enumerate(motors):
        if motor in motors[:k]:
            lists.fail("name_mot", f"names {abbreviated(str(motor))} twice: name each joint once")
        if not isinstance(motor, str) or motor not in names:
            text = f"must name joints of {ROBOT_URDF}, not {abbreviated(str(motor))}"
            lists.fail("name_mot", text)
    moving = {name for name, kind in names.items() if kind not in ("fixed", "link")}
    joints, kinds = lists.list_of("joint_name"), lists.list_of("joint_type")
    if len(joints) != len(kinds):
        lists.fail("joint_type", f"has {len(kinds)} kinds for {len(joints)} joints: give one each")
    for joint, kind in zip(joints, kinds, strict=True):
        if joint not in moving:
            name = abbreviated(str(joint))
            lists.fail("joint_name", f"must name moving joints of {ROBOT_URDF}, not {name}")
        if kind not in _REPLACEMENTS:
            allowed = " or ".join(_REPLACEMENTS)
            lists.fail("joint_type", f"must be {allowed}, not {abbreviated(str(kind))}")
    replaced = dict(zip(joints, kinds, strict=True))
    return ParallelRobot(urdf_path, urdf, tuple(loops), tuple(motors), replaced)


def _closure_problem(frames: Any, kind: Any, kinds: Collection[str], names: Collection[str]) -> str:
    """Return the fault of the frames or the kind of a loop as a clause; empty for none."""
    texts = isinstance(frames, list) and all(isinstance(n, str) and n in names for n in frames)
    if not texts or len(frames) != 2 or frames[0] == frames[1]:
        return f"must name two frames of the URDF, not {abbreviated(str(frames))}"
    if kind not in kinds:
        return f"must be of kind {' or '.join(kinds)}, not {abbreviated(str(kind))!r}"
    return ""


def _read_urdf(path: Path) -> tuple[str, dict[str, str]]:
    """Return the text of a URDF, and the type of each joint by name; ``"link"`` of the links.

    Raises:
        FileError: where the file is missing or no URDF.
    """
    text = files.decode(files.read_bytes(path), path)
    try:
        root = ET.fromstring(text)
    except (ET.ParseError, ValueError) as error:
        reason = abbreviated(str(error))
        raise FileError(f"must be a URDF ({reason})", file=printable_path(path)) from None
    links, joints = root.findall("link"), root.findall("joint")  # some have the same names
    return text, {str(e.get("name")): e.get("type", "link") for e in (*links, *joints)}


class _YamlLists:
    """Keys with lists in YAML's flow style, the only content of such files."""

    def __init__(self, text: str, path: Path) -> None:
        self.file = printable_path(path)
        self.lines: dict[str, int] = {}
        self.texts: dict[str, str] = {}
        key = ""
        for number, line in enumerate(text.split("\n"), start=1):
            content = line.split("#")[0].rstrip()
            name, colon, rest = content.partition(":")
            if colon and content[0] not in " \t-" and "[" not in name:
                key = name.strip()
                self.lines[key], self.texts[key] = number, rest
            elif content.strip() and key:
                self.texts[key] += f" {content.strip()}"

    def fail(self, key: str, message: str) -> Any:
        """Raise an error for the value of a key, or its absence."""
        raise FileError(f"{key} {message}", file=self.file, line=self.lines.get(key))

    def list_of(self, key: str) -> list[Any]:
        """Return the list of a key; empty where an optional key is absent."""
        if key not in self.texts:
            return [] if key in _OPTIONAL else list(self.fail(key, "is missing: add it"))
        try:
            value = ast.literal_eval(self.texts[key].strip())
        except (ValueError, SyntaxError, MemoryError, RecursionError):
            value = None
        if not isinstance(value, list):
            self.fail(key, "must be a list in brackets, with names in quotes")
        return list(value)
