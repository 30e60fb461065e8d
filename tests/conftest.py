# ruff: noqa: E402  (the number of threads must be set before numpy is imported)
"""One thread a worker, and cases that repeat what others show already on demand only."""

import gc
import os

# Before numpy is imported: threads of the linear algebra only get in each other's way here.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

from collections.abc import Iterator
from pathlib import Path

import pytest

import orthoglide as og


@pytest.fixture(scope="session")
def machine() -> og.Machine:
    """The machine that the rig's campaigns were measured on, as its file has it."""
    return og.Machine.load(Path(__file__).parent / "data" / "rig" / "machine.toml")


@pytest.fixture(scope="module", autouse=True)
def _caches_end_with_their_module(request: pytest.FixtureRequest) -> Iterator[None]:
    """Let go of what a module's cached functions hold (verdicts, mostly) after its last test."""
    yield
    for value in vars(request.module).values():
        if getattr(value, "__module__", None) == request.module.__name__:
            getattr(value, "cache_clear", lambda: None)()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--thorough", action="store_true", help="run the cases marked thorough too")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if not config.getoption("--thorough"):
        thorough = {item for item in items if any(_is_thorough(item))}
        config.hook.pytest_deselected(items=list(thorough))
        items[:] = [item for item in items if item not in thorough]
    # Workers take files in this order: a long one that is begun last would run alone.
    size = {path: path.stat().st_size for path in {item.path for item in items}}
    items.sort(key=lambda item: (-size[item.path], item.path))
    # What is loaded by now stays: to look through it for garbage again and again takes seconds.
    gc.collect()
    gc.freeze()


def _is_thorough(item: pytest.Item) -> Iterator[bool]:
    """Return of each mark ``thorough`` whether it is about this case.

    ``thorough(except_for=["id"])`` of a parametrised test leaves the cases of these ids out.
    """
    case = (
        item.callspec.id if isinstance(item, pytest.Function) and hasattr(item, "callspec") else ""
    )
    for mark in item.iter_markers("thorough"):
        yield case not in mark.kwargs.get("except_for", ())
