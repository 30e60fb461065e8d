"""What was measured: campaigns of dial readings and TCP points, read from files and checked."""

from orthoglide.observations.approach import Moves as Moves, derive_approach as derive_approach
from orthoglide.observations.arrays import Recorded as Recorded, source as source
from orthoglide.observations.campaign import Campaign as Campaign, Setup as Setup
from orthoglide.observations.exchange import (
    check_given as check_given,
    in_sequence as in_sequence,
    readings_rows as readings_rows,
    readings_text as readings_text,
    write_campaign as write_campaign,
)
from orthoglide.observations.protocols import protocol as protocol
from orthoglide.observations.reading import Given as Given, read_campaign as read_campaign
from orthoglide.observations.tcp import (
    TcpPoints as TcpPoints,
    read_tcp as read_tcp,
    tcp_from_rows as tcp_from_rows,
)
from orthoglide.observations.tool import ToolCampaign as ToolCampaign, ToolSetup as ToolSetup
from orthoglide.observations.tool_reading import (
    Readings as Readings,
    read_readings as read_readings,
    readings_from_rows as readings_from_rows,
)
from orthoglide.observations.writing import (
    campaign_rows as campaign_rows,
    campaign_text as campaign_text,
    csv_text as csv_text,
    tcp_rows as tcp_rows,
)
