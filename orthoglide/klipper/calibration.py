"""Heights and distances of [delta_calibrate], which are stored as steps from the endstops."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cached_property
from typing import Any

import numpy as np

from orthoglide.errors import FileError, InputError
from orthoglide.geometry import Array
from orthoglide.instruments import Distance, Probe
from orthoglide.klipper.config import Config
from orthoglide.klipper.entries import Section
from orthoglide.klipper.probe import lies, probe_offset
from orthoglide.klipper.rows import ROUND, row
from orthoglide.klipper.told import CALIBRATE
from orthoglide.machine_file import TOWERS, Firmware
from orthoglide.notes import Note
from orthoglide.numerals import signed

CALLIPER, RIM = 5e-5, 1e-4
"""Repeatability of a calliper's distance, metres; around the rim only one of two pillars' widths is
taken off, and pillars differ by a tenth of a millimetre."""

_FULL_STEPS = 200
_FAR = 3e-3  # metres by which a stored place may miss the one that the stored numbers give
_HANGS = 1e-3  # metres: a probe's offset that is no setting of the nozzle
_SAME = 2e-5  # metres: a height that is stored with another offset of the probe differs by more
_TIMES = (1.0, *(2.0**k for k in (1, -1, 2, -2, 3, -3, 4, -4)))  # that a step was longer then
_SET = 3e-5  # metres: heights lie less off where nothing was set since
_LEANS = 2e-5, 0.1  # metres, or of a mean that was set: most that they lean besides


class Calibration:
    """The readings of [delta_calibrate], as rows.

    Args:
        notes: to which what was noticed is added.

    Raises:
        FileError: naming the line of what does not go with the stored numbers.
    """

    def __init__(self, config: Config, firmware: Firmware, notes: list[Note]) -> None:
        self.config, self.firmware, self.notes = config, firmware, notes
        self.section = config.section("delta_calibrate")
        self.set_since = False  # whether z = 0 is no longer where the heights had it
        self._told = set[str]()  # kinds of readings of which some are left out

    def rows(self) -> list[dict[str, Any]]:
        """Heights, those by hand, and distances."""
        by_hand = self._heights("manual_height", "manual-heights")
        return [*self._heights("height", "heights"), *by_hand, *self._distances()]

    @property
    def misfit(self) -> float:
        """How far the heights are from one height by the stored numbers, metres, rms: what sets the
        nozzle higher or lower takes no part; nan where there are none.
        """
        keys = [f"height{k}" for k in self._numbers("height")]
        p = [self._believed(f"{key}_pos", self._travel(f"{key}_pos")) for key in keys]
        off = [float(here[2]) - self._height(key) for here, key in zip(p, keys, strict=True)]
        return float(np.std(off)) if off else float("nan")

    @cached_property
    def step(self) -> Array:
        """Travel of one of the steps that are counted ``(3,)``, metres."""
        now = np.array([_step(self.config, name) for name in TOWERS])
        times = next((t for t in _TIMES if self._goes_with(now * t)), 1.0)
        if times != 1.0:
            self.notes.append(Note(
                f"the positions of [delta_calibrate] were stored with {1 / times:g} times the "
                f"microsteps of now, and are taken so", "readings",
            ))  # fmt: skip
        return now * times

    def _goes_with(self, step: Array) -> bool:
        """Whether the heights are places on the plate if a step is so long."""
        words = ("height", "manual_height")
        keys = [f"{word}{k}" for word in words for k in self._numbers(word)]
        if not keys:
            return False
        travel = np.array([self._travel(f"{key}_pos", step) for key in keys])
        try:
            p = self.firmware.points(travel + self.firmware.zero)
        except InputError:
            return False
        return bool((np.abs(p[:, 2] - [self._height(key) for key in keys]) < _FAR).all())

    def _height(self, key: str) -> float:
        return self.section.number(key, low=-100, high=100) * 1e-3

    def _travel(self, key: str, step: Array | None = None) -> Array:
        steps = np.array(self.section.numbers(key, 3)) * (self.step if step is None else step)
        return np.round(self.firmware.at_endstop - steps - self.firmware.zero, ROUND)

    def _believed(self, key: str, travel: Array) -> Array:
        """Where the firmware's numbers put the nozzle; refused where that is out of all reach."""
        try:
            p = self.firmware.points((travel + self.firmware.zero)[None])[0]
        except InputError:
            self.section.fail(key, "is a place that the arms do not reach: correct the steps")
        return p

    def _heights(self, word: str, setup: str) -> list[dict[str, Any]]:
        """Touches of the plate, by the probe or (``manual_height``) by the nozzle itself."""
        keys = [f"{word}{k}" for k in self._numbers(word)]
        if not keys:
            return []
        offset, beside = probe_offset(self.config)
        height = np.array([self._height(key) for key in keys])
        probed = word == "height" and not self._by_nozzle(height, offset)
        touched = beside if probed else np.zeros(2)
        travel = [self._travel(f"{key}_pos") for key in keys]
        p = np.array([self._believed(f"{k}_pos", t) for k, t in zip(keys, travel, strict=True)])
        off = float(np.median(p[:, 2] - height))
        for key, here, above in zip(keys, p, height, strict=True):
            if (
                abs(here[2] - above - off) > _FAR
                or np.hypot(*here[:2]) > self.firmware.delta_radius
            ):
                x, y, z = (f"{v * 1e3:.1f}" for v in here)
                self.section.fail(
                    f"{key}_pos",
                    f"puts the nozzle at ({x}, {y}, {z}) mm by the stored numbers, where its "
                    f"height above the bed was {above * 1e3:g} mm: the positions, the steps or the "
                    f"numbers of [printer] and [stepper_*] are of different times or mistyped",
                )
        lifted = self._lifted(word, p, height, off)
        set_since = probed and offset and abs(np.median(height) - offset) > _SAME
        if set_since and not lifted:
            stored = float(np.median(height))
            self.notes.append(Note(
                f"the heights of [delta_calibrate] were stored with a z_offset of "
                f"{stored * 1e3:g} mm, and it is {offset * 1e3:g} mm now: new endstops go by the "
                f"heights as they were stored, and the nozzle may end "
                f"{abs(stored - offset) * 1e3:.2g} mm too high or too low; run DELTA_CALIBRATE "
                f"again", "heights",
            ))  # fmt: skip
        labels = (f"{x * 1e3:.0f} {y * 1e3:.0f}" for x, y, _ in p)
        each = zip(labels, travel, height + lifted, strict=True)
        return [{**row(Probe.kind, setup, *one), "beside": touched} for one in each]

    def _by_nozzle(self, height: Array, offset: float) -> bool:
        """Whether DELTA_CALIBRATE METHOD=manual touched with the nozzle, which stores heights of 0.

        Of a probe that hung there, whose z_offset was 0 then and was set since, meshes lie as far
        below z = 0 as it hangs.
        """
        meshes = (s for s in self.config.named("bed_mesh") if "points" in s)
        if height.any() or abs(offset) < _HANGS or any(_lies_at(s) < -offset / 2 for s in meshes):
            return False
        self.notes.append(Note(
            "the heights of [delta_calibrate] are all 0, as DELTA_CALIBRATE METHOD=manual stores "
            "them: they are taken as touches of the nozzle itself, without the probe's offset; if "
            "the probe touched, with a z_offset of 0, run DELTA_CALIBRATE again", "heights",
        ))  # fmt: skip
        return True

    def _lifted(self, word: str, p: Array, height: Array, off: float) -> float:
        """By how much all endstops were moved together since, metres.

        The firmware's own fit leaves neither a mean nor a slope of its heights. A mean without a
        slope is what its owner set the nozzle higher or lower by (Z_OFFSET_APPLY_ENDSTOP): where
        z = 0 is, the owner knows better than these heights. A delta reads alike at every height, so
        they tell all else as before.
        """
        mean, along_x, along_y = lies(p, height)
        leans = float(np.hypot(along_x, along_y) * np.hypot(*p[:, :2].T).max())
        far, alike = abs(off) > _FAR, leans <= max(_LEANS[0], _LEANS[1] * abs(mean))
        if not far and not (alike and abs(mean) > _SET):
            return 0.0
        self.set_since, since = True, mean if alike else off
        doubt = (
            "; so far is no setting of the nozzle: if these heights are of another machine, or of "
            "another hotend, run DELTA_CALIBRATE again before you enter anything"
            if far
            else ""
        )
        together = (
            ", all alike, by the endstops that are stored now: these were moved together since "
            "(Z_OFFSET_APPLY_ENDSTOP)" if alike else " by the endstops that are stored now"
        )  # fmt: skip
        self.notes.append(Note(
            f"the {word}s of [delta_calibrate] lie {signed(since * 1e3, 2)} mm off{together}, and "
            f"z = 0 is left where they put it{doubt}",
            CALIBRATE if far else "heights",
        ))  # fmt: skip
        return since

    def _distances(self) -> Iterator[dict[str, Any]]:
        section = self.section
        for k in self._numbers("distance"):
            distance = section.number(f"distance{k}", low=1, high=1000) * 1e-3
            ends, believed = [], []
            for end in ("pos1", "pos2"):
                ends.append(self._travel(f"distance{k}_{end}"))
                believed.append(self._believed(f"distance{k}_{end}", ends[-1]))
            apart = float(np.linalg.norm(believed[1] - believed[0]))
            if abs(apart - distance) > max(_FAR, 0.1 * distance):
                section.fail(
                    f"distance{k}",
                    f"is {distance * 1e3:g} mm between places that are {apart * 1e3:.1f} mm apart "
                    f"by the stored numbers: is it in another place of DELTA_ANALYZE's list?",
                )
            # The firmware's part has six spokes and six rim sides, each with pillars of its own.
            spoke = k % 12 < 6
            part = "spokes" if spoke else "rim"
            apart_by = row(Distance.kind, part, f"{k}", ends[0], distance, ends[1])
            yield apart_by if spoke else {**apart_by, "sigma": RIM}

    def _numbers(self, word: str) -> list[int]:
        """Numbers of the readings of a kind; of a place without its reading a note is made."""
        own = re.compile(rf"{word}([0-9]{{1,4}})(?:_pos[12]?)?")
        known = {int(m[1]) for key in self.section.entries if (m := own.fullmatch(key))}
        read = sorted(k for k in known if f"{word}{k}" in self.section)
        if len(read) < len(known) and word not in self._told:
            self._told.add(word)
            lone = ", ".join(f"{word}{k}" for k in sorted(known.difference(read)))
            self.notes.append(Note(
                f"[delta_calibrate] has a place and no reading of {lone}: it is left out",
                "readings",
            ))  # fmt: skip
        return read


def _lies_at(section: Section) -> float:
    """Height of a mesh in its middle, metres; 0 of one that cannot be read."""
    try:
        return float(np.median([z for row in section.table("points") for z in row] or [0])) * 1e-3
    except FileError:
        return 0.0


def _step(config: Config, tower: str) -> float:
    """Travel of one microstep of a tower, metres."""
    section = config.section(f"stepper_{tower}")
    if "rotation_distance" not in section and "step_distance" in section:  # of older firmware
        return section.number("step_distance", low=1e-5, high=10) * 1e-3
    around = section.number("rotation_distance", low=0.1, high=1000)
    count = section.whole("full_steps_per_rotation", _FULL_STEPS, 4, 1000)
    if count % 4:
        section.fail("full_steps_per_rotation", f"is {count}, not a multiple of 4: correct it")
    gear = 1.0
    if "gear_ratio" in section:
        for pair in section.entries["gear_ratio"].text.split(","):
            ends = re.fullmatch(r"\s*([0-9.]+)\s*:\s*([0-9.]+)\s*", pair)
            try:
                gear *= float(ends[1]) / float(ends[2]) if ends else 0.0
            except (ValueError, ZeroDivisionError):
                gear = 0.0
        if not 0 < gear < 1e3:
            section.fail("gear_ratio", "is no list of ratios such as 80:16: correct it")
    return around * 1e-3 / (count * section.whole("microsteps", None, 1, 1024) * gear)
