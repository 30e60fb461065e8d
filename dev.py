"""Everything a developer runs, on a machine with nothing but Python: see ``python3 dev.py --help``.

Standard library only. Makes ``.venv`` beside this file at the first run, installs the package there
and keeps it while pyproject.toml stays as it is.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent
VENV = ROOT / ".venv"
STAMP = VENV / "dev-stamp.json"
COMPILED = VENV / "compiled"  # what Python keeps of the files it runs in tests
NEEDED = (3, 11)
# Test files that need more than the extra "test": other programs that read or move the machine.
FURTHER = {
    "test_mujoco.py": "engines",
    "test_symbolic.py": "engines",
    "test_urdf.py": "engines",
    "test_rehearsal.py": "dask",
    "test_view.py": "viewer",
}


def main() -> int:
    """Run one task; its exit code is the task's own."""
    if sys.version_info < NEEDED:
        found = ".".join(map(str, sys.version_info[:3]))
        raise SystemExit(
            f"dev.py needs Python {NEEDED[0]}.{NEEDED[1]} or newer and this is {found}: "
            f"run it with a newer python3"
        )
    parser = argparse.ArgumentParser(
        prog="dev.py",
        description="Run the demo, the tests and the checks; makes .venv when it is missing.",
        epilog="What follows the task is handed on: dev.py test -k closure.",
    )
    tasks = {
        "demo": demo, "test": test, "lint": lint, "docs": docs, "check": check, "bench": bench,
        "mutate": mutate,
    }  # fmt: skip
    parser.add_argument("task", choices=tasks, help=", ".join(f"{n}: {hint(t)}" for n, t in
                                                               tasks.items()))  # fmt: skip
    parser.add_argument("rest", nargs=argparse.REMAINDER, metavar="...", help="for the task")
    asked = parser.parse_args()
    return int(tasks[asked.task](asked.rest))


def hint(task: object) -> str:
    """What a task does, from its docstring."""
    first = (task.__doc__ or "").splitlines()[0].rstrip(".")
    return first[:1].lower() + first[1:]


def demo(rest: list[str]) -> int:
    """Calibrate a machine with a known fault and the published one; write a report of each."""
    environment()
    out = next_free("demo")
    if not rest:
        if out.name != "demo-out":
            print(f"demo-out is there already and is kept: writing to {out.name}", flush=True)
        rest = ["--out", str(out)]
    code = python("-m", "orthoglide", "demo", *rest, cwd=Path.cwd())
    reports = [out / name / "report.html" for name in ("simulated", "published")]
    if code == 0 and reports[0].is_file():
        print("\nOpen these in a browser, the first to see a fault that was found:")
        print("\n".join(report.as_uri() for report in reports))
    return code


def test(rest: list[str]) -> int:
    """Run the tests, or those of the files named: test --thorough, test tests/test_rig.py."""
    environment("test", *further(rest))
    # Whatever the shell says of it: else each worker compiles and rewrites two hundred files anew.
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    command = [str(interpreter()), "-m", "pytest", *rest]
    return subprocess.call(command, cwd=ROOT, env={**kept, "PYTHONPYCACHEPREFIX": str(COMPILED)})


def further(words: list[str]) -> set[str]:
    """Return the extras of the test files named among the words; of all files if none is named."""
    named = [Path(word.partition("::")[0]) for word in words]
    files = [path.name for path in named if path.suffix == ".py"]
    return {FURTHER[name] for name in files or FURTHER if name in FURTHER}


def lint(rest: list[str]) -> int:
    """Look at style and types with ruff and mypy."""
    environment("lint")
    checks = (["ruff", "check"], ["ruff", "format", "--check"], ["mypy"], ["mypy", "dev.py"])
    return max(python("-m", *words, *rest) for words in checks)


def docs(rest: list[str]) -> int:
    """Build the site of the documents in site-out, or in the folder named; links are checked."""
    environment("docs")
    return python(str(ROOT / "docs" / "site" / "build.py"), *rest)


def check(rest: list[str]) -> int:
    """Lint, build the site, then test."""
    return lint([]) or docs([]) or test(rest)


def bench(rest: list[str]) -> int:
    """Run the benchmark of speed, or the one named: bench scale."""
    environment("test", "engines")
    path = ROOT / "benchmarks" / f"{Path((rest or ['closure'])[0]).stem}.py"
    if not path.is_file():
        known = ", ".join(sorted(p.stem for p in path.parent.glob("*.py")))
        raise SystemExit(f"there is no benchmark {path.stem}: it is one of {known}")
    return python(str(path), *rest[1:])


def mutate(rest: list[str]) -> int:
    """Break lines that tests guard, one at a time, and see them fail: mutate noise."""
    listed = tomllib.loads((ROOT / "tests" / "mutants.toml").read_text(encoding="utf-8"))["mutant"]
    chosen = [m for m in listed if all(word in m["name"] for word in rest)]
    if not chosen:
        raise SystemExit(f"no mutant has {' '.join(rest)} in its name: see tests/mutants.toml")
    guards = list(dict.fromkeys(test for m in chosen for test in m["tests"]))
    environment("test", *further(guards))
    if python("-m", "pytest", "-q", "-n", "0", "--thorough", *guards):
        raise SystemExit("the tests that guard these lines fail already: mend them first")
    survivors = [m["name"] for m in chosen if not killed(m)]
    print(f"{len(chosen) - len(survivors)} of {len(chosen)} mutants were seen")
    return 1 if survivors else 0


def killed(mutant: dict[str, Any]) -> bool:
    """Whether a mutant's tests fail on a copy that is broken so."""
    with tempfile.TemporaryDirectory() as place:
        copy = Path(place)
        for name in ("orthoglide", "tests", "urdf"):
            shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
        shutil.copy(ROOT / "pyproject.toml", copy)
        target = copy / mutant["file"]
        text = target.read_text(encoding="utf-8")
        if text.count(mutant["old"]) != 1:
            raise SystemExit(f"{mutant['file']} has not one line {mutant['old']!r}: mend the list")
        target.write_text(text.replace(mutant["old"], mutant["new"]), encoding="utf-8")
        ask = [str(interpreter()), "-m", "pytest", "-x", "-q", "-n", "0", "--thorough"]
        ask += mutant["tests"]
        paths = {**os.environ, "PYTHONPATH": str(copy)}
        seen = subprocess.call(ask, cwd=copy, env=paths, stdout=subprocess.DEVNULL) == 1
    print(f"{'seen' if seen else 'SURVIVED'}: {mutant['name']}", flush=True)
    return seen


def python(*words: str, cwd: Path = ROOT) -> int:
    """Run the environment's Python, in the project's folder unless told otherwise."""
    return subprocess.call([str(interpreter()), *words], cwd=cwd)


def interpreter() -> Path:
    """The Python of the environment."""
    return VENV / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


def next_free(name: str) -> Path:
    """A folder for results that is not there yet: ``name-out``, ``name-2-out``, ..."""
    folder, number = ROOT / f"{name}-out", 1
    while folder.exists():
        number += 1
        folder = ROOT / f"{name}-{number}-out"
    return folder


def environment(*extras: str) -> None:
    """Make .venv and install the package with ``extras``, unless that is done already."""
    have = installed()
    if have is not None and set(extras) <= set(have):
        return
    wanted = sorted({*extras, *(have or ())})
    if not works("pip"):
        make_venv()
    what = f"{ROOT}[{','.join(wanted)}]" if wanted else str(ROOT)
    print(f"installing the package{' with ' + ', '.join(wanted) if wanted else ''} into "
          f"{VENV} (once)", flush=True)  # fmt: skip
    options = ["--quiet", "--disable-pip-version-check", "--no-input"]
    if python("-m", "pip", "install", *options, "--editable", what):
        raise SystemExit("pip could not install what is needed: see above, mend it and run again")
    STAMP.write_text(json.dumps({"key": key(), "extras": wanted}) + "\n", encoding="utf-8")


def installed() -> list[str] | None:
    """The extras that .venv has; None where it is missing or out of date."""
    try:
        stamp = json.loads(STAMP.read_text(encoding="utf-8"))
        current = stamp["key"] == key() and interpreter().exists()
        return list(stamp["extras"]) if current else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def key() -> str:
    """Changes with pyproject.toml, with the folder and with the version of Python."""
    content = (ROOT / "pyproject.toml").read_bytes()
    place = f"{ROOT} {sys.version_info[:2]}".encode()
    return hashlib.sha256(content + place).hexdigest()


def works(module: str) -> bool:
    """Whether .venv has a Python of this version that can import a module."""
    if not interpreter().exists():
        return False
    code = f"import {module}, sys; sys.exit(sys.version_info[:2] != {tuple(sys.version_info[:2])})"
    return subprocess.call([str(interpreter()), "-c", code], stderr=subprocess.DEVNULL) == 0


def make_venv() -> None:
    """Make .venv; on Debian the part of Python that does so may be missing, and is installed."""
    if VENV.exists() and not (VENV / "pyvenv.cfg").is_file():
        raise SystemExit(f"{VENV} is there and is no environment: move it away and run again")
    if not can_make_venv():
        install_venv_module()
    print(f"making {VENV}", flush=True)
    # A new process, as what has just been installed is not seen by this one.
    if subprocess.call([sys.executable, "-m", "venv", "--clear", str(VENV)]):
        raise SystemExit(f"{VENV} could not be made: see above")


def can_make_venv() -> bool:
    """Whether this Python has venv and ensurepip."""
    importlib.invalidate_caches()
    return all(importlib.util.find_spec(name) for name in ("venv", "ensurepip"))


def install_venv_module() -> None:
    """Debian's python3-venv, by root; anybody else is told."""
    remedy = (
        "Python lacks ensurepip: install it (Debian: apt-get install python3-venv) and run again"
    )
    root = getattr(os, "geteuid", lambda: 1)() == 0
    if not (root and shutil.which("apt-get")):
        raise SystemExit(remedy)
    quiet = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    for words in (["update", "-qq"], ["install", "-y", "-qq", "python3-venv"]):
        print("apt-get", *words, flush=True)
        if subprocess.call(["apt-get", *words], env=quiet):
            raise SystemExit(remedy)
    if not can_make_venv():
        raise SystemExit(remedy)


if __name__ == "__main__":
    sys.exit(main())
