"""The architecture as tests: who may import whom, how large a file may be, what loads when."""

import ast
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "orthoglide"
LONGEST = 400
LONGEST_FUNCTION = 60

# A part (module or folder) may import from the layers below its own, never from beside or above.
LAYERS: tuple[frozenset[str], ...] = (
    frozenset({"notes", "ordering", "parameters", "progress", "text", "threads", "units"}),
    frozenset({"errors"}),
    frozenset({"arguments"}),
    frozenset({"add_ons", "layout"}),
    frozenset({"geometry", "files", "foreign", "frames", "numerals"}),
    frozenset({"reduction", "urdf", "effects", "scene"}),
    frozenset({"instruments"}),
    frozenset({"mechanism", "machine_file"}),
    frozenset({"observations"}),
    frozenset({"prediction"}),
    frozenset({"viewer"}),
    frozenset({"machine"}),
    frozenset({"accuracy", "as_pinocchio", "transmission"}),
    frozenset({"control", "pictures"}),
    frozenset({"result"}),
    frozenset({"figures"}),
    frozenset({"fit", "comparison", "firmware", "report"}),
    frozenset({"explanation", "simulation"}),
    frozenset({"planning"}),
    frozenset({"closing"}),
    frozenset({"verdict"}),
    frozenset({"checking", "measuring", "rehearsal"}),
    frozenset({"cli"}),
    frozenset({"__main__"}),
)
# Finer than the layers: two derivations never meet below, and declarations know names only.
NEVER = {
    ("mechanism", "reduction"), ("mechanism", "effects"), ("machine_file", "mechanism"),
    ("observations", "mechanism"), ("prediction", "reduction"), ("machine", "reduction"),
    ("explanation", "reduction"), ("control", "reduction"),
}  # fmt: skip
HEAVY = ("pinocchio", "casadi", "scipy.optimize", "meshcat", "joblib", "dask")


def modules() -> list[Path]:
    return sorted(PACKAGE.rglob("*.py"))


@cache
def nodes(path: Path) -> tuple[ast.AST, ...]:
    """All nodes of a file's syntax tree, outer ones before inner ones."""
    return tuple(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))


def part_of(path: Path) -> str:
    """Module or folder directly in the package."""
    return path.relative_to(PACKAGE).with_suffix("").parts[0]


@cache
def imports(path: Path, types: bool = False) -> tuple[str, ...]:
    """Dotted names that a file imports, within functions too, and for types if asked."""

    found: list[str] = []
    for_types = set[ast.AST]()
    for node in nodes(path):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test) and not types:
            for_types |= {inner for statement in node.body for inner in ast.walk(statement)}
        elif isinstance(node, ast.Import) and node not in for_types:
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node not in for_types:
            assert node.level == 0, f"{path}: imports are absolute"
            found += [f"{node.module}.{alias.name}" for alias in node.names]
    return tuple(found)


@cache
def edges(types: bool = False) -> dict[tuple[str, str], str]:
    """Who imports whom among the parts, with a file that does; for types too if asked."""
    parts = {part_of(path) for path in modules()}
    found: dict[tuple[str, str], str] = {}
    for path in modules():
        for name in imports(path, types):
            package, other = [*name.split("."), ""][:2]
            if package == "orthoglide" and other in parts and other != part_of(path):
                found[part_of(path), other] = str(path.relative_to(ROOT))
    return found


def layer(part: str) -> int:
    return next((k for k, parts in enumerate(LAYERS) if part in parts), len(LAYERS))


def test_every_part_has_its_layer() -> None:
    parts = {part_of(path) for path in modules()} - {"__init__"}
    assert parts == frozenset().union(*LAYERS)


def test_imports_go_down() -> None:
    up = {
        pair: path
        for pair, path in edges(types=True).items()
        if pair[0] != "__init__" and layer(pair[1]) >= layer(pair[0])
    }
    assert not up


def test_the_rules_look_at_something() -> None:
    """Edges that must be there: else the parsing is broken and everything passes."""
    assert {("fit", "reduction"), ("comparison", "reduction"), ("verdict", "report")} <= set(
        edges()
    )


def test_no_two_files_import_each_other() -> None:
    """Nor in a circle, late imports inside functions and those for types included."""
    names = {
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
        for path in modules()
    }
    waiting = {}
    for module, path in names.items():
        found = {n if n in names else n.rpartition(".")[0] for n in imports(path, types=True)}
        waiting[module] = (found & set(names)) - {module}
    while free := {module for module, needs in waiting.items() if not needs}:
        waiting = {m: needs - free for m, needs in waiting.items() if m not in free}
    assert not waiting


# Where the name of a firmware may stand outside `firmware/`: its command, and its Python functions.
NAMES_FIRMWARE = {"foreign.py", "__init__.pyi", "cli/machines.py"}
_FIRMWARE = re.compile("klipper|reprap|smoothie|marlin|rrf", re.IGNORECASE)


def test_only_commands_name_a_firmware() -> None:
    """Everything else asks through `add_ons`; texts, keys and templates count too."""
    suffixes = (".py", ".pyi", ".j2", ".toml", ".js", ".css")
    every = [p for p in PACKAGE.rglob("*") if p.suffix in suffixes]
    found = {
        str(path.relative_to(PACKAGE))
        for path in every
        if part_of(path) != "firmware" and _FIRMWARE.search(path.read_text(encoding="utf-8"))
    }
    assert found == NAMES_FIRMWARE


# What draws a result computes nothing of it: the page, the file and Python cannot differ.
COMPUTING = ("fit", "planning", "accuracy", "explanation",
             "prediction", "mechanism", "reduction", "closing")  # fmt: skip


def test_reports_only_draw() -> None:
    wrong = [
        f"{path.relative_to(ROOT)}: {name}"
        for part in ("report", "figures")
        for path in sorted((PACKAGE / part).rglob("*.py"))
        for name in imports(path)
        if name.startswith(("scipy", *(f"orthoglide.{part}" for part in COMPUTING)))
    ]
    assert not wrong


def test_reduction_and_mechanism_know_nothing_of_each_other() -> None:
    assert not {("reduction", "mechanism"), ("mechanism", "reduction")} & set(edges())
    assert not NEVER & set(edges(types=True))


# What is found is put into a result, and all else reads that: the search may be replaced.
SEARCH = ("explanation", "closing")
APART_FROM_THE_SEARCH = (
    "result", "report", "figures", "control", "comparison", "firmware", "cli",
)  # fmt: skip


def imports_of_the_search(part: str) -> list[str]:
    """Return what the files of a part import of the search, or of a module inside `fit`, for types
    and within functions too.
    """
    inside = {".".join(p.relative_to(ROOT).with_suffix("").parts) for p in modules()}
    inside = {module for module in inside if module.startswith("orthoglide.fit.")}
    search = {f"orthoglide.{one}" for one in SEARCH} | inside
    return [
        f"{path.relative_to(ROOT)}: {name}"
        for path in modules()
        if part_of(path) == part
        for name in imports(path, types=True)
        if {".".join(name.split(".")[:k]) for k in (2, 3)} & search
    ]


@pytest.mark.parametrize("part", APART_FROM_THE_SEARCH)
def test_who_reads_a_result_knows_nothing_of_the_search(part: str) -> None:
    assert not imports_of_the_search(part)
    # Nor by way of the package's own names, which are fetched when they are used, or of others.
    parts = {part_of(path) for path in modules()} | {"__version__"}
    for path in modules():
        if part_of(path) == part:
            named = [n.split(".") for n in imports(path, types=True)]
            assert all(n[1:] and n[1] in parts for n in named if n[0] == "orthoglide"), path


def test_the_search_is_looked_for_where_it_is() -> None:
    found = " ".join(imports_of_the_search("closing"))
    assert all(f": orthoglide.{one}." in found for one in ("explanation", "fit"))


def test_nothing_of_the_search_is_loaded_with_what_reads_results() -> None:
    parts = ("result", "report", "control", "comparison")
    loaded = fresh(
        f"import sys, {', '.join(f'orthoglide.{p}' for p in parts)}; print(*sys.modules)"
    )
    assert {f"orthoglide.{part}" for part in parts} <= set(loaded.split())
    assert not {f"orthoglide.{one}" for one in SEARCH} & set(loaded.split())


@pytest.mark.parametrize("path", sorted((ROOT / "tests").glob("rig*.py")), ids=lambda p: p.name)
def test_the_independent_machine_is_independent(path: Path) -> None:
    known = {*sys.stdlib_module_names, "numpy", "scipy"}
    found = imports(path)
    assert "numpy" in found
    for name in found:
        assert name.split(".")[0] in known or name.startswith("tests.rig"), name


def test_files_and_functions_stay_readable() -> None:
    long = {}
    for path in modules():
        text, name = path.read_text(encoding="utf-8"), str(path.relative_to(PACKAGE))
        if (lines := len(text.splitlines())) > LONGEST:
            long[name] = lines
        for node in nodes(path):
            if isinstance(node, ast.FunctionDef) and node.end_lineno is not None:
                lines = node.end_lineno - node.lineno + 1
                if lines > LONGEST_FUNCTION:
                    long[f"{name}:{node.name}"] = lines
    assert not long


def test_nothing_cuts_names_of_parameters_apart() -> None:
    """A `Parameter` carries its parts; what is parsed is parsed where names are."""
    cuts = re.compile(r"partition\(.[.@].\)|split\(.[.@].\)")
    parsing = {PACKAGE / "parameters.py", *(PACKAGE / "effects").glob("*.py")}
    found = {path for path in modules() if cuts.search(path.read_text(encoding="utf-8"))}
    assert found & parsing
    assert not found - parsing


def fresh(code: str) -> str:
    """What a new interpreter prints."""
    return subprocess.run(
        [sys.executable, "-c", code], check=True, cwd=ROOT, capture_output=True, text=True
    ).stdout


def test_nothing_heavy_is_loaded_early() -> None:
    modules = ("orthoglide", "orthoglide.machine_file", "orthoglide.cli")
    loaded = fresh(f"import sys, {', '.join(modules)}; print(*sys.modules)").split()
    assert set(modules) <= set(loaded)
    assert not set(HEAVY) & set(loaded)


def test_assert_is_for_tests() -> None:
    found = [
        f"{path.relative_to(PACKAGE)}:{node.lineno}"
        for path in modules()
        for node in nodes(path)
        if isinstance(node, ast.Assert)
    ]
    assert not found


# Kinds of readings are told apart by what their observations say of themselves, not by name.
KNOW_KINDS = ("instruments", "observations")


def test_no_other_module_tests_the_kind_of_a_reading() -> None:
    from orthoglide.instruments import OBSERVATIONS

    classes = {type(one).__name__ for one in OBSERVATIONS.values()}

    def named(node: ast.AST) -> bool:
        """Whether an expression is a kind: its name, or that of its class."""
        if isinstance(node, ast.Constant):
            return node.value in OBSERVATIONS
        return isinstance(node, ast.Attribute) and ast.unparse(node.value) in classes

    def tests_a_kind(node: ast.AST) -> bool:
        if isinstance(node, ast.Compare):
            parts = [node.left, *node.comparators]
            parts += [
                e for p in parts if isinstance(p, ast.Tuple | ast.List | ast.Set) for e in p.elts
            ]
            return any(named(part) for part in parts)
        called = isinstance(node, ast.Call) and ast.unparse(node.func) == "isinstance"
        return called and any(name in ast.unparse(node).split(",", 1)[1] for name in classes)

    found = [
        f"{path.relative_to(ROOT)}:{node.lineno}: {ast.unparse(node)}"
        for path in modules()
        if part_of(path) not in KNOW_KINDS
        for node in nodes(path)
        if tests_a_kind(node)
    ]
    assert not found


# Where files of the command line, parts of a drawing or groups of effects have the same word.
OTHER_MEANINGS = {
    "effects/effect.py", "effects/plates.py", "pictures.py",
    "report/page.py", "result/request.py", "scene/drawing.py",
    "scene/parts.py",
    "firmware/klipper/heights.py",
}  # fmt: skip


def test_nobody_else_knows_an_instrument_by_name() -> None:
    from orthoglide.instruments import TOOL_OBSERVATIONS

    found = {
        str(path.relative_to(PACKAGE))
        for path in modules()
        if path.parent != PACKAGE / "instruments"
        for node in nodes(path)
        if isinstance(node, ast.Constant) and node.value in TOOL_OBSERVATIONS
    }
    assert found == OTHER_MEANINGS


def test_no_effect_is_known_by_name_outside_its_declaration() -> None:
    from orthoglide.effects import CATALOGUE

    found = []
    for path in modules():
        if path.parent.name == "effects":
            continue
        # A bare string is a docstring.
        bare = {id(node.value) for node in nodes(path) if isinstance(node, ast.Expr)}
        for node in nodes(path):
            text = isinstance(node, ast.Constant) and isinstance(node.value, str)
            if text and id(node) not in bare:
                words = set(re.findall(r"\w+", node.value)) & set(CATALOGUE)
                found += [f"{path.relative_to(PACKAGE)}:{node.lineno}: {word}" for word in words]
    # "backlash" is also a number that a controller holds, as "zero" and "scale" are.
    found = [f for f in found if not (f.startswith("control/") and f.endswith(": backlash"))]
    assert not found
