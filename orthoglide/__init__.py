"""The Orthoglide's closed-loop kinematics, and its calibration from dial readings.

SI in and out; arrays carry batch axes first: commands rho ``(..., 3)``, points p ``(..., 3)``.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from orthoglide.closing import Verdict, close_loop
    from orthoglide.errors import (
        ClosureError,
        CrossCheckError,
        FileError,
        InputError,
        NumericsError,
        OrthoglideError,
        SolverError,
        UnidentifiableError,
        UnreachableError,
    )
    from orthoglide.fit import Estimate, identify
    from orthoglide.geometry import Geometry
    from orthoglide.machine import Machine, Pose
    from orthoglide.mechanism import Mechanism
    from orthoglide.observations import (
        Campaign,
        Setup,
        TcpPoints,
        read_campaign,
        read_tcp,
        write_campaign,
    )

__version__ = "0.1.0"

# Pinocchio and CasADi take a third of a second to load: names are fetched when they are used.
_WHERE = {
    "closing": ("Verdict", "close_loop"),
    "errors": (
        "ClosureError", "CrossCheckError", "FileError", "InputError", "NumericsError",
        "OrthoglideError", "SolverError", "UnidentifiableError", "UnreachableError",
    ),
    "geometry": ("Geometry",),
    "fit": ("Estimate", "identify"),
    "machine": ("Machine", "Pose"),
    "mechanism": ("Mechanism",),
    "observations": (
        "Campaign", "Setup", "TcpPoints", "read_campaign", "read_tcp", "write_campaign",
    ),
}  # fmt: skip
_MODULE = {name: module for module, names in _WHERE.items() for name in names}

__all__ = [
    "Campaign",
    "ClosureError",
    "CrossCheckError",
    "Estimate",
    "FileError",
    "Geometry",
    "InputError",
    "Machine",
    "Mechanism",
    "NumericsError",
    "OrthoglideError",
    "Pose",
    "Setup",
    "SolverError",
    "TcpPoints",
    "UnidentifiableError",
    "UnreachableError",
    "Verdict",
    "close_loop",
    "identify",
    "read_campaign",
    "read_tcp",
    "write_campaign",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULE:
        raise AttributeError(f"module 'orthoglide' has no attribute {name!r}")
    return getattr(import_module(f"orthoglide.{_MODULE[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
