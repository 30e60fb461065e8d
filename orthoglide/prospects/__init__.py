"""What further readings would tell about the causes that a run finds, cannot separate or leaves
unexplained.
"""

from orthoglide.prospects.detectable import (
    Detectability as Detectability,
    SmallestEffect as SmallestEffect,
    smallest_effects as smallest_effects,
)
from orthoglide.prospects.instruments import (
    TAKEN_BY as TAKEN_BY,
    deciding_instruments as deciding_instruments,
)
from orthoglide.prospects.parting import parting as parting
from orthoglide.prospects.unexplained import (
    deciding_visits as deciding_visits,
    repeating as repeating,
    tracing as tracing,
)
