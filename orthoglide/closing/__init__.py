"""From readings to causes: the loop is closed, and what was found becomes a result."""

from orthoglide.closing.closed import Closed as Closed
from orthoglide.closing.fill import filled as filled
from orthoglide.closing.loop import close as close
