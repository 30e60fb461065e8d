"""What is done stays done: faults of the program, rivals for a name, damaged caches."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import pytest

from orthoglide import files
from orthoglide.errors import FileError
from orthoglide.files import write_files
from orthoglide.mechanism.compiled import compiler
from orthoglide.report import folder, write_folder
from tests.test_cli import EXPERIMENT_2, run

ROOT = Path(__file__).parents[1]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of one's own with the published campaign, to work in."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "c.csv").write_text(EXPERIMENT_2)
    return tmp_path


@pytest.mark.parametrize("name", ["summary", "report_files"])
def test_what_is_shown_is_made_before_the_folder_appears(
    name: str, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise ValueError("a fault")

    monkeypatch.setattr(f"orthoglide.report.{name}", fail)
    result = run("identify", "c.csv", "--out", "out")
    assert result.exit_code == 3
    assert "failed unexpectedly (ValueError: a fault)" in result.stderr
    assert "Traceback" not in result.output
    assert os.listdir(here) == ["c.csv"]


@pytest.mark.parametrize("error", [ZeroDivisionError("0"), MemoryError(), OverflowError("1")])
def test_failing_arithmetic_is_failed_numerics(
    error: Exception, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("orthoglide.closing.loop.identify", fail)
    result = run("identify", "c.csv", "--out", "out")
    assert result.exit_code == 3
    assert "the numerics failed" in result.stderr
    assert result.stderr.splitlines()[-1].startswith("orthoglide: ")
    monkeypatch.setenv("ORTHOGLIDE_TRACEBACK", "1")
    assert run("identify", "c.csv", "--out", "out").exception is error


# --- Rivals for a name --------------------------------------------------------------------------


def before_it_appears(monkeypatch: pytest.MonkeyPatch, module: Any, act: Callable[[], Any]) -> None:
    """Have another process act between a file's or folder's last check and its appearance."""
    put = module._move_into_place

    def later(*arguments: Any) -> None:
        act()
        put(*arguments)

    monkeypatch.setattr(module, "_move_into_place", later)


def test_a_file_that_another_process_wrote_meanwhile_stands(
    here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before_it_appears(monkeypatch, files, lambda: (here / "b.csv").write_text("theirs"))
    with pytest.raises(FileError, match=r"b\.csv: exists and is not overwritten"):
        write_files({here / "a.csv": "ours", here / "b.csv": "ours"})
    assert (here / "b.csv").read_text() == "theirs"
    assert sorted(os.listdir(here)) == ["b.csv", "c.csv"]


def test_so_it_does_where_there_are_no_hard_links(
    here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "link", none)
    write_files({here / "a.csv": "ours"})
    assert (here / "a.csv").read_text() == "ours"
    monkeypatch.setattr("orthoglide.files.check_new", lambda _: None)
    with pytest.raises(FileError, match="exists and is not overwritten"):
        write_files({here / "a.csv": "again"})
    assert (here / "a.csv").read_text() == "ours"
    assert sorted(os.listdir(here)) == ["a.csv", "c.csv"]


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_folder_that_another_process_wrote_meanwhile_stands(
    overwrite: bool, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def theirs() -> None:
        (here / "out").mkdir()
        (here / "out" / "result.json").write_text("theirs")

    before_it_appears(monkeypatch, folder, theirs)
    if overwrite:  # an earlier report may be replaced, whoever wrote it
        write_folder(here / "out", {"result.json": "ours"}, True)
    else:
        with pytest.raises(FileError, match="not empty"):
            write_folder(here / "out", {"result.json": "ours"})
    expected = "ours" if overwrite else "theirs"
    assert (here / "out" / "result.json").read_text() == expected
    assert sorted(os.listdir(here)) == ["c.csv", "out"]


# --- The cache of compiled functions ------------------------------------------------------------

BUILD = """
import casadi as ca
from orthoglide.mechanism.compiled import compiled
x = ca.SX.sym("x")
square = ca.Function("square", [x], [x**2])
found = compiled(["square"], "square", (lambda: [square]) if {build} else None)
print(None if found is None else float(found[0](3)))
"""


def built(cache: Path, build: bool = True) -> str:
    child = subprocess.run(
        [sys.executable, "-c", BUILD.format(build=build)],
        env={**os.environ, "PYTHONPATH": str(ROOT), "ORTHOGLIDE_CACHE": str(cache)},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert child.returncode == 0, child.stderr
    return child.stdout.strip()


@pytest.mark.thorough
@pytest.mark.skipif(compiler() is None, reason="there is no C compiler")
def test_a_damaged_compiled_function_is_never_loaded(tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    assert built(cache, build=False) == "None"
    assert built(cache) == "9.0"
    (library,) = cache.iterdir()
    assert built(cache, build=False) == "9.0"
    for content in (library.read_bytes()[:4096], b"", b"\x7fELF" + bytes(8000)):
        library.write_bytes(content)
        assert built(cache, build=False) == "None"
        assert not library.exists()
        assert built(cache) == "9.0"


@pytest.mark.skipif(compiler() is None, reason="there is no C compiler")
def test_the_cache_is_nobody_elses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from orthoglide.mechanism import compiled

    cache = tmp_path / "cache"
    monkeypatch.setenv("ORTHOGLIDE_CACHE", str(cache))
    assert compiled._cache_folder() == cache
    assert cache.stat().st_mode & 0o077 == 0
    cache.chmod(0o777)
    compiled._cache_folder()
    assert cache.stat().st_mode & 0o022 == 0
    own = os.getuid()
    monkeypatch.setattr(os, "getuid", lambda: own + 1)
    with pytest.raises(PermissionError):
        compiled._cache_folder()
    assert compiled.compiled(["f"], "f", lambda: []) is None


@pytest.mark.skipif(compiler() is None, reason="there is no C compiler")
def test_another_kind_of_computer_has_a_library_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Compiled for one processor's instructions, code can be wrong for another: a shared cache."""
    from orthoglide.mechanism import compiled

    monkeypatch.setenv("ORTHOGLIDE_CACHE", str(tmp_path))
    x = ca.SX.sym("x")

    def made(build: bool) -> Path | None:
        return compiled.library("f", (lambda: [ca.Function("f", [x], [x])]) if build else None)

    own = made(build=True)
    assert own is not None
    assert made(build=False) == own
    assert "#define __" in compiled._compiler_target(str(compiler()))
    monkeypatch.setattr(compiled, "_compiler_target", lambda *_: "#define __of_another_kind__ 1")
    assert made(build=False) is None
    assert made(build=True) not in (None, own)


@pytest.mark.parametrize("name", ["../theirs.csv", "a/../../theirs.csv", "/theirs.csv"])
def test_a_folder_holds_what_is_written_into_it(name: str, here: Path) -> None:
    with pytest.raises(FileError, match="must be a place within"):
        write_folder(here / "out", {"a.csv": "", name: "ours"})
    assert os.listdir(here) == ["c.csv"]


@pytest.mark.parametrize(
    ("command", "what"),
    [
        (("rerun", "{}"), "result"),
        (("check", "{}", "c.csv"), "result"),
        (("check", "c.csv", "{}"), "result"),
        (("forward", "1", "2", "3", "--machine", "{}"), "calibrated machine"),
    ],
)
def test_a_folder_without_a_result_is_answered_by_its_own_name(
    command: tuple[str, ...], what: str, here: Path
) -> None:
    """The answer named a file in it, of which the user had never heard."""
    (here / "empty").mkdir()
    for name in ("one", "two"):
        (here / "all" / name).mkdir(parents=True)
        for file in ("result.json", "calibrated.toml"):
            (here / "all" / name / file).write_text("")

    def told(folder: str) -> str:
        result = run(*(word.format(folder) for word in command))
        assert result.exit_code == 2
        return result.stderr.strip()

    start = "orthoglide: {}: this folder holds no " + f"{what}: give "
    assert told("empty").startswith(start.format("empty"))
    assert "close-loop" in told("empty")
    assert told("all") == f"{start.format('all')}{Path('all', 'one')} or {Path('all', 'two')}"
