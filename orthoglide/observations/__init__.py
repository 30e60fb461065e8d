"""What was measured: campaigns of dial readings and TCP points, read from files and checked."""

from orthoglide.observations.campaign import Campaign, Reading, Setup, derive_approach
from orthoglide.observations.tcp import TcpPoints

__all__ = ["Campaign", "Reading", "Setup", "TcpPoints", "derive_approach"]
