"""The Orthoglide's closed-loop kinematics, and its calibration from dial readings.

SI in and out; arrays carry batch axes first: commands rho ``(..., 3)``, points p ``(..., 3)``.
"""

from __future__ import annotations

import ast
import pkgutil
from importlib import import_module
from typing import Any

__version__ = "0.1.0"

# Pinocchio and CasADi take a third of a second to load: names are fetched when they are used. Type
# checkers and this file read them in `__init__.pyi`.
_STUB = ast.parse(pkgutil.get_data(__name__, "__init__.pyi") or b"")
_MODULE = {
    name.name: node.module
    for node in _STUB.body if isinstance(node, ast.ImportFrom) and node.module
    for name in node.names
}  # fmt: skip

__all__ = sorted(_MODULE)


def __getattr__(name: str) -> Any:
    if name not in _MODULE:
        raise AttributeError(f"module 'orthoglide' has no attribute {name!r}")
    return getattr(import_module(_MODULE[name]), name)


def __dir__() -> list[str]:
    return list(__all__)
