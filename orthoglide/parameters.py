"""A parameter's name, parsed once: which effect, which leg, which direction, which campaign.

A `Parameter` is the text that files and people use, ``axis_tilt.y.z@april``, and carries its parts,
so that nothing cuts names apart. Catalogues parse names (`Catalogue.parameter`).
"""

from __future__ import annotations

import re
from collections.abc import Collection
from typing import Any

MEMBERS = ("common", "cyclic", "symmetric", "antisymmetric")
"""Words behind the dot by which parameters of several legs go together."""

_SETUP = re.compile(r'"((?:[^"]|"")*)"(?:\.([^@]*))?(?:@(.*))?', re.DOTALL)


def quoted(setup: str) -> str:
    """A setup's name as it stands in a parameter's: in quotes where it may be taken for syntax."""
    syntax = setup == "common" or "@" in setup or '"' in setup
    return '"{}"'.format(setup.replace('"', '""')) if syntax else setup


def setup_parts(text: str, shapes: Collection[str] = ()) -> tuple[str, str, str]:
    """What stands behind the name of a dial's effect: setup, shape and campaign.

    Args:
        text: a setup's name, in quotes as :func:`quoted` puts them or not, and what follows it.
        shapes: that the effect has several of for each setup.
    """
    if found := _SETUP.fullmatch(text):
        return found[1].replace('""', '"'), found[2] or "", found[3] or ""
    behind, _, campaign = text.partition("@")
    setup, _, shape = behind.rpartition(".")
    return (setup, shape, campaign) if setup and shape in shapes else (behind, "", campaign)


def effect_name(name: str) -> str:
    """The effect of a name: its own, a parameter's or a structured member's."""
    if isinstance(name, Parameter):
        return name.effect
    return split_campaign(name)[0].partition(".")[0]


def split_campaign(name: str) -> tuple[str, str]:
    """A name, an effect's own too, without its campaign, and that; empty where it has none."""
    if isinstance(name, Parameter):
        return name.plain, name.campaign
    plain, _, campaign = name.partition("@")
    return plain, campaign


class Parameter(str):
    """Name of one parameter, or of a structured member of several.

    Attributes:
        effect: name of its effect.
        leg: ``"x"``, ``"y"`` or ``"z"`` on the Orthoglide; empty for dials and structured members.
        direction: what stands behind the leg or setup: a base axis, ``"radial"``, ``"a"``,
            ``"sin"`` ...; often empty.
        setup: of a dial's or plate's parameter, else empty.
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
        behind = (quoted(setup), direction) if setup else (leg, direction)
        text = ".".join(part for part in (effect, *behind, member) if part)
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
    def behind(self) -> str:
        """What stands behind its effect's name, its campaign included."""
        return self[len(self.effect) + 1 :]

    @property
    def plain(self) -> Parameter:
        """The same name without its campaign."""
        return self.at("")

    def at(self, campaign: str) -> Parameter:
        """The same name, own to a campaign."""
        if campaign == self.campaign:
            return self
        return Parameter(self.effect, self.leg, self.direction, self.setup, self.member, campaign)
