"""The report: one self-contained page, made of the sections that say something.

A section is a template ``sections/<name>.html.j2`` and the data that it shows.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import orthoglide.report.first as first
import orthoglide.report.sections as sections
from orthoglide import __version__
from orthoglide.figures.style import Drawing
from orthoglide.report.rendering import rendered
from orthoglide.result import Result
from orthoglide.text import listed

_JUDGES = {"holdout": "held out to judge by", "tcp": "measured at the TCP to judge by"}


_OPEN = ("finding", "left", "firmware", "controller", "changes")


@dataclass(frozen=True)
class Section:
    """One section of the page."""

    template: str  # name under `templates/sections`, and its anchor
    title: str  # its heading; empty for the verdict at the top
    data: Mapping[str, Any]  # what the template shows besides the result

    @property
    def folded(self) -> bool:
        """Whether a reader unfolds it first: all but what is wrong, what is left and numbers."""
        return self.template not in _OPEN


def page(result: Result, drawings: Sequence[Drawing], sheet: str) -> str:
    """The report as HTML; ``sheet`` is the text of ``next_measurements.csv``, empty where nothing
    is proposed.
    """
    searches = result.searches
    return rendered(
        "page.html.j2",
        result=result,
        title="What is wrong with this machine" if searches else "Calibration report",
        subtitle=_subtitle(result),
        sections=list(_sections(result, {d.name: d for d in drawings}, sheet)),
        version=__version__,
        command=result.request.command,
    )


def _sections(result: Result, figures: Mapping[str, Drawing], sheet: str) -> Iterator[Section]:
    searches = result.searches
    yield Section("finding", "", first.finding(result))
    if result.blunders:
        yield Section("faults", "Faults of the data", sections.faults(result))
    if searches and not result.stands:
        yield Section("left", "What is left", sections.left(result))
    if result.firmware is not None and result.firmware.corrections is not None:
        yield Section("firmware", "Numbers for the firmware", sections.firmware(result))
    controller = {"drives": ()} if result.firmware else sections.controller(result)
    if controller["drives"]:
        yield Section("controller", "Numbers for the controller", controller)
    yield Section("judged", "Before and after", sections.judged(result, figures))
    if searches:
        yield Section("causes", "Causes, and how sure they are", sections.causes(result))
    if result.located:
        yield Section("located", "Where it is", sections.located(result, figures))
    if result.effects:
        apart = sections.apart(result, figures)
        yield Section("apart", "What each cause makes of the readings", apart)
    if searches:
        yield Section("next", "What to measure next", sections.following(result, sheet))
    if result.budget:
        yield Section("budget", "Error budget", sections.budget(result))
    if result.workspace is not None:
        space = sections.workspace(result, result.workspace, figures)
        yield Section("workspace", "The TCP over the workspace", space)
    yield Section("values", "What was identified", sections.values(result, figures))
    yield Section(
        "readings", "Readings and fit, setup by setup", sections.readings(result, figures)
    )
    yield Section("unseen", "What these readings cannot tell", sections.unseen(result))
    yield Section("method", "How this was computed", sections.method(result))


def _subtitle(result: Result) -> str:
    request = result.request
    files = listed(i["file"] for i in request.inputs if i.get("role", "fit_tcp") == "fit_tcp")
    judges = [
        f"{i['file']} {_JUDGES[i['role']]}" for i in request.inputs if i.get("role") in _JUDGES
    ]
    count, read = sum(map(len, request.campaigns)), []
    if count:
        setups = sum(len(given.setups) for given in request.campaigns)
        read.append(f"{count} readings in {setups} setups")
    tool = sum(len(given) for given in request.points if not given.by_point)
    points = sum(len(given.points().command) for given in request.points if given.by_point)
    if tool:
        read.append(f"{tool} readings of the tool")
    if points:
        read.append(f"{points} TCP points")
    return "; ".join([f"{files}: {listed(read)}", *judges])
