"""At the machine: the sheet that is carried there, and the conversation while it is measured."""

from orthoglide.measuring.page import sheet_page
from orthoglide.measuring.program import MOST, SETTLED, opening
from orthoglide.measuring.record import Record
from orthoglide.measuring.session import End, Session, Stopped
