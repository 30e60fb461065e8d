"""Names of parameters with their parts: effect, leg, direction, setup and campaign.

A `Parameter` is the text of files and reports, ``axis_tilt.y.z@april``, with its parts as
attributes. Catalogues parse names (`Catalogue.parameter`).
"""

from __future__ import annotations

import re
from collections.abc import Collection
from typing import Any

MEMBERS = ("common", "cyclic", "symmetric", "antisymmetric")
"""Suffixes of structured members, which combine parameters of several legs."""

_SETUP = re.compile(r'"((?:[^"]|"")*)"(?:\.([^@]*))?(?:@(.*))?', re.DOTALL)


def quoted(setup: str) -> str:
    """Return a setup's name as a part of a parameter's: in quotes where it looks like syntax."""
    syntax = setup == "common" or "@" in setup or '"' in setup
    return '"{}"'.format(setup.replace('"', '""')) if syntax else setup


def setup_parts(text: str, shapes: Collection[str] = ()) -> tuple[str, str, str]:
    """Return setup, shape and campaign of the text after the name of a dial's effect: a setup's
    name, quoted as by :func:`quoted` or not, with its suffixes. The effect has ``shapes`` for each
    setup.
    """
    if match := _SETUP.fullmatch(text):
        return match[1].replace('""', '"'), match[2] or "", match[3] or ""
    plain, _, campaign = text.partition("@")
    setup, _, shape = plain.rpartition(".")
    return (setup, shape, campaign) if setup and shape in shapes else (plain, "", campaign)


def effect_name(name: str) -> str:
    """Return the effect of a name of an effect, a parameter or a structured member."""
    if isinstance(name, Parameter):
        return name.effect
    return split_campaign(name)[0].partition(".")[0]


def spaced(effect: str) -> str:
    """Return the name of an effect as words; of a free-form error with its travels, where
    underscores stand for a minus sign and for a decimal point too.
    """
    decimal = re.sub(r"(?<=\d)_(?=\d)", ".", effect)
    signed = re.sub(r"(?<=\d)to(_?)(?=\d)", r" to \1", decimal).replace(" _", " \N{MINUS SIGN}")
    return signed.replace("__", " \N{MINUS SIGN}").replace("_", " ")


def split_campaign(name: str) -> tuple[str, str]:
    """Return a name without its campaign, and the campaign, empty where it has none."""
    if isinstance(name, Parameter):
        return name.plain, name.campaign
    plain, _, campaign = name.partition("@")
    return plain, campaign


class Parameter(str):
    """Name of one parameter, or of a structured member of several.

    Attributes:
        effect: name of its effect.
        leg: ``"x"``, ``"y"`` or ``"z"`` on the Orthoglide; empty for dials and structured members.
        direction: what follows the leg or setup: a base axis, ``"radial"``, ``"a"``, ``"sin"``
            ...; often empty.
        setup: of a dial's or plate's parameter, else empty.
        member: of a structured member: ``"cyclic"``, ``"xy.symmetric"`` ..., else empty.
        campaign: the campaign to which it is specific, else empty.
    """

    effect: str
    leg: str
    direction: str
    setup: str
    member: str
    campaign: str

    def __new__(
        cls, effect: str, leg: str = "", direction: str = "", setup: str = "", member: str = "",
        campaign: str = "",
    ) -> Parameter:  # fmt: skip
        """Put a name together from its parts."""
        place = (quoted(setup), direction) if setup else (leg, direction)
        text = ".".join(part for part in (effect, *place, member) if part)
        parameter = super().__new__(cls, f"{text}@{campaign}" if campaign else text)
        parameter.effect, parameter.leg, parameter.direction = effect, leg, direction
        parameter.setup, parameter.member, parameter.campaign = setup, member, campaign
        return parameter

    def __getnewargs__(self) -> Any:
        return self.effect, self.leg, self.direction, self.setup, self.member, self.campaign

    @property
    def behind(self) -> str:
        """The name after its effect, campaign included."""
        return self[len(self.effect) + 1 :]

    @property
    def plain(self) -> Parameter:
        """The name without its campaign."""
        return self.at("")

    @property
    def undirected(self) -> Parameter:
        """The name without its direction, which a sine and its cosine share."""
        member = "common" if self.member.endswith(".common") else self.member
        return Parameter(self.effect, self.leg, "", self.setup, member, self.campaign)

    def at(self, campaign: str) -> Parameter:
        """Return the name specific to a campaign."""
        if campaign == self.campaign:
            return self
        return Parameter(self.effect, self.leg, self.direction, self.setup, self.member, campaign)
