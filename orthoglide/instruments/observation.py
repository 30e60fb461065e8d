"""Kinds of readings: formula, nuisance parameters, pose of the instrument, and texts.

A formula is written once, for one reading, with operations that numbers and CasADi's symbols share.
Values, derivatives by the pose, nuisance columns and the nonlinear programme all come from it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from orthoglide.arguments import public
from orthoglide.effects import Effect
from orthoglide.errors import InputError, check_choice
from orthoglide.geometry import LEGS, Array, Geometry

Ints = NDArray[np.int64]

POSE_SIZE = 12
"""Numbers that describe a posture: position and rotation of the tool, or the ends of one leg's
bars."""


@dataclass(frozen=True)
class ReadingVariables:
    """Symbols or numbers of one reading."""

    # position of the tool and rotation of the platform row by row, or ends of the bars of the leg
    # that is read (bar, end, xyz), metres (12,)
    pose: Any
    second_pose: Any  # pose at the second command of a reading between two (12,)
    mounting: Any  # numbers of the mounting, see `Observation.mounting_values` (M,)
    nuisance: Any  # nuisance parameters of the setup (K,)
    effect_parameters: Sequence[Any]  # values of the parameters of the instrument's effects (D,)


@dataclass(frozen=True)
class InstrumentPose:
    """Pose of one setup's instrument, estimated from its readings."""

    # axes of a tracker's frame in the base (3, 3)
    rotation: Array = field(default_factory=lambda: np.eye(3))
    # centre of a ball bar's ball (3,), metres
    ball_centre: Array = field(default_factory=lambda: np.zeros(3))
    # probe: mean height of the offset above its height at a level platform, metres
    mean_lift: float = 0.0

    def is_close_to(self, other: InstrumentPose) -> bool:
        """Return whether second orders of the difference between both poses are negligible."""
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
    """Prior knowledge of the poses of instruments; a standard deviation of 0 means exact."""

    dial_placement_sd: float = 0.0  # of a dial's place along its leg, metres
    surface_slope_sd: float = 0.0  # of the surface against which two dials were zeroed, radians
    tracker_frame: Frame = "rigid"


@dataclass(frozen=True)
class Mounted:
    """Readings of one kind with what the mounting numbers of their formula depend on."""

    # all readings of a table, an `orthoglide.observations.Readings`, which a layer above defines
    table: Any
    rows: NDArray[np.intp]  # those of this kind (m,)
    geometry: Geometry  # of the machine
    instrument_poses: Sequence[InstrumentPose]  # of every setup
    # positions of all readings on their plates over the largest measured radius, along axes that
    # turn with the plate (n, 2)
    normalized_plate_xy: Array
    effects: Sequence[Effect] = ()  # that change readings of this kind

    def by_reading(self, of_setups: Iterable[Any]) -> Array:
        """Return the value of each reading's setup ``(m, ...)``, given those of all setups."""
        return np.asarray(np.array(list(of_setups))[self.table.setup[self.rows]])

    @property
    def beside(self) -> Array:
        """Offset of each reading from the tool, along the platform's axes ``(m, 3)``, metres."""
        return np.asarray(self.table.beside[self.rows])

    @property
    def signed_axes(self) -> Array:
        """The axis along which each reading is counted, with its sign ``(m, 3)``."""
        axes = np.eye(3)[self.table.axis[self.rows]]
        return np.asarray(self.table.sign[self.rows, None] * axes)


TOOL_OFFSET_COLUMNS = ("beside_x_mm", "beside_y_mm", "beside_z_mm")
"""Columns of the offset of a probe or a tip from the tool, along the platform's axes."""

SMALL_ROTATION = 1e-3
"""Radians: the second order of a smaller rotation moves less than a micrometre."""

SMALL_SHIFT = 1e-5
"""Metres: the square of a smaller shift over a machine's size is below a nanometre."""

OBSERVATIONS: dict[str, Observation] = {}
"""All kinds of readings by their name in files; each subclass of `Observation` registers itself."""


@public
@dataclass(frozen=True)
class Setup:
    """One mounting of one instrument; by default of a dial on a leg.

    Attributes:
        name: label, unique within its file.
        leg: 0, 1 or 2: the leg that is read; -1 if the tool is read.
        axis: 0, 1 or 2: the base axis along which a leg is read, not the leg's own; -1 where each
            reading has its own axis, or none.
        sign: +1, or -1 where the dial counts against the axis.
        gauge: position of the dial along the leg's own axis, metres; mechanical coordinate minus
            the offset r of equation (2) of the 2008 paper, see ``layout/orthoglide.py``.
        bar: 1 or 2 for a bar, 0 for the leg's median line.
        kind: kind of its readings, a key of `OBSERVATIONS`.
        gauge2: position of the second dial, as ``gauge``, if a reading is the difference of two.
        beside: offset of the reading from the commanded point of the tool, along x, y and z of the
            platform, metres; z is negative for a longer tool.
        turned: rotation of a plate on its seat, counter-clockwise from above, in degrees as in
            files, unlike all other angles; the shape of the plate turns with it.
        material: of a part on which distances are read, a key of `SHRINKAGE_BY_MATERIAL`.

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
            raise InputError(
                f"setup {self.name!r}: leg is {self.leg!r}, which is a kind of reading and not a "
                f"leg; pass it as kind={self.leg!r}"
            )
        if problem := self.observation.setup_error(self):
            raise InputError(f"setup {self.name!r}: {problem}")

    @property
    def observation(self) -> Observation:
        """The kind of its readings."""
        return OBSERVATIONS[self.kind]

    @property
    def gauges(self) -> tuple[float, ...]:
        """Position of each of its dials along the leg's own axis, as ``gauge``, metres."""
        return (self.gauge, self.gauge2)[: self.observation.dials]

    @property
    def direction(self) -> str:
        """The axis with its sign as files write it: ``"y"`` or ``"-y"``; empty without one."""
        return "" if self.axis < 0 else ("-" if self.sign < 0 else "") + LEGS[self.axis]


@dataclass(frozen=True)
class SetupReadings:
    """Readings of one setup, from which the pose of its instrument is estimated."""

    p: Array  # measured point on the machine, the tool or a point beside it (m, 3), metres
    offset_from_tool: Array  # part of p: from the tool, turned with the platform (m, 3), metres
    axis: Ints  # base axis that is read (m,)
    value: Array  # readings, counted along that axis (m,); nan where not taken yet
    sigma: Array  # standard deviation of each (m,)


_LEAST_NOISE_RATIO = 0.05  # share of the usual noise


class Observation(ABC):
    """One kind of reading."""

    kind: ClassVar[str]  # its name in files
    # in words: the instrument, and what is read, where `{}` or `{0}` stands for the axis and `{1}`
    # for the leg
    instrument_phrase: ClassVar[str]
    quantity_phrase: ClassVar[str]
    # what to write on a sheet, and where commands are places, if it differs
    sheet_instruction: ClassVar[str]
    sheet_instruction_place: ClassVar[str] = ""
    suggestion_suffix: ClassVar[str] = ""  # follows the instrument where readings are proposed
    nuisance_summary: ClassVar[str]  # the nuisance parameters, for the documentation
    repeatability: ClassVar[float]  # standard deviation of one reading where nothing is known
    # least standard deviation accepted from repeats, as copied readings show none
    least_noise: ClassVar[float]
    angular: ClassVar[bool] = False  # whether readings are in radians; metres otherwise
    dials: ClassVar[int] = 0  # dials on a leg per reading; 0 if the tool is read
    protocol: ClassVar[Literal["sweep", "parallelism"]]  # recommended for dials
    axes: ClassVar[tuple[int, ...]] = ()  # base axes along or about which it reads, if any
    touches: ClassVar[bool] = False  # whether it touches a plate
    paired: ClassVar[bool] = False  # whether a reading is between two commands
    about_ball: ClassVar[bool] = False  # whether it reads about a fixed ball
    # columns of files that belong to a mounting, besides its name
    setup_columns: ClassVar[tuple[str, ...]] = TOOL_OFFSET_COLUMNS
    min_postures: ClassVar[int] = 1  # distinct postures that a setup needs
    nuisance_count: ClassVar[int]  # number `K` of nuisance parameters of a setup
    drifting_count: ClassVar[int] = 9  # how many of them, from the first, may drift: here all

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
        """Whether only differences between readings of a setup are informative."""
        return self.min_postures > 1

    @property
    def unit(self) -> str:
        """Unit of its readings in files and texts."""
        return "mrad" if self.angular else "mm"

    def is_affected_by(self, effect: Effect, setup: Setup | None = None) -> bool:
        """Return whether an effect of instruments changes readings of a setup; without one, whether
        it can change readings of this kind.
        """
        return False

    def setup_error(self, setup: Setup) -> str:
        """Return what is wrong with a setup of this kind, as a clause; empty if nothing is."""
        return "" if setup.leg < 0 else f"a setup of kind {self.kind} touches no leg"

    @abstractmethod
    def formula(self, row: ReadingVariables, effects: Sequence[Effect]) -> Any:
        """Return the expected reading; effects of the instrument are in the order of their
        parameters.
        """

    @abstractmethod
    def mounting_values(self, mounted: Mounted) -> Array:
        """Return the numbers of the mountings that the formula uses ``(m, M)``."""

    def nuisance_sds(self, setup: Setup, axis: Ints, priors: InstrumentPriors) -> Array:
        """Return prior standard deviations of the nuisance parameters, of mean zero ``(K,)``, of a
        setup that reads base axes ``(m,)``: infinite where nothing is known, as of all by default,
        0 where the setup does not have the parameter.
        """
        return np.full(self.nuisance_count, np.inf)

    def shared_nuisance_name(self, setup: Setup, index: int) -> str:
        """Return the name under which setups of a file share a nuisance parameter; empty if it is
        specific to the setup.
        """
        return ""

    def estimate_pose(
        self, readings: SetupReadings, initial: InstrumentPose | None, priors: InstrumentPriors
    ) -> InstrumentPose:
        """Return the pose of a setup's instrument, estimated from its readings at the points where
        a machine takes them, and from an initial estimate if there is one.
        """
        return initial or InstrumentPose()

    def apply_pose_nuisances(
        self, pose: InstrumentPose, nuisance: Array
    ) -> tuple[InstrumentPose, Array]:
        """Move displacements of the instrument from the nuisance vector into its pose; return the
        pose and the remaining vector ``(K,)``.

        If the formula is exact in the nuisances, both are returned unchanged.
        """
        return pose, nuisance

    def find_unit_or_frame_error(
        self, readings: SetupReadings, distance: Array, priors: InstrumentPriors
    ) -> str:
        """Return a sentence on the unit or frame in which a setup's readings seem to be given by
        mistake; empty where they are plausible. ``distance``: that which the expected machine has
        to the point of the second command ``(m,)``, metres.
        """
        return ""

    def placement_warnings(
        self, pose: InstrumentPose, p: Array, axis: Ints
    ) -> Iterator[tuple[str, str]]:
        """Yield warnings about the estimated pose of an instrument, sentences with their kind, by
        the measured points ``(m, 3)``, metres, and the base axis of each reading ``(m,)``.
        """
        yield from ()

    def sheet_points(self, ring: Array) -> tuple[Array, Array | None]:
        """Return the points of a measuring sheet ``(k, 3)``, and the second ones of a paired kind,
        by points on a circle of radius 1 about z ``(m, 3)``.
        """
        return np.concatenate([ring, ring[:, [2, 0, 1]], ring[:, [1, 2, 0]]]), None


Vector = Sequence[Any]
"""Three numbers or symbols."""


def vector(values: Any, first: int = 0) -> Vector:
    """Return three successive entries of a row."""
    return [values[first + k] for k in range(3)]


def dot(u: Vector, v: Vector) -> Any:
    """Return the scalar product of two vectors."""
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


def linear_combination(*terms: tuple[Any, Vector]) -> Vector:
    """Return the sum of vectors, each multiplied by its factor."""
    return [sum(factor * v[k] for factor, v in terms) for k in range(3)]


def length(v: Vector) -> Any:
    """Return the length of a vector."""
    return dot(v, v) ** 0.5


def reading_point(pose: Any, offset: Vector) -> Vector:
    """Return the point at an offset from the tool, along the platform's axes ``(3,)``."""
    turned_offset = [dot(vector(pose, 3 + 3 * k), offset) for k in range(3)]
    return linear_combination((1, vector(pose)), (1, turned_offset))
