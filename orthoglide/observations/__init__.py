"""What was measured: campaigns of dial readings and TCP points, read from files and checked."""

from orthoglide.observations.campaign import (
    CONDITIONS,
    Campaign,
    Reading,
    Setup,
    derive_approach,
)
from orthoglide.observations.protocols import protocol
from orthoglide.observations.reading import Given, as_campaigns, read_campaign, read_tcp
from orthoglide.observations.tcp import TcpPoints
from orthoglide.observations.writing import campaign_text, write_campaign, write_protocol

__all__ = [
    "CONDITIONS",
    "Campaign",
    "Given",
    "Reading",
    "Setup",
    "TcpPoints",
    "as_campaigns",
    "campaign_text",
    "derive_approach",
    "protocol",
    "read_campaign",
    "read_tcp",
    "write_campaign",
    "write_protocol",
]
