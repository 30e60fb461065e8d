"""Readings of where the tool is: a plate it touches, distances, a ball bar, an inclination.

Each kind has its own nuisances, which `fit.tool` fits. The setups of a file are mountings of one
instrument each, as those of dials are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from orthoglide.errors import check_word
from orthoglide.frames import html_table
from orthoglide.geometry import Array
from orthoglide.observations.approach import Ints
from orthoglide.observations.arrays import (
    MAYBE_VECTOR,
    NUMBER,
    OF_READINGS,
    WHOLE,
    check_setups,
    hold,
)

Kind = Literal["tcp", "plate", "distance", "ballbar", "incline"]
KINDS: tuple[Kind, ...] = ("tcp", "plate", "distance", "ballbar", "incline")
DIRECTED: tuple[Kind, ...] = ("tcp", "incline")
"""Kinds that read along or about a base axis."""


@dataclass(frozen=True)
class ToolSetup:
    """One mounting of one instrument.

    Attributes:
        name: label, unique within its file.
        kind: of its readings.
    """

    name: str
    kind: Kind

    def __post_init__(self) -> None:
        check_word("kind of reading", self.kind, KINDS)


@dataclass(frozen=True, eq=False)
class ToolCampaign:
    """Readings of the tool, one file's.

    Attributes:
        name: file stem.
        setups: in order of appearance.
        setup: index into ``setups`` ``(n,)``.
        axis: base axis that is read ``(n,)``; 0 where the kind has none.
        sign: +1, or -1 where the instrument counts against it ``(n,)``.
        command: ``(n, 3)``, metres.
        second: the other command of a distance ``(n, 3)``, metres; nan for other kinds.
        approach: direction of each drive's last move ``(n, 3)``; 0 where unknown.
        time: seconds ``(n,)``, nan where not recorded.
        temperature: degrees Celsius ``(n,)``, nan where not recorded.
        load: weight at the tool along base -z ``(n,)``, newtons.
        repeat: number of the repetition ``(n,)``.
        order: place in the sequence ``(n,)``.
        posture: labels for people.
        reading: ``(n,)``, metres, of an inclination radians.
        sigma: declared standard deviation ``(n,)``, nan where none is.
        line: line in the file ``(n,)``.
        file: the file's name as the caller gave it.
        sha256: digest of the file.
        warnings: what was noticed on reading and is no error.
        from_frame: readings from a data frame with the columns of their file.
        to_frame: the rows of their file as a data frame; of a machine file's layout, where that is
            given.
    """

    from_frame: ClassVar[Callable[..., ToolCampaign]]
    to_frame: ClassVar[Callable[..., Any]]

    name: str
    setups: tuple[ToolSetup, ...]
    setup: Ints
    axis: Ints
    sign: Array
    command: Array
    second: Array
    approach: Array
    time: Array
    temperature: Array
    load: Array
    repeat: Ints
    order: Ints
    posture: tuple[str, ...]
    reading: Array
    sigma: Array
    line: Ints
    file: str = ""
    sha256: str = ""
    warnings: tuple[Any, ...] = ()

    def __post_init__(self) -> None:
        hold(self, self.name, _ARRAYS, "reading")
        check_setups(self.name, [s.name for s in self.setups], self.setup)

    def __len__(self) -> int:
        return len(self.reading)

    def __repr__(self) -> str:
        kinds = ", ".join(dict.fromkeys(s.kind for s in self.setups))
        return f"<ToolCampaign {self.name!r}: {len(self)} readings ({kinds})>"

    def _repr_html_(self) -> str:
        columns = {
            "kind": self.kind,
            "setup": [self.setups[k].name for k in self.setup],
            "posture": self.posture,
            "reading, mm or mrad": (self.reading * 1e3).tolist(),
        }
        return html_table(repr(self)[1:-1], columns)

    @property
    def kind(self) -> tuple[Kind, ...]:
        """Of each reading."""
        return tuple(self.setups[k].kind for k in self.setup)

    def of_kind(self, kind: str) -> NDArray[np.bool_]:
        """Which readings are of a kind ``(n,)``, booleans."""
        return np.array([k == kind for k in self.kind], dtype=bool)

    @property
    def temperature_rise(self) -> Array:
        """Against the first recorded ``(n,)``, kelvin; 0 where not recorded."""
        known = self.temperature[np.isfinite(self.temperature)]
        return np.nan_to_num(self.temperature - (known[0] if len(known) else 0.0))


_ARRAYS = {**OF_READINGS, "axis": WHOLE, "sign": NUMBER, "second": MAYBE_VECTOR}
