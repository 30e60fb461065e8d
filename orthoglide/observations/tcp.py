"""TCP points measured by a tracker or a CMM: to judge by, or to fit where that is asked for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from orthoglide.geometry import Array
from orthoglide.observations.campaign import Ints


@dataclass(frozen=True, eq=False)
class TcpPoints:
    """Measured TCP positions, each in the instrument's own frame.

    Attributes:
        command: commanded joint coordinates ``(n, 3)``, metres, r removed.
        p: measured TCP ``(n, 3)``, metres, nan where a coordinate is missing.
        sigma: standard deviation of a coordinate ``(n,)``, metres, nan where none is declared.
        approach: direction of each axis' last move ``(n, 3)``; 0: the middle of the dead band.
        line: line in the file ``(n,)``, header line 1.
        file: the file's name as the caller gave it.
        sha256: digest of the file.
        warnings: what was noticed on reading and is no error.
    """

    command: Array
    p: Array
    sigma: Array
    approach: Array
    line: Ints
    file: str = ""
    sha256: str = ""
    warnings: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.p)

    @property
    def name(self) -> str:
        """Of the file, without its folder and ending."""
        return Path(self.file).stem or "points"
