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


# Files of more than four seconds of processor time, the longest first: workers take files in this
# order, and one that is begun last would run alone.
LONGEST = (
    "test_cli_closing.py", "test_observation_laws.py", "test_blunders.py", "test_field.py",
    "test_report_verdict.py", "test_klipper.py", "test_identification.py", "test_one_station.py",
    "test_unlisted_kinds.py", "test_result.py", "test_cli.py", "test_checking.py",
    "test_tool_readings.py", "test_tool_faults.py", "test_former_files.py", "test_golden.py",
    "test_view.py", "test_delta_owner.py", "test_design.py", "test_report.py",
    "test_controller.py", "test_comparison.py", "test_noise.py",
    "test_readings_not_as_they_seem.py", "test_rehearsal.py", "test_architecture.py",
    "test_benchmarks_public.py", "test_changed.py", "test_firmware.py", "test_weighing.py",
    "test_klipper_owners.py", "test_cli_laws.py", "test_effects.py", "test_hostile_input.py",
    "test_statistics.py", "test_python.py", "test_drawing.py", "test_accuracy.py", "test_docs.py",
    "test_python_input.py", "test_parting.py", "test_pasting.py", "test_examples.py",
    "test_closing.py", "test_fuzz.py", "test_parallelism.py",
)  # fmt: skip


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if not config.getoption("--thorough"):
        thorough = {item for item in items if any(_is_thorough(item))}
        config.hook.pytest_deselected(items=list(thorough))
        items[:] = [item for item in items if item not in thorough]
    place = {name: k for k, name in enumerate(LONGEST)}
    items.sort(key=lambda item: place.get(item.path.name, len(place)))
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
