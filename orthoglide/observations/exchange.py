"""Readings of any kind as rows, files and data frames, which all read back; those put together in
Python are checked as those of a file are.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

import numpy as np

from orthoglide import files
from orthoglide.errors import InputError
from orthoglide.frames import data_frame
from orthoglide.machine_file import AnyMachine, MachineFile
from orthoglide.observations.arrays import Recorded
from orthoglide.observations.campaign import Campaign
from orthoglide.observations.checks import check_campaign, check_commands, check_filled
from orthoglide.observations.columns import TURNS
from orthoglide.observations.table import frame_table
from orthoglide.observations.tcp import TcpPoints, check_points
from orthoglide.observations.tool import ToolCampaign
from orthoglide.observations.tool_reading import Readings, check_tool, readings_of_table
from orthoglide.observations.writing import Row, campaign_rows, csv_text, tcp_rows
from orthoglide.units import NOISE

if TYPE_CHECKING:
    import pandas as pd

_R = TypeVar("_R", bound=Readings)
_WORDS = ("kind", "setup", "leg", "direction", "posture", "firmware")


def readings_rows(given: Readings | TcpPoints, machine_file: AnyMachine | None = None) -> list[Row]:
    """The rows of the file of readings of any kind; arguments as for `write_campaign`."""
    if isinstance(given, TcpPoints):
        return tcp_rows(given, machine_file)
    return campaign_rows(given, machine_file)


def readings_text(
    given: Sequence[Readings], machine_file: AnyMachine | None = None, *, places: bool = False
) -> str:
    """The CSV text of one file of readings of several kinds; arguments as for `campaign_rows`."""
    said = {"places": places, "approaches": len(given) > 1}  # empty is unknown, if one gives them
    rows = [row for one in given for row in campaign_rows(one, machine_file, **said)]
    names = dict.fromkeys(name for row in rows for name in row)
    return csv_text([{name: row.get(name, "") for name in names} for row in rows])


def write_campaign(
    campaign: Readings | Sequence[Readings],
    path: str | os.PathLike[str],
    machine_file: AnyMachine | None = None,
    *,
    overwrite: bool = False,
) -> None:
    """Writes readings or a measuring sheet; optional columns only where they say something.

    Args:
        campaign: what to write, of dials or of the tool; readings that are nan are left empty.
            Several go into one file, dials first, each in order behind the one before.
        path: where to.
        machine_file: the machine, or its file: where its controller counts in a way of its own,
            commands are written as it shows them; as the campaign has them if None.
        overwrite: whether an existing file may be replaced.

    Raises:
        FileError: where a file stands already and may not be replaced, or none can be written.
        InputError: where several cannot be one file: of different machines, two with dials, or two
            with a setup of the same name.
    """
    if isinstance(campaign, TcpPoints):
        raise InputError("points have files of their own kind: points.to_frame().to_csv(path)")
    several = campaign if isinstance(campaign, Sequence) else (campaign,)
    if not several or not all(isinstance(one, Recorded) and len(one) for one in several):
        raise InputError("give a campaign with readings, or a list of such, to write")
    setups = [s.name for one in several for s in one.setups]
    twice = [name for name in setups if setups.count(name) > 1]
    if len({one.legs for one in several}) > 1:
        raise InputError(
            "one file is of one machine, and these call their legs otherwise: write readings of "
            "others to their own files"
        )
    if sum(isinstance(one, Campaign) for one in several) > 1:
        raise InputError("one file has one campaign of dials: write the others to their own files")
    if twice:
        raise InputError(
            f"two setups of one file are called {twice[0]!r}: name each apart, or write the "
            f"readings to files of their own"
        )
    # Dials take all moves of a file for theirs: those behind their readings are nothing to them.
    given = in_sequence(sorted(several, key=lambda one: isinstance(one, ToolCampaign)))
    files.write_whole(path, readings_text(given, machine_file), overwrite=overwrite)


def in_sequence(given: Sequence[_R]) -> list[_R]:
    """The same readings, the order of each behind that of the one before."""
    found, last = list[_R](), 0
    for one in given:
        order = np.concatenate([one.order, one.moves.order])
        shift = last + 1 - order.min() if found else 0
        moves = replace(one.moves, order=one.moves.order + shift)
        found.append(replace(one, order=one.order + shift, moves=moves))
        last = order.max() + shift
    return found


def readings_frame(campaign: Readings, machine_file: AnyMachine | None = None) -> pd.DataFrame:
    """The rows of the file of readings as a data frame, which ``from_frame`` takes back; arguments
    as for `write_campaign`. Frames of several kinds put together are those of a mixed file.

    Raises:
        InputError: where pandas is not installed.
    """
    rows = campaign_rows(campaign, machine_file, approaches=True)

    def value(name: str, cell: str) -> Any:
        return cell if name in _WORDS else float(cell or "nan")

    names = list(rows[0]) if rows else []
    return data_frame({name: [value(name, row[name]) for row in rows] for name in names})


def tool_from_frame(
    df: Any, *, name: str = "frame", machine_file: AnyMachine | None = None
) -> ToolCampaign:
    """Readings of the tool from a data frame with the columns of their file.

    Args:
        df: a pandas data frame, or a mapping of columns; missing values are empty fields.
        name: of the readings.
        machine_file: the machine whose layout, stroke and controller count, or its file; the
            nominal one if None.

    Raises:
        FileError: as `read_readings`, rows counted as lines of a file with a header.
        InputError: where there are dials on legs among them.
    """
    found = readings_of_table(frame_table(df, name), name, machine_file)
    if not isinstance(found[0], ToolCampaign):
        raise InputError(f"{name} holds dials on legs: they have Campaign.from_frame, apart")
    return replace(found[0], file="")


def check_given(given: Campaign | ToolCampaign | TcpPoints, machine: MachineFile) -> None:
    """Refuse readings for which a file that holds them would be refused.

    Raises:
        InputError: naming the row, counted from 0, and what would be right.
    """

    def fail(message: str, row: int | None = None) -> NoReturn:
        place = "" if row is None else f", row {row} (counted from 0)"
        raise InputError(f"{given.name}{place}: {message} (arrays are in metres and radians)")

    if not isinstance(given, Campaign | ToolCampaign | TcpPoints):
        raise InputError(
            f"a {type(given).__name__} holds no readings: give a campaign, which "
            "og.Campaign.from_frame makes of a data frame, TCP points, or the path of a file"
        )
    if not len(given):
        fail("has no readings: give some")
    check_commands(given.command, False, machine, fail)
    most = np.full(len(given), NOISE[1])
    if isinstance(given, ToolCampaign):
        most[given.angular] = TURNS
    wrong = np.isfinite(given.sigma) & ((given.sigma < NOISE[0]) | (given.sigma > most))
    if wrong.any():
        row = int(np.argmax(wrong))
        fail(
            f"sigma is {given.sigma[row]:g}: give a standard deviation in metres from "
            f"{NOISE[0]:g} to {most[row]:g}, or nan",
            row,
        )
    if isinstance(given, TcpPoints):
        check_points(given, fail)
    elif isinstance(given, ToolCampaign):
        check_tool(given, fail)
    else:
        check_filled(given.reading, fail)
        check_campaign(given, machine, fail)


Recorded.to_frame = readings_frame
ToolCampaign.from_frame = staticmethod(tool_from_frame)
