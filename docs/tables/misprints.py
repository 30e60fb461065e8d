"""The misprints of the two papers, each shown with numbers.

``python docs/tables/misprints.py`` prints a line for each; with ``--markdown`` the section of
``docs/published-experiments.md``.
"""

from __future__ import annotations

import csv
import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import numpy as np

from orthoglide import reduction
from orthoglide.geometry import Array, Geometry

MACHINE = Geometry()
L = MACHINE.L
DATA = files("orthoglide") / "data"
COMMAND = np.array([0.350, 0.300, 0.280])  # a posture with nothing special about it
TABLE2_ROWS = tuple(
    f"{row}{sign}"
    for a, b in ("xy", "xz", "yz")
    for sign in "+-"
    for row in (f"{a}_{b}", f"{b}_{a}")
)
SETS = {"offsets+lengths": "all", "offsets": "offsets", "lengths": "lengths"}
SLIPS = (
    ("2", "offsets+lengths", "z_y+"),
    ("2", "offsets", "y_z-"),
    ("2", "lengths", "z_x+"),
    ("3", "lengths", "z_x+"),
)


@dataclass(frozen=True)
class Misprint:
    """What stands in the paper, what is right, and how one sees it."""

    where: str
    printed: str
    right: str
    seen: str


def published() -> dict[str, Any]:
    return json.loads((DATA / "published.json").read_text(encoding="utf-8"))


def table2(experiment: str) -> dict[str, float]:
    """Deviations against Zero, by row name, millimetres."""
    with (DATA / f"experiment{experiment}.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["posture"] != "zero"]
    sign = {"max": "+", "min": "-"}
    return {
        f"{row['direction']}_{row['leg']}{sign[row['posture']]}": float(row["reading_mm"])
        for row in rows
    }


def table1(experiment: str) -> dict[str, float]:
    """Differences Max - Min, by row name, millimetres."""
    with (DATA / f"experiment{experiment}-differences.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["posture"] == "max"]
    return {f"{row['direction']}_{row['leg']}": float(row["reading_mm"]) for row in rows}


def columns(experiment: str, which: str) -> dict[str, float]:
    """A column of Table 2 as printed, by row name, millimetres."""
    values = published()["table2_columns_mm"][experiment][which]
    return dict(zip(TABLE2_ROWS, values, strict=True))


def fitted(deviations: dict[str, float], which: str) -> dict[str, float]:
    """J x of system (11), by row name, millimetres."""
    system = reduction.system11(MACHINE).select(SETS[which])
    fit = reduction.solve(system, system.ordered(deviations))
    return dict(zip(system.rows, fit.fitted.tolist(), strict=True))


def rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(list(values)))))


def bar_error(p: Array, rho: Array) -> float:
    """Largest error of eq. (2) at p, as a bar's length in millimetres."""
    lengths = np.linalg.norm(p - np.diag(rho), axis=1)
    return float(np.max(np.abs(lengths - L)) * 1e3)


# --- kinematics ---------------------------------------------------------------------------------


def equation_1() -> Misprint:
    printed = -(L + MACHINE.r)
    right = reduction.inverse(np.zeros(3))[0]
    return Misprint(
        "2008 (1a-c)",
        "p = rho + cos cos L + r",
        "p = rho - cos cos L, as in (2) and (3)",
        f"legs along the axes: (1) gives rho = {printed * 1e3:.2f} mm, (3) {right * 1e3:+.2f} mm, "
        "the mechanical zero",
    )


def tool_shift() -> Misprint:
    # Eq. (1): leg x ends at the TCP less r along x alone; the printed shift moves y and z as well.
    end = MACHINE.r * (np.eye(3)[0] - np.ones(3))
    bar = np.linalg.norm(end - np.array([L, 0.0, 0.0]))
    return Misprint(
        "2008, 2.3",
        "a shift by (r, r, r) removes r",
        "r is absorbed leg by leg: rho_i becomes rho_i + r",
        f"at Zero bar x is {(bar - L) * 1e3:.2f} mm too long; leg by leg "
        f"{bar_error(np.zeros(3), MACHINE.zero):.2f} mm",
    )


def root() -> Misprint:
    plus, minus = (reduction.forward(MACHINE.zero, mode=mode)[0] for mode in ("other", "machine"))
    signs = np.sign(MACHINE.zero - reduction.forward(MACHINE.zero, mode="other"))
    return Misprint(
        "2008, root of the quadratic",
        "t = (-B + sqrt) / 2A",
        "t = (-B - sqrt) / 2A",
        f"at Zero every coordinate is {plus * 1e3:.2f} mm by the plus root, {minus * 1e3:.2f} mm "
        f"by the minus root; the plus root too has s = ({', '.join(f'{s:+.0f}' for s in signs)})",
    )


def _quadratic(rho: Array, ordered: bool) -> Array:
    """TCP by (4), the printed A, B, C and the minus root; sums over ordered pairs or not."""
    squares = rho**2
    pairs = [squares[1] * squares[2], squares[2] * squares[0], squares[0] * squares[1]]
    times = 2.0 if ordered else 1.0
    a = times * sum(pairs)
    b = np.prod(squares) - times * sum(L**2 * pair for pair in pairs)
    c = np.prod(squares) * (np.sum(squares) / 4 - 3 * L**2 / 2)
    c += times * sum(L**4 * pair for pair in pairs) / 4
    t = (-b - np.sqrt(b * b - 4 * a * c)) / (2 * a)
    return rho / 2 + t / rho - L**2 / (2 * rho)


def sums() -> Misprint:
    printed, right = (bar_error(_quadratic(COMMAND, flag), COMMAND) for flag in (True, False))
    return Misprint(
        "2008, A, B, C",
        "sums over i != j",
        "sums over unordered pairs",
        f"at rho = {_mm(COMMAND)} mm a bar is {printed:.1f} mm wrong as printed, "
        f"{right:.1f} mm mended",
    )


def _mm(values: Array) -> str:
    return "(" + ", ".join(f"{v * 1e3:.0f}" for v in values) + ")"


def coefficients_2006() -> Misprint:
    square = COMMAND**2
    product, share = np.prod(square), np.sum(square) / 4 - L**2
    pairs = square[0] * square[1] + square[1] * square[2] + square[2] * square[0]
    errors = []
    for a, b, c in ((product, product, share), (pairs, product, product * share)):
        t = (-b - np.sqrt(b * b - 4 * a * c)) / (2 * a)
        errors.append(bar_error(COMMAND / 2 + t / COMMAND, COMMAND))
    return Misprint(
        "2006, a, b, c",
        "a = product of R_i R_j; c = sum R^2 / 4 - L^2",
        "a = sum of R_i^2 R_j^2 over pairs; c = prod R^2 (sum R^2 / 4 - L^2); minus root",
        f"a bar is {errors[0]:.0f} mm wrong as printed, {errors[1]:.0f} mm mended; the units do "
        "not fit either",
    )


def _at_xmax(offset: float) -> Array:
    return reduction.forward(MACHINE.command("xmax"), np.array([offset, 0.0, 0.0]))


def jacobian_2006() -> Misprint:
    step = 1e-5
    measured = (_at_xmax(step)[1] - _at_xmax(-step)[1]) / (2 * step)
    rho = MACHINE.command("xmax")
    inverse = np.linalg.inv(reduction.jacobians(reduction.forward(rho), rho).rho)
    return Misprint(
        "2006 (5)",
        "the inverse Jacobian",
        "the Jacobian itself",
        f"dp_y/drho_x at XMax is {measured:+.4f} by differences, "
        f"{np.tan(reduction.stroke_angles()[0]):+.4f} by (5), {inverse[1, 0]:+.4f} by the inverse",
    )


def right_side_2006() -> Misprint:
    step = 1e-5
    commands = np.array([MACHINE.command("xmax"), MACHINE.zero])
    by_x, by_z = (
        np.subtract(
            *(
                (
                    reduction.predict_readings(commands, 0, 1, L / 2, o).values
                    - reduction.predict_readings(commands, 0, 1, L / 2, -o).values
                )
                / (2 * step)
            )
        )
        for o in step * np.eye(3)[[0, 2]]
    )
    row = reduction.system8().matrix[4]
    return Misprint(
        "2006 (8), rows 5 and 6",
        "y_x+, y_z+",
        "y_z+, z_y+; and its b, c are the a, b of 2008",
        f"row 5 is ({', '.join(f'{v:.4f}' for v in row)}) on offsets x, y, z, but y_x+ moves by "
        f"{abs(by_x):.4f} with offset x and by {abs(by_z):.4f} with offset z",
    )


def legs_2006() -> Misprint:
    theta, beta = 0.3, 0.2
    bar = np.array([np.cos(theta) * np.cos(beta), np.sin(theta) * np.cos(beta), -np.sin(beta)])
    swing = np.array([-np.cos(theta) * np.sin(beta), -np.sin(theta) * np.sin(beta), -np.cos(beta)])
    axis, slide, none = np.eye(3)[2], np.eye(3)[0], np.zeros(3)
    tip = L * bar
    twists = np.array(
        [
            np.r_[none, slide],
            np.r_[axis, np.cross(axis, tip)],
            np.r_[none, swing],
            np.r_[axis, none],
        ]
    )
    return Misprint(
        "2006, assumption (iii)",
        "legs of 5 degrees of freedom with three revolutes",
        "PRPaR: 4 degrees of freedom, two revolutes (as 2008 has it)",
        f"the twists of P, R, Pa, R have rank {np.linalg.matrix_rank(twists)}",
    )


def limits() -> Misprint:
    low, high = (L + travel for travel in MACHINE.stroke)
    return Misprint(
        "2008, limits of rho",
        "-100 < rho < 60 mm",
        "-100 < rho - L < 60 mm",
        f"Zero is rho = {L * 1e3:.2f} mm, the stroke {low * 1e3:.2f} to {high * 1e3:.2f} mm",
    )


def workspace() -> Misprint:
    """The claim of section 2.1 on the workspace, along the diagonal through mechanical zero."""

    def needs(side: float, middle: float) -> tuple[Array, Array]:
        # A drive goes furthest where the point is nearest to its axis: 0 is among the steps.
        steps = np.union1d(middle + np.linspace(-side / 2, side / 2, 5), 0.0)
        p = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
        rho = reduction.inverse(p)
        return rho - L, np.linalg.svd(reduction.jacobians(p, rho).rho, compute_uv=False)

    def largest(allowed: Callable[[Array], bool]) -> tuple[float, Array]:
        """Side of the largest cube whose travel is allowed, to 0.1 mm, and its factors."""
        low, high, found = 0.1, 0.25, needs(0.1, 0.0)[1]
        while high - low > 1e-4:
            side = (low + high) / 2
            tried = (needs(side, middle) for middle in np.arange(-0.05, 0.01, 5e-4))
            fitting = next((factors for travel, factors in tried if allowed(travel)), None)
            low, high, found = (low, side, found) if fitting is None else (side, high, fitting)
        return low, found

    lower, upper = MACHINE.stroke
    side, factors = largest(lambda t: bool(t.min() >= lower and t.max() <= upper))
    # At p = (t, t, t) the factors are 1 / (1 + u), twice, and 1 / (1 - 2 u) with
    # u = t / sqrt(L^2 - 2 t^2): the last is 1/2 at -L / sqrt(6) and 2 at L / sqrt(18).
    low, high = -L / np.sqrt(6), L / np.sqrt(18)
    wide = high - low
    travel, widest = needs(wide, (low + high) / 2)
    assert abs(widest.min() - 0.5) < 1e-9
    assert abs(widest.max() - 2) < 1e-9
    return Misprint(
        "2008, 2.1, workspace",
        "about 200 x 200 x 200 mm with transmission factors from 1/2 to 2",
        f"right for the mechanism; within the printed stroke {side * 1e3:.0f} mm, factors "
        f"from {factors.min():.2f} to {factors.max():.2f}",
        f"a cube of {wide * 1e3:.1f} mm has factors from {widest.min():.2f} to "
        f"{widest.max():.2f}, and needs travel from {travel.min() * 1e3:.1f} to "
        f"{travel.max() * 1e3:.1f} mm",
    )


def angle_named() -> Misprint:
    rho = MACHINE.command("xmax")
    bar = np.array([0.0, rho[1], 0.0]) - reduction.forward(rho)
    to_x, to_y = (np.degrees(np.arccos(abs(bar[axis]) / np.linalg.norm(bar))) for axis in (0, 1))
    return Misprint(
        "2008, above (8)",
        "alpha is the angle between the y-, z-legs and the X axes",
        "the angle between each leg and its own axis (as 2006 has it)",
        f"at XMax leg y makes {to_y:.2f} degrees with y and {to_x:.2f} with x; "
        f"arcsin(60 / L) = {np.degrees(reduction.stroke_angles()[0]):.2f}",
    )


# --- accuracy -----------------------------------------------------------------------------------


def angles() -> Misprint:
    high, low = np.degrees(reduction.stroke_angles())
    return Misprint(
        "2008, 3.4, angles",
        "11.0 and -18.7 degrees",
        f"{high:.1f} and {low:.1f} degrees",
        f"arcsin(60 / L) = {high:.3f}, arcsin(-100 / L) = {low:.3f} degrees",
    )


def accuracy() -> Misprint:
    system, sigma = reduction.system11(MACHINE), 0.01
    both = reduction.covariance(system, sigma)
    difference = np.hstack([np.eye(3), -np.eye(3)])
    full, fine, offsets, differences = (
        rms(np.sqrt(np.diag(v)))
        for v in (
            both,
            reduction.covariance(system, sigma / 10),
            reduction.covariance(reduction.system8(MACHINE), sigma),
            difference @ both @ difference.T,
        )
    )
    return Misprint(
        "2008, 3.4",
        "sigma 0.01 mm gives errors of 0.07 mm on all six parameters",
        f"{full:.2f} mm on all six; {offsets:.3f} mm on the offsets alone",
        f"(12) with (14): {full:.3f} mm; on offset minus length {differences:.3f} mm; "
        f"{fine:.3f} mm needs sigma = 0.001 mm",
    )


def noise_13() -> Misprint:
    # One block of (13): readings x_z0, z_x0, x_z+, z_x+, x_z-, z_x-.
    zero = np.tile(np.hstack([-np.eye(2), np.zeros((2, 4))]), (2, 1))
    right = zero + np.hstack([np.zeros((4, 2)), np.eye(4)])
    printed = right.copy()
    printed[3] = right[1]
    smallest = [np.linalg.eigvalsh(d @ d.T)[0] for d in (printed, right)]
    misfit = float(np.max(np.abs(right @ right.T - reduction.G)))
    return Misprint(
        "2008 (13), last entry",
        "z_x+",
        "z_x-",
        f"smallest eigenvalue of the covariance as printed {abs(smallest[0]):.0f}; with z_x- it is "
        f"{smallest[1]:.0f} and (14) follows, difference {misfit:.0f}",
    )


# --- tables -------------------------------------------------------------------------------------


def expected_improvement() -> Misprint:
    data, column = table2("2"), columns("2", "offsets")
    column["y_z-"] *= -1  # a slip of its own, see below
    fit = fitted(data, "offsets")
    as_fit = max(abs(column[row] - fit[row]) for row in data)
    as_residual = max(abs(column[row] - (data[row] - fit[row])) for row in data)
    return Misprint(
        'Table 2, "expected improvement"',
        "residuals",
        "fitted deviations J x (in Table 1 the same words do mean residuals)",
        f"Exp. 2 {{offsets}} is J x within {as_fit:.3f} mm, the residual within "
        f"{as_residual:.2f} mm; the rms of data minus column is "
        f"{rms(data[row] - column[row] for row in data):.2f} mm, as printed",
    )


def sign_slips() -> Misprint:
    places, printed, signs, ours = [], [], [], []
    for experiment, which, row in SLIPS:
        data = table2(experiment)
        if experiment == "3":
            data["x_z-"] = -0.13  # its own misprint, see below
        value = columns(experiment, which)[row]
        places.append(f"Exp. {experiment} {{{which}}} {row}")
        printed.append(f"{value:+.2f}")
        signs.append(f"{-value:+.2f}")
        ours.append(f"{fitted(data, which)[row]:+.3f}")
    return Misprint(
        f"Table 2, {', '.join(places)}",
        ", ".join(printed),
        ", ".join(signs),
        f"J x is {', '.join(ours)} mm",
    )


def _worst(data: dict[str, float]) -> float:
    """Largest difference of Experiment 3's 36 fitted entries from the printed, slip mended."""
    worst = 0.0
    for which in SETS:
        column = columns("3", which)
        for experiment, slipped, row in SLIPS:
            if (experiment, slipped) == ("3", which):
                column[row] *= -1
        ours = fitted(data, which)
        worst = max(worst, *(abs(ours[row] - column[row]) for row in column))
    return worst


def entry_experiment3() -> Misprint:
    data = table2("3")
    printed = data["x_z-"]
    before = _worst(data)
    data["x_z-"] = -0.13
    return Misprint(
        "Table 2, Exp. 3 data, x_z-",
        f"{printed:+.2f}",
        f"{data['x_z-']:+.2f}",
        f"the 36 fitted entries differ by up to {before:.3f} mm as printed, {_worst(data):.3f} mm "
        "mended",
    )


def entry_experiment1() -> Misprint:
    system, data = reduction.reduced_system(MACHINE).select("offsets"), table1("1")
    residuals_mm = published()["table1_expected_residual_mm"]["1"]
    expected = {row: residuals_mm[row.replace("_", "")] for row in data}
    printed, differences, averages = data["x_z"], [], []
    for value in (printed, 1.48):
        data["x_z"] = value
        residuals = reduction.solve(system, system.ordered(data)).residuals
        differences.append(np.max(np.abs(residuals - system.ordered(expected))))
        averages.append(rms(data.values()))
    return Misprint(
        "Table 1, Exp. 1, x_z",
        f"{printed:+.2f}",
        f"{1.48:+.2f}",
        f"the printed residuals differ by up to {differences[0]:.3f} mm as printed, "
        f"{differences[1]:.3f} mm mended; rms {averages[0]:.2f}, mended {averages[1]:.2f} mm, as "
        "printed",
    )


def tables_1_and_2() -> Misprint:
    parts = []
    for experiment in "23":
        first, second = table1(experiment), table2(experiment)
        apart = {row: (first[row], second[row + "+"] - second[row + "-"]) for row in first}
        off = [f"{row} {a:+.2f} / {b:+.2f}" for row, (a, b) in apart.items() if abs(a - b) > 0.0151]
        parts.append(f"Exp. {experiment}: {', '.join(off)}")
    return Misprint(
        "Table 1 against Table 2",
        "the same experiments",
        "Exp. 2 agrees but for x_y, Exp. 3 does not",
        "Table 1 / Max minus Min of Table 2, mm, beyond rounding: " + "; ".join(parts),
    )


def largest_deviation() -> Misprint:
    largest = max(abs(v) for v in table1("2").values())
    against_zero = max(abs(v) for v in table2("2").values())
    return Misprint(
        "Experiment 2, text on Table 1",
        "deviations less than 0.62 mm (2008), less than 0.70 mm (2006)",
        f"up to {largest:.2f} mm in Table 1",
        f"{against_zero:.2f} mm is the largest in Table 2; the rms of Table 1 is "
        f"{rms(table1('2').values()):.2f} mm",
    )


MISPRINTS: tuple[Callable[[], Misprint], ...] = (
    equation_1,
    tool_shift,
    root,
    sums,
    coefficients_2006,
    jacobian_2006,
    right_side_2006,
    legs_2006,
    limits,
    workspace,
    angle_named,
    angles,
    accuracy,
    noise_13,
    expected_improvement,
    sign_slips,
    entry_experiment3,
    entry_experiment1,
    tables_1_and_2,
    largest_deviation,
)

PAGE = """## Misprints of the papers

Found by computing everything the papers print. "2008" is the book chapter, with Tables 1 and 2,
"2006" the conference paper. The package follows the column "right".

| where | as printed | right | how one sees it |
|---|---|---|---|
"""

SOUND = """
Right as printed: 2008 (2), (3), (4), (5) to (9), the gauge points (10), the deviations of section
3.2, system (11) with its order of rows, (12) and (14); 2006 (2), (3), (4), (6), (7).
"""


def markdown() -> str:
    rows = (one() for one in MISPRINTS)
    lines = (f"| {m.where} | {m.printed} | {m.right} | {m.seen} |\n" for m in rows)
    return PAGE + "".join(lines) + SOUND


def main() -> None:
    if "--markdown" in sys.argv[1:]:
        sys.stdout.write(markdown())
        return
    for one in MISPRINTS:
        m = one()
        print(f"{m.where}: as printed {m.printed} / right: {m.right} / seen: {m.seen}.")


if __name__ == "__main__":
    main()
