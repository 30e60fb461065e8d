"""A parameter's name, parsed once: which effect, which leg, which direction, which campaign.

A `Parameter` is the text that files and people use, ``axis_tilt.y.z@april``, and carries its parts,
so that nothing cuts names apart. Catalogues parse names (`Catalogue.parameter`).
"""

from __future__ import annotations

import re
from typing import Any

_SETUP = re.compile(r'"((?:[^"]|"")*)"(?:@(.*))?', re.DOTALL)


def quoted(setup: str) -> str:
    """A setup's name as it stands in a parameter's: in quotes where it may be taken for syntax."""
    syntax = setup == "common" or "@" in setup or '"' in setup
    return '"{}"'.format(setup.replace('"', '""')) if syntax else setup


def setup_and_campaign(text: str) -> tuple[str, str]:
    """What stands behind a dial's effect, taken apart: see :func:`quoted`."""
    if found := _SETUP.fullmatch(text):
        return found[1].replace('""', '"'), found[2] or ""
    setup, _, campaign = text.partition("@")
    return setup, campaign


class Parameter(str):
    """Name of one parameter, or of a structured member of several.

    Attributes:
        effect: name of its effect.
        leg: ``"x"``, ``"y"`` or ``"z"``; empty for dials and structured members.
        direction: what stands behind the leg: a base axis, ``"a"``, ``"sin"`` ...; often empty.
        setup: of a dial's parameter, else empty.
        member: of a structured member: ``"cyclic"``, ``"xy.symmetric"`` ..., else empty.
        campaign: the campaign that has it for itself, else empty.
    """

    effect: str
    leg: str
    direction: str
    setup: str
    member: str
    campaign: str

    def __new__(
        cls,
        effect: str,
        leg: str = "",
        direction: str = "",
        setup: str = "",
        member: str = "",
        campaign: str = "",
    ) -> Parameter:
        """Put a name together from its parts."""
        parts = (effect, leg, direction, quoted(setup), member)
        text = ".".join(part for part in parts if part)
        made = super().__new__(cls, f"{text}@{campaign}" if campaign else text)
        made.effect, made.leg, made.direction = effect, leg, direction
        made.setup, made.member, made.campaign = setup, member, campaign
        return made

    def __getnewargs__(self) -> Any:
        return (
            self.effect,
            self.leg,
            self.direction,
            self.setup,
            self.member,
            self.campaign,
        )

    @property
    def plain(self) -> Parameter:
        """The same name without its campaign."""
        return self.at("")

    def at(self, campaign: str) -> Parameter:
        """The same name, own to a campaign."""
        if campaign == self.campaign:
            return self
        return Parameter(self.effect, self.leg, self.direction, self.setup, self.member, campaign)
