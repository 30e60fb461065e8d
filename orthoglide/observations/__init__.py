"""Readings of all kinds in one table, read from files, checked and written."""

from orthoglide.observations.approach import Moves as Moves, derive_approach as derive_approach
from orthoglide.observations.checks import check_given as check_given
from orthoglide.observations.protocols import protocol as protocol
from orthoglide.observations.reading import (
    ReadingsOrPath as ReadingsOrPath,
    read_campaign as read_campaign,
    read_readings as read_readings,
    read_tcp as read_tcp,
)
from orthoglide.observations.readings import Readings as Readings, Setup as Setup, source as source
from orthoglide.observations.tables import (
    concatenated as concatenated,
    from_points as from_points,
    split_legs_and_tool as split_legs_and_tool,
)
from orthoglide.observations.writing import (
    campaign_rows as campaign_rows,
    campaign_text as campaign_text,
    csv_text as csv_text,
    write_campaign as write_campaign,
)

# Names by which earlier versions called readings of some kinds, and setups of them.
Campaign = Readings
ToolCampaign = Readings
TcpPoints = Readings
ToolSetup = Setup
