"""Progress of a long computation: steps with a stage and a detail."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

Stage = Literal[
    "computing", "identifying", "faults", "searching", "comparing", "testing",
    "verifying", "judging", "suggesting", "drawing", "writing",
]  # fmt: skip

_STAGES: Mapping[Stage, tuple[str, int]] = {
    "computing": ("", 0),  # the detail says what
    "identifying": ("identifying", 8),
    "faults": ("looking for faults of the data", 20),
    "searching": ("searching for causes", 30),
    "comparing": ("comparing", 50),
    "testing": ("testing the residual", 62),
    "verifying": ("closing every posture once more with Pinocchio", 64),
    "judging": ("judging", 66),
    "suggesting": ("choosing what to measure next", 70),
    "drawing": ("drawing", 78),
    "writing": ("writing the report", 94),
}


@dataclass(frozen=True)
class Step:
    """The step that begins now."""

    stage: Stage  # stage of the computation; stages may repeat
    detail: str = ""  # item within the stage, such as the name of a candidate
    done: float | None = None  # per cent of the computation that is done, if counted

    def __str__(self) -> str:
        return f"{_STAGES[self.stage][0]} {self.detail}".strip()

    @property
    def percent(self) -> float:
        """Per cent of the computation that is done: counted, or estimated by the stage."""
        return _STAGES[self.stage][1] if self.done is None else self.done


Progress = Callable[[Step], None]
"""Called with each step as it begins; any callable will do, `print` too."""


def no_progress(_: Step) -> None:
    """Show nothing."""
