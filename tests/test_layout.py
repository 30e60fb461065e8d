"""The linear delta against three spheres and against an independent machine of six bars."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from orthoglide.accuracy import workspace_grid
from orthoglide.effects import catalogue_of
from orthoglide.effects.wording import cause_words, parameter_words
from orthoglide.errors import FileError, InputError
from orthoglide.geometry import Geometry
from orthoglide.layout import FreeLeg, FreeLegs, LinearDelta
from orthoglide.machine import Machine
from orthoglide.machine_file import (
    Controller,
    MachineFile,
    Stiffness,
    machine_text,
    parse_machine_file,
)
from orthoglide.observations import campaign_rows, csv_text, read_tcp
from orthoglide.parameters import Parameter
from orthoglide.reduction.spheres import intersect_spheres
from orthoglide.simulation import simulate_tcp
from tests.engines import DELTA, forward, mechanism
from tests.relabelling import relabelled
from tests.rig_delta import DeltaRig, parameter_names

RIG = DeltaRig()
UNEVEN = Geometry(
    0.3455, 0.05, 0.032, (-0.17, 0.43),
    LinearDelta((0.1949, 0.195, 0.1951), (210.2, 330.07, 90.0), (0.001, -0.002, -0.04)),
)  # fmt: skip
CATALOGUE = catalogue_of(LinearDelta.names)
NAMES = CATALOGUE.parameters
# The package takes the force on a drive from the nominal posture: of a drive softer than this the
# difference shows.
SIZE = {"mm": 3e-4, "rad": 4e-3, "1": 1e-3, "mm/N": 3e-7, "1/K": 2e-5, "1/s": 1e-7}
PITCH = 0.008


def points(count: int = 12, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    r, t = 0.13 * np.sqrt(rng.random(count)), rng.random(count) * 7
    return np.stack([r * np.cos(t), r * np.sin(t), 0.15 * rng.random(count)], axis=1)


@pytest.mark.thorough
def test_a_stroke_that_lays_the_arms_flat_leaves_a_workspace_that_closes() -> None:
    """Carriages may go lower than any command: the map of the workspace stays where arms hold."""
    nominal = Machine(MachineFile(geometry=replace(DELTA, stroke=(-0.3, 0.42))))
    where = workspace_grid(nominal.geometry)
    p = nominal.forward(where)
    assert np.hypot(*p[:, :2].T).max() > 0.15
    for name in (n for n in map(str, NAMES) if n.split(".")[1] == "a"):
        for size in (-3, 3):
            wrong = nominal.with_parameters({name: size * nominal.tolerance(name)})
            assert np.isfinite(wrong.forward(where)).all()
            assert np.abs(wrong.forward(wrong.inverse(p)) - p).max() < 1e-8


@pytest.fixture(scope="module")
def machine() -> Machine:
    return Machine(MachineFile(geometry=DELTA, screw_pitch=PITCH))


def conditions(count: int, seed: int = 8) -> dict[str, np.ndarray]:
    """Everything that a condition can be, for some postures."""
    rng = np.random.default_rng(seed)
    return {
        "approach": rng.choice([-1.0, 1.0], (count, 3)),
        "time": rng.uniform(500.0, 2000.0, count),
        "warming": rng.uniform(2.0, 8.0, count),
        "load": rng.uniform(20.0, 60.0, count),
    }


def one_of(seen: dict[str, np.ndarray], k: int) -> dict[str, np.ndarray]:
    return {name: values[k] for name, values in seen.items()}


def test_every_command_that_the_arms_reach_closes_below_the_carriages() -> None:
    """Newton's method from the neutral posture ended above them, or nowhere, for a third."""
    geometry = Geometry(0.25, 0.05, 0.03, (-0.1, 0.3), LinearDelta((0.12,) * 3, tool=(0, 0, -0.04)))
    travel = np.random.default_rng(5).uniform(*geometry.stroke, (3000, 3))
    centres = geometry.centres + travel[:, :, None] * geometry.slides
    expected = intersect_spheres(centres, geometry.L)
    assert np.abs(forward(travel, geometry=geometry) - expected).max() < 1e-9
    closed = [mechanism(geometry).close(one).p for one in travel[:300]]
    assert np.abs(closed - expected[:300]).max() < 1e-9
    soft = Machine(MachineFile(geometry=geometry, stiffness=Stiffness(bar=1e8)))
    assert np.abs(soft.forward(travel[:20], load=1e-6) - expected[:20]).max() < 1e-9


def test_catalogue_and_rig_know_the_same_parameters() -> None:
    """Dials read on the legs of an Orthoglide only."""
    own = [name for name, effect in CATALOGUE.items() if effect.group not in ("dial", "part")]
    assert set(CATALOGUE.expand(own, ["bed"])) == set(parameter_names(("bed",)))


@pytest.mark.parametrize(
    "name", CATALOGUE.expand(["plate_bow", "plate_ring", "plate_saddle", "plate_trefoil"], ["bed"])
)
def test_shapes_of_a_plate_agree_with_the_independent_one(name: Parameter) -> None:
    rig, shape = DeltaRig(errors={name: 2e-4}), CATALOGUE.effect_of(name).shapes[name.direction]
    for u, v in ((0.0, 0.0), (0.9, 0.2), (-0.3, 0.7), (0.1, -1.0)):
        assert rig.plate(0.12 * u, 0.12 * v, 0.12) == pytest.approx(2e-4 * shape(u, v), abs=1e-15)


@pytest.mark.parametrize("name", NAMES)
def test_effects_agree_with_independent_geometry(machine: Machine, name: Parameter) -> None:
    value = SIZE[CATALOGUE.effect_of(name).unit.name]
    p, seen = points(4, 3), conditions(4)
    travel = np.array([RIG.inverse(q) for q in p])
    pose = machine.with_parameters({name: value}).pose(travel, **seen)
    rig = DeltaRig(errors={name: value}, screw_pitch=PITCH)
    for k in range(len(p)):
        place, turn = rig.pose(travel[k], p[k], **one_of(seen, k))
        assert np.abs(pose.p[k] - place).max() < 2e-9
        assert np.abs(Rotation.from_matrix(pose.R[k]).as_rotvec() - turn).max() < 2e-8
    assert np.abs(pose.p - p).max() + np.abs(pose.R - np.eye(3)).max() > 1e-6


@pytest.mark.parametrize("name", NAMES)
def test_relabelled_towers_are_the_same_machine_turned(machine: Machine, name: Parameter) -> None:
    value, travel = SIZE[CATALOGUE.effect_of(name).unit.name], np.array([[0.01, 0.04, -0.02]])
    turned, seen = relabelled(name, LinearDelta.names), conditions(1)
    assert turned != name
    assert turned in CATALOGUE.parameters
    one = machine.with_parameters({name: value}).forward(travel, **seen)[0]
    seen["approach"] = np.roll(seen["approach"], 1, axis=1)
    moved = np.roll(travel, 1, axis=1)
    other = machine.with_parameters({turned: value}).forward(moved, **seen)[0]
    about = Rotation.from_euler("z", 120, degrees=True)
    assert np.abs(about.apply(one) - other).max() < 1e-12


def test_machine_files_keep_the_layout() -> None:
    spec = MachineFile(name="delta", geometry=UNEVEN)
    assert parse_machine_file(machine_text(spec)) == spec
    text = machine_text(MachineFile(name="delta", geometry=DELTA))
    moved = text.replace("r = 32.0\n", "").replace("[layout]\n", "[layout]\nr_mm = 32.0\n")
    assert parse_machine_file(moved).geometry == DELTA
    with pytest.raises(FileError, match="do not reach"):
        parse_machine_file(text.replace("L = 345.0", "L = 150.0").replace("-140.0", "-100.0"))
    with pytest.raises(FileError, match="did you mean 'linear-delta'"):
        parse_machine_file(text.replace('"linear-delta"', '"linear_delta"'))
    with pytest.raises(FileError, match="keep one"):
        parse_machine_file(text.replace("[layout]\n", "[layout]\nr_mm = 30.0\n"))


def test_towers_that_cannot_be_meant_are_refused() -> None:
    with pytest.raises(InputError, match="10 degrees apart"):
        LinearDelta((0.2,) * 3, (90.0, 92.0, 210.0))
    with pytest.raises(InputError, match=r"towers a, b, c at 210, 30, 90 degrees .* all sides"):
        LinearDelta((0.2,) * 3, (210.0, 30.0, 90.0))
    with pytest.raises(InputError, match="positive"):
        LinearDelta((0.2, -0.2, 0.2))


@pytest.mark.parametrize("name", ["le.ft", "m d", "", "a_b", "7"])
def test_legs_that_cannot_be_called_so_are_refused(name: str) -> None:
    with pytest.raises(InputError, match="cannot be called"):
        FreeLeg(name, (0.3, 0, 0), (1, 0, 0), (0, 0, 1))


def freely(geometry: Geometry, names: str = "uvw", turn: np.ndarray | None = None) -> Geometry:
    """The same legs given one by one, the machine turned about the base frame's origin."""
    about, tool = np.eye(3) if turn is None else turn, getattr(geometry.layout, "tool", (0, 0, 0))
    legs = [
        FreeLeg(name, *map(tuple, (about @ v for v in (leg.carriage, leg.slide, leg.axes[:, 2]))))
        for name, leg in zip(names, geometry.legs, strict=True)
    ]
    layout = FreeLegs((legs[0], legs[1], legs[2]), tuple((about @ np.array(tool)).tolist()))
    return Geometry(geometry.L, geometry.d, geometry.r, geometry.stroke, layout)


@pytest.mark.parametrize("geometry", [Geometry(), DELTA, UNEVEN], ids=["ortho", "delta", "uneven"])
def test_legs_given_freely_are_the_machine(geometry: Geometry) -> None:
    one, free = Machine(MachineFile(geometry=geometry)), freely(geometry)
    other = Machine(MachineFile(geometry=free))
    rng = np.random.default_rng(2)
    travel = rng.uniform(-0.02, 0.03, (6, 3))
    for name in ("axis_tilt.{}.{}", "mount_tilt.{}.b", "leg_length.{}", "rail_tilt.{}.{}"):
        for k, leg in enumerate(geometry.leg_names):
            b = geometry.layout.names.across[k][0]
            ours = one.with_parameters({name.format(leg, b): 2e-4})
            theirs = other.with_parameters({name.format("uvw"[k], "b"): 2e-4})
            command = geometry.zero + travel
            assert np.abs(ours.forward(command) - theirs.forward(travel)).max() < 1e-12
    p = one.forward(geometry.zero + travel)
    assert np.abs(other.inverse(p) - travel).max() < 1e-11


@pytest.mark.parametrize(("digits", "longer"), [(2, 0.02), (6, -0.02), (6, 0.0), (6, 1e-3)])  # mm
def test_free_legs_that_touch_need_no_micrometres(
    longer: float, digits: int, tmp_path: Path
) -> None:
    """A bar along its slide: 0.02 mm of it moved the joint by a millimetre, and digits left out
    were refused.
    """
    turn = Rotation.from_rotvec([0.3, -0.5, 0.8]).as_matrix()
    geometry, file = freely(Geometry(), turn=turn), tmp_path / "machine.toml"
    text = machine_text(MachineFile(name="free", geometry=geometry))
    text = text.replace("L = 310.25", f"L = {310.25 + longer}")
    origins = re.compile(r"(?<=origin_mm = \[)[^\]]*")
    rounded = origins.sub(
        lambda m: ", ".join(f"{float(v):.{digits}f}" for v in m[0].split(",") if v.strip()), text
    )
    assert rounded != text
    file.write_text(rounded)
    machine, exact = Machine.load(file), Machine(MachineFile(geometry=geometry))
    travel = np.random.default_rng(1).uniform(-0.04, 0.04, (30, 3))
    off = machine.forward(travel) - exact.forward(travel)
    assert np.abs(off - off.mean(axis=0)).max() < 2e-6
    slack = file.read_text().replace(f"L = {310.25 + longer}", "L = 310.1")
    file.write_text(slack)
    with pytest.raises(FileError, match="do not reach"):
        Machine.load(file)


def test_machine_files_keep_free_legs() -> None:
    for geometry in (freely(Geometry()), freely(UNEVEN, ("left", "right", "back"))):
        spec = MachineFile(name="free", geometry=geometry)
        assert parse_machine_file(machine_text(spec)) == spec
    text = machine_text(MachineFile(name="free", geometry=freely(DELTA)))
    assert "[layout.leg.u]" in text
    for old, new, phrase in (
        ("[layout.leg.w]", "[layout.leg.w_w]", "cannot be called"),
        ("[layout.leg.w]", "[layout.other.w]", "no key 'other'"),
        ("    1.0,\n]", "    -1.0,\n]", "turn it round"),
        ("L = 345.0", "L = 145.0", "do not reach"),
        ("origin_mm", "orign_mm", "did you mean 'origin_mm'"),
    ):
        assert old in text
        with pytest.raises(FileError, match=phrase):
            parse_machine_file(text.replace(old, new).replace("-140.0", "-100.0"))


def test_free_legs_say_their_directions() -> None:
    catalogue = catalogue_of(freely(DELTA).layout.names)
    said = cause_words(catalogue, "axis_tilt.u.b", {"axis_tilt.u.b": 2e-3})
    assert "toward b by 2 mrad" in said
    assert "pivots" in cause_words(catalogue, "mount_tilt.u.b", {"mount_tilt.u.b": 2e-3})
    assert "toward c" in parameter_words(catalogue.parameter("axis_offset.u.c"))
    with pytest.raises(InputError, match="across its slide"):
        FreeLeg("u", (0.3, 0, 0), (1, 0, 0), (1, 0, 1)).axes  # noqa: B018


def test_points_of_a_delta_are_written_and_read_by_its_controller_s_count(tmp_path: Path) -> None:
    counting = Controller(zero=(0.2, 0.21, 0.22), sign=(-1, -1, -1))
    spec = MachineFile(geometry=DELTA, controller=counting)
    drawn = replace(simulate_tcp(Machine(spec), 5), approach=np.ones((15, 3)))
    rows = campaign_rows(drawn, spec)
    assert list(rows[0]) == [
        *(f"travel_{k}_mm" for k in "abc"), *(f"p_{k}_mm" for k in "xyz"),
        *(f"approach_{k}" for k in "abc"),
    ]  # fmt: skip
    assert float(rows[0]["travel_b_mm"]) == pytest.approx(210 - 1e3 * drawn.command[0, 1])
    file = tmp_path / "points.tcp.csv"
    file.write_text(csv_text(rows))
    again = read_tcp(file, spec)
    for name in ("command", "p", "approach"):
        found, given = (getattr(one.points(), name) for one in (again, drawn))
        assert found == pytest.approx(given, abs=1e-9)
    with pytest.raises(FileError, match="give its machine file"):
        read_tcp(file)
