"""The plan of the house, as code: who may import whom, how large a file may be, what loads when."""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "orthoglide"
LONGEST = 400

# A room may import from the floors below its own, never from beside or above.
FLOORS: tuple[frozenset[str], ...] = (
    frozenset({"errors", "notes", "parameters", "progress", "text", "threads"}),
    frozenset({"layout"}),
    frozenset({"geometry", "files", "frames", "units", "numerals"}),
    frozenset({"reduction", "urdf", "effects", "scene"}),
    frozenset({"mechanism", "machine_file"}),
    frozenset({"observations"}),
    frozenset({"prediction", "figures"}),
    frozenset({"machine"}),
    frozenset({"accuracy", "klipper"}),
    frozenset({"fit", "comparison", "control", "pictures"}),
    frozenset({"diagnosis"}),
    frozenset({"posterior", "judging", "simulation"}),
    frozenset({"planning", "request"}),
    frozenset({"result"}),
    frozenset({"report"}),
    frozenset({"closing"}),
    frozenset({"checking", "measuring", "rehearsal"}),
    frozenset({"cli"}),
    frozenset({"__main__"}),
)
# Nearer than the floors: two derivations never meet below, and declarations know names only.
NEVER = {
    ("mechanism", "reduction"), ("mechanism", "effects"), ("machine_file", "mechanism"),
    ("observations", "mechanism"), ("prediction", "reduction"), ("machine", "reduction"),
    ("diagnosis", "reduction"), ("control", "reduction"),
}  # fmt: skip
HEAVY = ("pinocchio", "casadi", "matplotlib", "scipy.optimize", "yourdfpy", "joblib", "dask")


def modules() -> list[Path]:
    return sorted(PACKAGE.rglob("*.py"))


def room_of(path: Path) -> str:
    """Module or folder directly in the package."""
    return path.relative_to(PACKAGE).with_suffix("").parts[0]


def imports(path: Path) -> Iterator[str]:
    """Dotted names that a file imports, at its top or within functions; not those for types."""

    def visit(node: ast.AST) -> Iterator[str]:
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            children: list[ast.stmt] | Iterator[ast.AST] = node.orelse
        else:
            children = ast.iter_child_nodes(node)
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports are absolute"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        for child in children:
            yield from visit(child)

    return visit(ast.parse(path.read_text(encoding="utf-8")))


@cache
def edges() -> dict[tuple[str, str], str]:
    """Who imports whom among the rooms, with a file that does."""
    rooms = {room_of(path) for path in modules()}
    found: dict[tuple[str, str], str] = {}
    for path in modules():
        for name in imports(path):
            parts = name.split(".")
            if parts[0] == "orthoglide" and parts[1] in rooms and parts[1] != room_of(path):
                found[room_of(path), parts[1]] = str(path.relative_to(ROOT))
    return found


def floor(room: str) -> int:
    return next((k for k, rooms in enumerate(FLOORS) if room in rooms), len(FLOORS))


def test_every_room_has_its_floor() -> None:
    rooms = {room_of(path) for path in modules()} - {"__init__"}
    assert rooms == frozenset().union(*FLOORS)


def test_imports_go_down() -> None:
    wrong = {
        pair: path
        for pair, path in edges().items()
        if pair[0] != "__init__" and floor(pair[1]) >= floor(pair[0])
    }
    assert not wrong


def test_the_rules_look_at_something() -> None:
    """Edges that must be there: else the parsing is broken and everything passes."""
    assert {("fit", "reduction"), ("comparison", "reduction"), ("closing", "report")} <= set(
        edges()
    )


def test_no_two_files_import_each_other() -> None:
    """Nor in a circle, late imports inside functions included."""
    names = {
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
        for path in modules()
    }
    waiting = {}
    for module, path in names.items():
        found = {n if n in names else n.rpartition(".")[0] for n in imports(path)}
        waiting[module] = (found & set(names)) - {module}
    while free := {module for module, needs in waiting.items() if not needs}:
        waiting = {m: needs - free for m, needs in waiting.items() if m not in free}
    assert not waiting


# What draws a result computes nothing of it: the page, the file and Python cannot differ.
COMPUTING = ("fit", "diagnosis", "planning", "accuracy", "judging", "posterior", "prediction",
             "mechanism", "reduction", "closing")  # fmt: skip


def test_reports_only_draw() -> None:
    wrong = [
        f"{path.relative_to(ROOT)}: {name}"
        for room in ("report", "figures")
        for path in sorted((PACKAGE / room).rglob("*.py"))
        for name in imports(path)
        if name.startswith(("scipy", *(f"orthoglide.{room}" for room in COMPUTING)))
    ]
    assert not wrong


def test_reduction_and_mechanism_know_nothing_of_each_other() -> None:
    assert not {("reduction", "mechanism"), ("mechanism", "reduction")} & set(edges())
    assert not {pair: edges()[pair] for pair in NEVER & set(edges())}


@pytest.mark.parametrize("path", sorted((ROOT / "tests").glob("rig*.py")), ids=lambda p: p.name)
def test_the_independent_machine_is_independent(path: Path) -> None:
    known = {*sys.stdlib_module_names, "numpy", "scipy"}
    found = list(imports(path))
    assert "numpy" in found
    for name in found:
        assert name.split(".")[0] in known or name.startswith("tests.rig"), name


@pytest.mark.parametrize("path", modules(), ids=lambda p: str(p.relative_to(PACKAGE)))
def test_files_stay_readable(path: Path) -> None:
    assert len(path.read_text(encoding="utf-8").splitlines()) <= LONGEST


def fresh(code: str) -> str:
    """What a new interpreter prints."""
    return subprocess.run(
        [sys.executable, "-c", code], check=True, cwd=ROOT, capture_output=True, text=True
    ).stdout


@pytest.mark.parametrize("module", ["orthoglide", "orthoglide.machine_file", "orthoglide.cli"])
def test_nothing_heavy_is_loaded_early(module: str) -> None:
    loaded = fresh(f"import sys, {module}; print(*sys.modules)").split()
    assert module in loaded
    assert not set(HEAVY) & set(loaded)


# What knows that legs lie along base axes, in a cycle: layouts, and what is the Orthoglide's own.
OF_ONE_LAYOUT = {
    "layout/": "where legs stand is said here",
    "geometry.py": "the Orthoglide's legs and named postures, beside the base axes",
    "reduction/": "the papers' own model of the Orthoglide",
    "comparison/": "compares with that model, and refuses other layouts",
    "observations/campaign.py": "dials on legs: an Orthoglide's, relabelled",
    "planning/pool.py": "mountings of dials against legs",
    "report/sheet.py": "the same, said to who mounts them",
    "urdf/solids.py": "boxes of the Orthoglide's drawing keep to the base axes",
    "urdf/tree.py": "a sentence of the Orthoglide's own file, tested letter by letter",
    "control/urdf.py": "the same",
    "effects/wording.py": "the threefold pattern of legs that lie along each other's directions",
}
CYCLIC = re.compile(
    r"\+ *(?:leg|[12])\) *% *3|\brho *- *(?:\w+\.)*L\b|\"xyz\"\[|\(\"x\", \"y\", \"z\"\)"
)


def test_only_layouts_know_where_legs_stand() -> None:
    found = {
        str(path.relative_to(PACKAGE))
        for path in modules()
        if CYCLIC.search(path.read_text(encoding="utf-8"))
    }
    assert {f for f in found if not f.startswith(tuple(OF_ONE_LAYOUT))} == set()
    assert all(any(f.startswith(known) for f in found) or known.endswith("/")
               for known in OF_ONE_LAYOUT)  # fmt: skip


@pytest.mark.parametrize("path", modules(), ids=lambda p: str(p.relative_to(PACKAGE)))
def test_assert_is_for_tests(path: Path) -> None:
    nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    assert not [node.lineno for node in nodes if isinstance(node, ast.Assert)]
