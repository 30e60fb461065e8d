"""Kinds of readings: formula, nuisances, place of the instrument, and words.

A formula is written once, for one row, with operations that numbers and CasADi's symbols share.
Values, derivatives by the pose, nuisance columns and the nonlinear programme all come from it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from orthoglide.effects import Effect
from orthoglide.errors import InputError, check_choice
from orthoglide.geometry import LEGS, Array, Geometry

Ints = NDArray[np.int64]

POSE_SIZE = 12
"""Numbers of a closed posture that a reading follows: the tool's place and rotation, or the ends of
one leg's bars."""


@dataclass(frozen=True)
class ReadingVariables:
    """Symbols or numbers of one reading."""

    # place of the tool and rotation of the platform row by row, or ends of the bars of the leg that
    # is read (bar, end, xyz), metres (12,)
    pose: Any
    second_pose: Any  # the same at the second command of a reading between two (12,)
    mounting: Any  # numbers of the instrument in its place, see `Observation.mountings` (M,)
    nuisance: Any  # numbers that a setup's readings contain besides the machine (K,)
    effect_parameters: Sequence[Any]  # of the parameters of the instrument's effects (D,)


@dataclass(frozen=True)
class InstrumentPose:
    """Place of one setup's instrument, estimated from its readings.

    A tracker has a ``turn``, a ball bar a ``ball``, a probe a ``lift``.
    """

    rotation: Array = field(
        default_factory=lambda: np.eye(3)
    )  # its frame's axes in the base (3, 3)
    ball_centre: Array = field(
        default_factory=lambda: np.zeros(3)
    )  # centre of its ball (3,), metres
    # by how much places beside or below the tool are higher than at a platform that is level, in
    # the mean of the readings, metres
    mean_lift: float = 0.0

    def is_close_to(self, other: InstrumentPose) -> bool:
        """Return whether both are equal as far as second orders of their difference matter."""
        return bool(
            np.abs(self.rotation - other.rotation).max() <= SMALL_ROTATION
            and np.abs(self.ball_centre - other.ball_centre).max() <= SMALL_SHIFT
            and abs(self.mean_lift - other.mean_lift) <= SMALL_SHIFT
        )


Frame = Literal["none", "translation", "rigid"]
"""How the frame of a tracker may differ from the machine's: not at all, by a translation, or by a
translation and a turn."""


@dataclass(frozen=True)
class InstrumentPriors:
    """Prior knowledge of the places of instruments."""

    dial_placement_sd: float = (
        0.0  # standard deviation of a dial's place along its leg, metres; 0: exact
    )
    # standard deviation of the slope of the surface that two dials were set to zero against; 0:
    # exact, radians
    surface_slope_sd: float = 0.0
    tracker_frame: Frame = "rigid"  # of a tracker


@dataclass(frozen=True)
class MountingContext:
    """What the mounting numbers of a formula depend on."""

    geometry: Geometry  # of the machine
    instrument_poses: Sequence[InstrumentPose]  # of every setup
    # places of all readings on their plates over the largest measured radius, along axes that turn
    # with the plate (n, 2)
    normalized_plate_xy: Array
    effects: Sequence[Effect] = ()  # of the instrument, those that it takes


TOOL_OFFSET_COLUMNS = ("beside_x_mm", "beside_y_mm", "beside_z_mm")
"""Columns of where a probe touches or a tip stands, from the tool on the platform."""

MATERIAL_COLUMN = "material"
"""Column of what a measured part is made of, which says how well its size is known."""

PLATE_TURN_COLUMN = "turned_deg"
"""Column of how far a plate was turned on its seat, counter-clockwise from above."""

SMALL_ROTATION = 1e-3
"""Radians: the square of a smaller turn moves no more than parts of a micrometre."""

SMALL_SHIFT = 1e-5
"""Metres: the square of a smaller shift over a machine's size is below a nanometre."""


Table = Any
"""Readings, as `observations` has them, with one entry a reading in each array."""


OBSERVATIONS: dict[str, Observation] = {}
"""All kinds of readings, by what files call them; the files beside this one fill it."""


@dataclass(frozen=True)
class Setup:
    """One mounting of one instrument, a dial on a leg where no kind is given.

    Attributes:
        name: label, unique within its file.
        leg: 0, 1 or 2: the leg that is read; -1 where the tool is.
        axis: 0, 1 or 2: the base axis along which a leg is read, not the leg's own; -1 where each
            reading has its own axis, or none.
        sign: +1, or -1 where the dial counts against the axis.
        gauge: where the dial stands along the leg's own axis, metres, r removed.
        bar: 1 or 2 for a bar, 0 for the leg's median line.
        kind: of its readings, a key of `OBSERVATIONS`.
        gauge2: where the second dial stands of readings that are a difference of two, as ``gauge``.
        beside: where it is taken: from the point of the tool that is commanded, along x, y and z
            of the platform, metres; below it, of a longer tool, z is negative.
        turned: of a plate, how far it was turned on its seat, counter-clockwise from above,
            degrees: its shape turns with it.
        material: of a part on which distances are read, see `distance.SIZES`.

    Raises:
        InputError: where these do not fit together.
    """

    name: str
    leg: int = -1
    axis: int = -1
    sign: int = 1
    gauge: float = 0.0
    bar: int = 0
    kind: str = "leg"
    gauge2: float = 0.0
    beside: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turned: float = 0.0
    material: str = ""

    def __post_init__(self) -> None:
        check_choice("kind of reading", self.kind, OBSERVATIONS)
        if self.leg in OBSERVATIONS:
            raise InputError(f"setup {self.name!r}: name what is its kind: kind={self.leg!r}")
        if trouble := self.observation.check(self):
            raise InputError(f"setup {self.name!r}: {trouble}")

    @property
    def observation(self) -> Observation:
        """The kind of its readings."""
        return OBSERVATIONS[self.kind]

    def takes(self, effect: Effect) -> bool:
        """Return whether an effect of instruments changes its readings."""
        return self.observation.is_affected_by(effect) and self.observation.allows_effect(
            self, effect
        )

    @property
    def gauges(self) -> tuple[float, ...]:
        """Where each of its dials stands along the leg's own axis, metres, r removed."""
        return (self.gauge, self.gauge2)[: self.observation.dials]

    @property
    def direction(self) -> str:
        """The axis with its sign as files write it: ``"y"`` or ``"-y"``; empty without one."""
        return "" if self.axis < 0 else ("-" if self.sign < 0 else "") + LEGS[self.axis]


@dataclass(frozen=True)
class SetupReadings:
    """Readings of one setup that say where its instrument stands."""

    p: Array  # where a machine has the tool, or the place beside it (m, 3), metres
    offset_from_tool: (
        Array  # what of it is the place beside the tool, turned with the platform (m, 3), metres
    )
    axis: Ints  # base axis that is read (m,)
    value: Array  # readings, counted along that axis (m,); all nan where none is taken yet
    sigma: Array  # standard deviation of each (m,)

    @property
    def is_unread(self) -> bool:
        """Whether the readings are still to be taken."""
        return bool(np.isnan(self.value).all())


_LEAST_NOISE_RATIO = 0.05  # share of the usual noise


class Observation(ABC):
    """One kind of reading.

    Attributes:
        kind: what files call its readings, and the machine file its table.
        words: what takes the readings.
        reads: what is read; ``{}`` or ``{0}`` stands for the axis, ``{1}`` for the leg.
        fill: what to write on a sheet.
        fitted: what a setup's readings contain besides the machine, for the documentation.
        fill_place: what to write where its rows say places, if that is another way.
        how: said behind ``words`` of readings that are proposed to tell causes apart; empty where
            none are.
        repeatability: standard deviation of one reading where nothing is known.
        quietest: least standard deviation that repeats may show, as copies show none.
        angular: whether it reads radians; metres otherwise.
        dials: on a leg that one reading is made of; 0 of what reads the tool.
        protocol: of dials, the measuring protocol that makes most of them.
        axes: base axes along or about which it reads; none where it has no direction.
        touches: whether it touches a plate.
        paired: whether it reads between two commands.
        about_ball: whether it reads about a fixed ball.
        setup_columns: columns of files that a mounting has besides its name.
        postures: distinct postures that a setup needs.
        nuisances: how many numbers a setup's readings contain besides the machine, `K`.
    """

    kind: ClassVar[str]
    instrument_phrase: ClassVar[str]
    quantity_phrase: ClassVar[str]
    sheet_instruction: ClassVar[str]
    nuisance_summary: ClassVar[str]
    sheet_instruction_place: ClassVar[str] = ""
    suggestion_suffix: ClassVar[str] = ""
    repeatability: ClassVar[float]
    least_noise: ClassVar[float]
    angular: ClassVar[bool] = False
    dials: ClassVar[int] = 0
    protocol: ClassVar[Literal["sweep", "parallelism"]]
    axes: ClassVar[tuple[int, ...]] = ()
    touches: ClassVar[bool] = False
    paired: ClassVar[bool] = False
    about_ball: ClassVar[bool] = False
    setup_columns: ClassVar[tuple[str, ...]] = TOOL_OFFSET_COLUMNS
    min_postures: ClassVar[int] = 1
    nuisance_count: ClassVar[int]

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        cls.least_noise = 0.0 if cls.dials else _LEAST_NOISE_RATIO * cls.repeatability
        OBSERVATIONS[cls.kind] = cls()

    @property
    def on_leg(self) -> bool:
        """Whether it is read on a leg; else at the tool."""
        return self.dials > 0

    @property
    def from_datum(self) -> bool:
        """Whether its readings say something only against others of their setup."""
        return self.min_postures > 1

    @property
    def unit(self) -> str:
        """Unit of its readings in files and texts."""
        return "mrad" if self.angular else "mm"

    def is_affected_by(self, effect: Effect) -> bool:
        """Return whether an effect of instruments changes its readings."""
        return False

    def allows_effect(self, setup: Setup, effect: Effect) -> bool:
        """Return whether a setup may have an effect that this kind takes."""
        return True

    def check(self, setup: Setup) -> str:
        """Return what is wrong with a setup of this kind, as a clause; empty where nothing is."""
        return "" if setup.leg < 0 else f"a setup of kind {self.kind} touches no leg"

    @abstractmethod
    def formula(self, row: ReadingVariables, effects: Sequence[Effect]) -> Any:
        """Return the reading to expect of one row.

        Args:
            row: its symbols or numbers.
            effects: of the instrument, those that it takes, in the order of their values.
        """

    @abstractmethod
    def mounting_values(self, table: Table, rows: NDArray[np.intp], site: MountingContext) -> Array:
        """Return the numbers of instruments in their places that the formula uses ``(m, M)``.

        Args:
            table: the readings.
            rows: some of them ``(m,)``, of this kind.
            site: where its instruments stand.
        """

    @abstractmethod
    def nuisance_sds(self, setup: Setup, axis: Ints, beliefs: InstrumentPriors) -> Array:
        """Return standard deviations of the nuisances about zero ``(K,)``: infinite where nothing
        is known, 0 of those that the setup has not.

        Args:
            setup: whose they are.
            axis: base axes that the setup reads ``(m,)``.
            beliefs: of how instruments stand.
        """

    def shared_nuisance_name(self, setup: Setup, number: int) -> str:
        """Return what the nuisance of a number is called where all setups of a file that call it so
        have it together; empty of one that the setup has for itself.
        """
        return ""

    def estimate_pose(
        self, taken: SetupReadings, near: InstrumentPose | None, beliefs: InstrumentPriors
    ) -> InstrumentPose:
        """Return where a setup's instrument stands by its readings.

        Args:
            taken: the readings, and where a machine takes them.
            near: about where it stands, if that is known.
            beliefs: of how instruments stand.
        """
        return near or InstrumentPose()

    def apply_pose_nuisances(
        self, stand: InstrumentPose, nuisance: Array
    ) -> tuple[InstrumentPose, Array]:
        """Return where an instrument stands that is off its place by some of its nuisances, and
        what of these is left ``(K,)``: all where they say it to any order.
        """
        return stand, nuisance

    def find_unit_or_frame_error(
        self, taken: SetupReadings, apart: Array, beliefs: InstrumentPriors
    ) -> str:
        """Return what a setup's readings seem to be that cannot be meant as they stand, as a
        sentence; empty where they can.

        Args:
            taken: the readings, and where the machine near which they were taken has the tool.
            apart: distance to the place of the second command ``(m,)``, metres.
            beliefs: of how instruments stand.
        """
        return ""

    def placement_warnings(
        self, stand: InstrumentPose, p: Array, axis: Ints
    ) -> Iterator[tuple[str, str]]:
        """Yield what is odd in where a setup's instrument stands: sentences, each with its kind.

        Args:
            stand: by its readings.
            p: where these were taken ``(m, 3)``, metres.
            axis: that they read ``(m,)``.
        """
        yield from ()

    def places(self, ring: Array) -> tuple[Array, Array | None]:
        """Return places of a measuring sheet ``(k, 3)``, and the second ones where it reads between
        two.

        Args:
            ring: places on a circle of radius 1 about z ``(m, 3)``.
        """
        return np.concatenate([ring, ring[:, [2, 0, 1]], ring[:, [1, 2, 0]]]), None


Vector = Sequence[Any]
"""Three numbers or symbols."""


def vector(values: Any, first: int = 0) -> Vector:
    """Return three successive entries of a row."""
    return [values[first + k] for k in range(3)]


def dot(one: Vector, other: Vector) -> Any:
    """Return the product of two vectors."""
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


def add(*terms: tuple[Any, Vector]) -> Vector:
    """Return the sum of vectors, each with a factor before it."""
    return [sum(factor * own[k] for factor, own in terms) for k in range(3)]


def length(along: Vector) -> Any:
    """Return the length of a vector."""
    return dot(along, along) ** 0.5


def reading_point(pose: Any, beside: Vector) -> Vector:
    """Return where a reading is taken, ``beside`` the tool on the platform."""
    return add((1, vector(pose)), (1, [dot(vector(pose, 3 + 3 * k), beside) for k in range(3)]))


def signed_axes(table: Table, rows: NDArray[np.intp]) -> Array:
    """Return the axis that each row counts along, with its sign ``(m, 3)``."""
    return np.asarray(table.sign[rows, None] * np.eye(3)[table.axis[rows]])
