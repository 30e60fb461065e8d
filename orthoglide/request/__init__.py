"""What was asked of the program: kept with every result, so that it can be done again."""

from orthoglide.request.reading import read_result as read_result, request_of as request_of
from orthoglide.request.request import COMMANDS as COMMANDS, Command as Command, Request as Request
from orthoglide.request.states import State as State, states_of as states_of
