"""Effects, machines and planes of the workspace: the mechanism, and the reduction fitted to it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from orthoglide import reduction
from orthoglide.arguments import public
from orthoglide.errors import InputError, NumericsError, check_integer, check_list
from orthoglide.figures import style
from orthoglide.figures.draw import draw_levels
from orthoglide.geometry import Array, Geometry
from orthoglide.machine import Machine, MachineSource
from orthoglide.mechanism.perfect_legs import Spheres, commands
from orthoglide.observations import Readings
from orthoglide.observations.protocols import protocol
from orthoglide.ordering import best_of, ranked
from orthoglide.prediction import Conditions, MeasurementModel
from orthoglide.reduction.spheres import Mode, intersect_spheres
from orthoglide.units import ONE, Unit

TCP_LIMIT = 5e-6
"""Metres: the reduction is good enough where its fitted TCP is nowhere further off ..."""

READING_LIMIT = 5e-6
"""... and its fitted readings are no further off, rms: half the step of a workshop dial."""

EQUAL_WITHIN = 1e-9
"""Metres: differences that are closer together than this count as equal."""

# The workspace is visited twice: cold, at time zero, every axis arriving in the + direction; then
# warm, at the end, every axis arriving in the - direction. Six constants must do for both. Where
# the machine file gives a stiffness, the load deforms the machine too.
POINTS = 7  # of the workspace along each axis
WARMING = 5.0  # kelvin from the first visit to the second, and over the campaign
DURATION = 3600.0  # seconds from the first visit to the second
LOAD = 10.0  # newtons at the TCP along base -z, always
PITCH = 0.016  # of the screws, metres, where the machine file names none

_FIT_TOLERANCE = 1e-14  # relative changes at which a fit ends, close to rounding
_NAN = float("nan")


@dataclass(frozen=True)
class Difference:
    """Distance of two TCPs over the workspace, metres."""

    mean: float  # over all points
    max: float  # the largest


@dataclass(frozen=True)
class Row:
    """Difference of reduction and mechanism with one effect, or with all errors of a machine.

    What is compared in readings is nan where dials do not stand on legs.
    """

    name: str  # of the parameter, or `"machine"`
    effect: str  # of the parameter; empty for a machine
    unit: Unit  # in which files show the parameter
    value: float  # of the parameter, SI; nan for a machine
    nominal: Difference  # at the TCP, all six parameters of the reduction at zero
    fitted: Difference  # with the six parameters fitted to the TCP
    six: tuple[float, ...]  # joint offsets and leg lengths fitted to the TCP, metres
    rotation: float  # largest turn of the platform, radians; the reduction's never turns
    # points of the workspace (n, 3), and the larger difference of both visits there, with the six
    # parameters fitted to the TCP (n,), metres
    at: Array = field(compare=False, repr=False)
    difference: Array = field(compare=False, repr=False)
    reading_change: float = _NAN  # what the effect does to the readings, datums fitted, rms, metres
    reading_rms: float = _NAN  # residual after the six parameters and the datums are fitted, metres
    reading_max: float = _NAN  # largest residual

    @property
    def read(self) -> bool:
        """Whether readings of dials were compared."""
        return not math.isnan(self.reading_rms)

    @property
    def good_enough(self) -> bool:
        """Whether ``TCP_LIMIT`` and ``READING_LIMIT`` hold after the fits."""
        return self.fitted.max <= TCP_LIMIT and not self.reading_rms > READING_LIMIT

    @property
    def good_up_to(self) -> float:
        """Size of the parameter, SI, up to which the reduction is sufficient, by proportion."""
        excess = self.fitted.max / TCP_LIMIT
        if self.read:
            excess = max(excess, self.reading_rms / READING_LIMIT)
        return float(abs(self.value) / excess) if excess > 1e-6 else float("inf")


def worst_by_effect(rows: Sequence[Row]) -> tuple[Row, ...]:
    """Return for every effect the row with the largest difference, in the order of the rows.

    Of equal rows it is the one with the largest residual of the readings, or the first, as for the
    legs of most effects.
    """
    by_effect: dict[str, list[Row]] = {row.effect: [] for row in rows}
    for row in ranked(rows, lambda row: row.reading_rms, EQUAL_WITHIN):
        by_effect[row.effect].append(row)
    return tuple(
        best_of(members, lambda row: row.fitted.max, EQUAL_WITHIN) for members in by_effect.values()
    )


def cube(geometry: Geometry) -> tuple[float, float]:
    """Return the ends, along every axis, of the largest cube of TCP points that the strokes reach,
    metres.

    By eq. (3) the carriage goes farthest out at ``p = (high, 0, 0)`` and farthest in at the corner
    ``low + sqrt(L^2 - 2 max(low^2, high^2)) = L + stroke_low``.
    """
    inner, high = geometry.L + geometry.stroke[0], geometry.stroke[1]
    low = (inner - np.sqrt(3 * geometry.L**2 - 2 * inner**2)) / 3
    if -low < high:
        low = inner - np.sqrt(geometry.L**2 - 2 * high**2)
    return float(low), float(high)


def grid(geometry: Geometry, count: int) -> Array:
    """Return TCP points ``(n, 3)`` that fill the workspace evenly, metres.

    On the Orthoglide they fill the cube with ``count`` points along each axis; other layouts have
    points of their own.
    """
    points = geometry.layout.points(geometry.L, geometry.r, geometry.stroke, count)
    if points is not None:
        return points
    side = np.linspace(*cube(geometry), count)
    return np.stack(np.meshgrid(side, side, side, indexing="ij"), -1).reshape(-1, 3)


class Comparison:
    """The workspace of a machine, and a campaign of dials where they stand on legs."""

    def __init__(self, machine: MachineSource | None = None, points: int = POINTS) -> None:
        plain = Machine.of(machine).with_only({})
        pitch = plain.spec.screw_pitch or PITCH
        self.machine = replace(plain, spec=replace(plain.spec, screw_pitch=pitch))
        self.geometry, self.model = plain.geometry, self.machine.model
        places = grid(self.geometry, check_integer("points", points, 2))
        self.p = np.tile(places, (2, 1))
        rho = commands(Spheres.of_geometry(self.geometry), places)
        late = np.repeat([0.0, 1.0], len(rho))  # of the two visits
        self.conditions = Conditions.from_commands(
            np.tile(rho, (2, 1)), approach=np.tile(1.0 - 2.0 * late[:, None], 3),
            time=late * DURATION, warming=late * WARMING, load=LOAD,
        )  # fmt: skip
        zero = intersect_spheres(self.geometry.centres, self.geometry.L)
        self.mode: Mode = "machine" if np.abs(zero).max() < EQUAL_WITHIN else "other"

    @cached_property
    def campaign(self) -> Readings:
        """A sweep that warms up evenly, under the load, for dials on an Orthoglide's legs."""
        blank = protocol("sweep", self.geometry)
        warmth = 20.0 + WARMING * blank.time / blank.time.max()
        return replace(blank, temperature=warmth, load=np.full(len(blank), LOAD))

    def mechanism_tcp(self, values: Mapping[str, float]) -> tuple[Array, float]:
        """Return the TCP ``(n, 3)`` of the mechanism, and the platform's largest turn, radians."""
        from scipy.spatial.transform import Rotation  # which is slow to load

        distinct, rows = self.conditions.merged(self.model.needed_conditions(values))
        outputs = self.model.outputs(values, distinct)
        return outputs.p[rows], float(Rotation.from_matrix(outputs.R).magnitude().max())

    def reduction_tcp(self, six: Array) -> Array:
        """Return the TCP ``(n, 3)`` of the reduction with offsets and lengths ``(6,)``, metres."""
        travel = self.conditions.command - self.geometry.zero + six[:3]
        centres = self.geometry.centres + travel[..., None] * self.geometry.slides
        return intersect_spheres(centres, self.geometry.L + six[3:], self.mode)

    def fit_tcp(self, p: Array) -> Array:
        """Return offsets and lengths ``(6,)`` fitted to the TCP by least squares."""
        return _least_squares(lambda six: (self.reduction_tcp(six) - p).ravel())

    def row(self, name: str, value: float, values: Mapping[str, float]) -> Row:
        """Return the comparison for parameters ``values``; name and value are for the table."""
        tcp, rotation = self.mechanism_tcp(values)
        six = self.fit_tcp(tcp)
        effect = None if np.isnan(value) else self.machine.catalogue.effect_of(name)
        nominal = np.linalg.norm(tcp - self.p, axis=1)
        left = np.linalg.norm(tcp - self.reduction_tcp(six), axis=1)
        return Row(
            name=name,
            effect=effect.name if effect else "",
            unit=effect.unit if effect else ONE,
            value=value,
            nominal=Difference(float(nominal.mean()), float(nominal.max())),
            fitted=Difference(float(left.mean()), float(left.max())),
            six=tuple(six.tolist()),
            rotation=rotation,
            at=self.p[: len(left) // 2],
            difference=left.reshape(2, -1).max(axis=0),
            **(self._reading_figures(values) if self.geometry.dialled else {}),
        )

    def _reading_figures(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return the fields of a row that come from readings of dials."""
        campaign, dials = self.campaign, MeasurementModel(self.campaign)
        datums = np.eye(len(campaign.setups))[campaign.setup]
        mean = datums @ np.linalg.pinv(datums)

        def without_datums(rows: Array) -> Array:
            return np.asarray(rows - mean @ rows)

        readings = dials.predict(self.model, values)
        change = without_datums(readings - dials.predict(self.model, {}))
        setups = [campaign.setups[k] for k in campaign.setup]
        axes, gauges, signs = zip(*((s.axis, s.gauge, s.sign) for s in setups), strict=True)

        def residual(six: Array) -> Array:
            predicted = reduction.predict_readings(
                campaign.command, campaign.leg, axes, gauges, *np.split(six, 2),
                geometry=self.geometry,
            ).values  # fmt: skip
            return without_datums(readings - signs * predicted)

        best = residual(_least_squares(residual))
        return {
            "reading_change": float(np.sqrt(np.mean(change**2))),
            "reading_rms": float(np.sqrt(np.mean(best**2))),
            "reading_max": float(np.abs(best).max()),
        }


def _least_squares(residual: Callable[[Array], Array]) -> Array:
    """Return the offsets and lengths ``(6,)`` with the least sum of squares."""
    from scipy.optimize import least_squares  # which is slow to load

    exact = {"xtol": _FIT_TOLERANCE, "ftol": _FIT_TOLERANCE, "gtol": _FIT_TOLERANCE}
    fit = least_squares(residual, np.zeros(6), method="lm", **exact)
    if not fit.success:
        raise NumericsError("the reduction does not converge on the TCP: are the errors absurd?")
    return np.asarray(fit.x)


@public
def compare_effects(
    machine: MachineSource | None = None,
    names: Iterable[str] | None = None,
    points: int = POINTS,
) -> tuple[Row, ...]:
    """Return a row for each effect, at its tolerance on an otherwise perfect machine.

    Args:
        machine: dimensions and tolerances, or the path of its file; its identified parameters are
            left out.
        names: effects, parameters or structured members; where absent all but those of plates, and
            of dials where none stand on legs. Dials by the campaign's first setup.
        points: of the workspace along each axis.

    Raises:
        InputError: for a name that is no effect, or one of dials where none stand on legs.
    """
    check_list("names", () if names is None else names)
    comparison = Comparison(machine, points)
    plain, dialled = comparison.machine, comparison.geometry.dialled
    setups = [setup.name for setup in comparison.campaign.setups] if dialled else []
    if names is None:
        effects = [e for e in plain.catalogue.values() if not e.of_body]
        names = [e.name for e in effects if dialled or not e.of_dial]
    rows = []
    for name in plain.catalogue.expand(names, setups[:1]):
        if plain.catalogue.effect_of(name).of_dial and not dialled:
            raise InputError(f"{name}: dials are set against the legs of an Orthoglide alone")
        value = plain.tolerance(name)
        weights = plain.catalogue.elementary_weights(name, setups)
        rows.append(comparison.row(name, value, {n: w * value for n, w in weights.items()}))
    return tuple(rows)


@public
def compare_machine(machine: MachineSource, points: int = POINTS) -> tuple[Row, ...]:
    """Return rows for a calibrated machine: all of its parameters together, then each alone.

    Args:
        machine: with the parameters to compare for.
        points: of the workspace along each axis.

    Returns:
        Row ``"machine"`` first, then one for every parameter that is not zero.
    """
    machine = Machine.of(machine)
    comparison, effect_of = Comparison(machine, points), machine.catalogue.effect_of
    values = {n: value for n, value in machine.values.items() if value and not effect_of(n).of_body}
    single_rows = (comparison.row(name, value, {name: value}) for name, value in values.items())
    return (comparison.row("machine", float("nan"), values), *single_rows)


_UM = 1e6

LIMITS = (
    f"The simplified model will do where, after its six parameters are fitted, the TCP is nowhere "
    f"more than {TCP_LIMIT * _UM:g} µm and the readings no more than {READING_LIMIT * _UM:g} µm "
    f"rms from the mechanism."
)
"""When the simplified model will do."""

_LEGEND = (
    "Differences once the six parameters are fitted, turns of the platform in µrad; up to: the "
    "largest size at which the simplified model will do, by proportion."
)
_NOT_READ = " Readings are not compared: dials are set against the legs of an Orthoglide alone."


def micrometres(value: float) -> str:
    """Return a length in micrometres, three digits at most; below a nanometre it counts as 0."""
    um = abs(value) * _UM
    if um < 1e-3:
        return "0"
    return f"{um:.{max(0, min(2, 2 - math.floor(math.log10(um))))}f}"


def _size_text(row: Row, value: float, machine: str) -> str:
    if math.isnan(value):
        return machine
    if math.isinf(value):
        return "any"
    return f"{value / row.unit.si:.2g}" + row.unit.behind


_OF_READINGS = "readings differ, rms, µm"
_COLUMNS: dict[str, Callable[[Row], str]] = {
    "effect": lambda row: row.name,
    "size": lambda row: _size_text(row, row.value, "all"),
    "TCP differs, max, µm": lambda row: micrometres(row.fitted.max),
    "platform turns": lambda row: micrometres(row.rotation),
    _OF_READINGS: lambda row: micrometres(row.reading_rms),
    "will do": lambda row: "yes" if row.good_enough else "no",
    "up to": lambda row: _size_text(row, row.value and row.good_up_to, "–"),
}
_SHORT = ("effect", "TCP differs, max, µm", _OF_READINGS, "will do")


def short_table(
    rows: Sequence[Row], columns: Iterable[str] = _SHORT
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return heads and rows of a table, by default for the terminal; that of readings only where
    some were compared.
    """
    read = any(row.read for row in rows)
    heads = tuple(head for head in columns if read or head != _OF_READINGS)
    return heads, [tuple(_COLUMNS[head](row) for head in heads) for row in rows]


def markdown_table(rows: Sequence[Row], columns: Iterable[str] = tuple(_COLUMNS)) -> str:
    """Return the table in Markdown, turns of the platform in microradians."""
    heads, cells = short_table(rows, columns)
    names = [f"`{name.replace('|', '/')}`" for name, *_ in cells]
    lines = [heads, *((name, *row[1:]) for name, row in zip(names, cells, strict=True))]
    text = ["| " + " | ".join(line) + " |" for line in lines]
    text.insert(1, "|" + "---|" * len(heads))
    return "\n".join(text) + "\n"


def comparison_files(
    machine: Machine,
    whole: Sequence[Row],
    rows: Sequence[Row],
    drawn: Sequence[Row] = (),
) -> dict[str, str]:
    """Return the files of a comparison's folder by name: the rows of the whole machine and of every
    effect, and figures of those in ``drawn`` that the reduction cannot follow.
    """
    legend = f"{LIMITS} {_LEGEND}{'' if any(row.read for row in (*whole, *rows)) else _NOT_READ}"
    text = f"# When the simplified model is good enough\n\n{legend}\n"
    if whole:
        title = f"{machine.spec.title}: all it has, and each alone"
        text += f"\n## {title}\n\n{markdown_table(whole)}"
    if rows:
        text += f"\n## Every effect at its tolerance\n\n{markdown_table(rows)}"
    files = {"table.md": text}
    for row in drawn:
        if not row.effect or (not row.good_enough and row.fitted.max > 0):
            shown = [(f"{row.name}, µm", row.difference * _UM, style.FIT)]
            title = f"{row.name}: difference at the TCP over the workspace, µm"
            drawing = draw_levels(row.name, title, shown, row.at, "{} of the TCP")
            files[f"figures/{row.name}.svg"] = drawing.svg
    return files
