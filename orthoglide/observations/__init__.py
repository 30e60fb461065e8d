"""What was measured: campaigns of dial readings and TCP points, read from files and checked."""

from orthoglide.observations.approach import Moves, derive_approach
from orthoglide.observations.campaign import Campaign, Setup
from orthoglide.observations.protocols import protocol
from orthoglide.observations.reading import Given, read_campaign
from orthoglide.observations.tcp import TcpPoints, read_tcp, tcp_from_rows
from orthoglide.observations.tool import ToolCampaign, ToolSetup
from orthoglide.observations.tool_reading import Readings, read_readings, readings_from_rows
from orthoglide.observations.tool_writing import tool_rows
from orthoglide.observations.writing import (
    campaign_rows,
    campaign_text,
    csv_text,
    tcp_rows,
    write_campaign,
)
