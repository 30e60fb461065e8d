"""What a firmware stored of its probe and its owner's calliper, as campaigns."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace

from orthoglide.errors import InputError
from orthoglide.klipper.calibration import Calibration
from orthoglide.klipper.config import Config
from orthoglide.klipper.mesh import touches
from orthoglide.klipper.probe import lies
from orthoglide.klipper.rows import campaign_of
from orthoglide.machine_file import Firmware
from orthoglide.notes import Note
from orthoglide.observations import ToolCampaign

CALIBRATION = "calibration"
"""Name of the campaign of heights and distances, which are stored as steps from the endstops: they
go with any numbers of the firmware, as meshes do not."""


class Stored:
    """Stored readings, as travel of the carriages from mechanical zero.

    Args:
        turned: by profile of a mesh, how far the plate was turned on its seat, degrees.

    Attributes:
        notes: what was noticed while reading, in sentences.
    """

    def __init__(
        self, config: Config, firmware: Firmware, turned: Mapping[str, float] | None = None
    ) -> None:
        self.config, self.firmware = config, firmware
        self.turned = dict(turned or {})
        self.notes: list[Note] = []

    def campaigns(self) -> Iterator[ToolCampaign]:
        """Heights with distances, then meshes; no two of one name, in capitals or not."""
        set_since = False
        if "delta_calibrate" in self.config.sections:
            calibration = Calibration(self.config, self.firmware, self.notes)
            if rows := calibration.rows():
                yield campaign_of(CALIBRATION, rows)
            set_since = calibration.set_since
        taken, unknown = set[str](), set(self.turned)
        known: dict[tuple[float, bytes], str] = {}
        for section in self.config.named("bed_mesh"):
            profile = section.name.partition(" ")[2]
            if not (profile and "points" in section):
                continue
            plain, number = _plain(profile), 1
            while (name := plain if number == 1 else f"{plain}-{number}").lower() in taken:
                number += 1
            taken.add(name.lower())
            unknown.discard(profile)
            rows = list(touches(self.config, self.firmware, section, name, self.notes))
            if not rows:
                continue
            mesh = campaign_of(f"mesh-{name}", rows, turn := self.turned.get(profile, 0.0))
            if set_since:
                mesh = self._as_set(mesh)
            other = known.setdefault((turn, mesh.command.tobytes()), profile)
            if other == profile:
                yield mesh
            else:
                self.notes.append(Note(
                    f"the mesh {profile!r} is {other!r} to the last digit, saved under another "
                    f"name: it is left out, for it would count twice", "mesh",
                ))  # fmt: skip
        if unknown:
            meshes = (s.name.partition(" ")[2] for s in self.config.named("bed_mesh"))
            have = ", ".join(repr(name) for name in meshes if name)
            raise InputError(
                f"there is no mesh {min(unknown)!r} whose plate was turned: take one of "
                f"{have or 'none'}"
            )

    def _as_set(self, mesh: ToolCampaign) -> ToolCampaign:
        """A mesh with z = 0 where its owner has set it since the heights were probed, before the
        mesh or after it.
        """
        p = self.firmware.points(mesh.command + self.firmware.zero)
        higher, *_ = lies(p, mesh.reading)
        return replace(mesh, reading=mesh.reading + higher)


def _plain(name: str) -> str:
    """A profile's name as files and parameters may carry it."""
    return re.sub(r"[^A-Za-z0-9_-]+", "-", name).strip("-")[:60] or "mesh"
