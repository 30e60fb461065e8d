"""The contract of every effect, checked for every parameter of the catalogue alike.

A new effect must pass here before anything else: it is nothing at zero, its derivatives are right,
it has words and a tolerance, it turns with the labels of the legs, and it does what the
independent machine of ``rig.py`` does.
"""

from collections.abc import Callable
from functools import cache
from typing import get_args

import numpy as np
import pytest

from orthoglide import reduction
from orthoglide.effects import CATALOGUE
from orthoglide.effects.effect import Group
from orthoglide.errors import InputError
from orthoglide.geometry import Geometry
from orthoglide.mechanism.six_bars import LINES, ROTATION, TCP
from orthoglide.observations import Readings, Setup
from orthoglide.prediction import Conditions, MeasurementModel, Model
from orthoglide.prediction.measurement_model import LinearRows
from tests.relabelling import legs_renamed, relabelled
from tests.rig import Array, Pose, Rig, parameter_names
from tests.tiers import in_turn

PITCH = 0.02
GEOMETRY = Geometry()
# A mounting of every kind: each leg and direction, both signs, both bars and the median line.
SETUPS = (
    Setup("top", 0, 1, 1, 0.155),
    Setup("side", 0, 2, -1, 0.11, 1),
    Setup("left", 1, 0, 1, 0.2, 2),
    Setup("right", 1, 2, 1, 0.155),
    Setup("below", 2, 0, -1, 0.155),
    Setup("behind", 2, 1, 1, 0.12, 1),
)
DIAL_PARAMETERS = tuple(
    f"{name}.{setup.name}"
    for name, family in CATALOGUE.items()
    if family.group == "dial"
    for setup in (SETUPS[1], SETUPS[3])
)
NAMES = CATALOGUE.parameters + DIAL_PARAMETERS
EVERY = pytest.mark.parametrize("name", NAMES)


def orbit(name: str) -> frozenset[str]:
    """Return the names that relabelled legs make of one: a test shows that they act alike."""
    if CATALOGUE.effect_of(name).of_dial:
        return frozenset([name])
    return frozenset([name, relabelled(name), relabelled(relabelled(name))])


@cache
def model() -> Model:
    return Model(GEOMETRY, PITCH, compile=False)


def readings(values: dict[str, float], seen: Readings) -> np.ndarray:
    """Predicted readings of dials (n,), metres."""
    return MeasurementModel(seen).predict(model(), values)


def linearised(values: dict[str, float], seen: Readings, names: list[str]) -> LinearRows:
    """The same with their derivatives by parameters."""
    return MeasurementModel(seen).linearise(model(), values, names)


@cache
def campaign(load: float = 5.0) -> Readings:
    """Random postures of the stroke, all setups, everything that a condition can be."""
    rng = np.random.default_rng(1)
    n = 30
    return Readings(
        name="contract",
        setups=SETUPS,
        setup=np.arange(n) % len(SETUPS),
        command=GEOMETRY.L + rng.uniform(*GEOMETRY.stroke, (n, 3)),
        approach=rng.choice([-1.0, 0.0, 1.0], (n, 3)),
        time=np.linspace(0.0, 1740.0, n),
        temperature=np.concatenate([[24.0], 20 + 8 * rng.random(n - 1)]),
        load=load * (1 + rng.random(n)),
        repeat=np.ones(n, dtype=int),
        order=np.arange(n),
        posture=("",) * n,
        reading=np.full(n, np.nan),
        sigma=np.full(n, np.nan),
        line=np.arange(n) + 2,
    )


def tolerance(name: str) -> float:
    return CATALOGUE.effect_of(name).tolerance_si


def rig_outputs(values: dict[str, float], seen: Readings) -> tuple[Pose, Array]:
    """Poses and readings of the independent machine."""
    rig = Rig(errors=values, screw_pitch=PITCH)
    setups = [seen.setups[k] for k in seen.setup]
    rise = seen.temperature - seen.temperature[0]
    assert rise.min() < -1 < 1 < rise.max()
    pose = rig.pose(seen.command, seen.approach, seen.time, rise, seen.load)
    shown = rig.readings(
        pose.lines,
        seen.leg,
        [s.direction for s in setups],
        [s.gauge for s in setups],
        [s.bar for s in setups],
        [s.name for s in setups],
        seen.time,
    )
    return pose, shown


def outputs(values: dict[str, float], seen: Readings) -> Array:
    """TCP, rotation and bars' ends ``(n, 48)``."""
    machine = {k: v for k, v in values.items() if not CATALOGUE.effect_of(k).of_dial}
    return model().outputs(machine, Conditions.from_readings(seen)).values


@cache
def background() -> dict[str, float]:
    """Small errors of everything, so that nothing is looked at about a symmetrical point only."""
    rng = np.random.default_rng(2)
    return {
        n: 0.3 * tolerance(n) * float(rng.standard_normal())
        for n in CATALOGUE.parameters + DIAL_PARAMETERS
    }


# -- words and numbers -------------------------------------------------------------------------


@pytest.mark.parametrize("name", CATALOGUE)
def test_every_family_is_declared_in_full(name: str) -> None:
    family = CATALOGUE[name]
    assert family.name == name
    assert family.tolerance > 0
    for text in (family.because, family.sentence, family.look_at):
        assert len(text.split()) >= 4
        assert text == text.strip()
        assert not text.endswith(".")
    assert family.group in get_args(Group)
    assert bool(family.parameters()) != family.of_dial


def test_catalogue_and_rig_know_the_same_parameters() -> None:
    names = [setup.name for setup in SETUPS]
    of_legs = [name for name, effect in CATALOGUE.items() if not effect.plate]
    assert set(CATALOGUE.expand(of_legs, names)) == set(parameter_names(names))


@pytest.mark.parametrize(
    "name",
    ["joint_offset.w", "axis_tilt.x.x", "axis_tilt.x", "mount_tilt.x.c", "nose.x",
     "gauge_scale.", "gauge_scale.nowhere"],
)  # fmt: skip
def test_what_is_no_parameter_is_refused(name: str) -> None:
    with pytest.raises(InputError):
        CATALOGUE.expand([name], [setup.name for setup in SETUPS])


# -- zero, derivatives, linearity --------------------------------------------------------------


def four_point(function: Callable[[float], Array], step: float) -> Array:
    """Central differences of fourth order."""
    near, far = (function(k * step) - function(-k * step) for k in (1, 2))
    return np.asarray((8 * near - far) / (12 * step))


@pytest.mark.parametrize(("name", "about"), in_turn(NAMES, ["background", "nominal"], group=orbit))
def test_derivatives_equal_central_differences(name: str, about: str) -> None:
    seen = campaign()
    base = {} if about == "nominal" else background()
    start = base.get(name, 0.0)
    step = 0.5 * tolerance(name)
    # Below this a change of one tolerance is rounding of the readings.
    floor = 1e-13 / step

    own = linearised(base, seen, [name])
    numeric = four_point(lambda h: readings({**base, name: start + h}, seen), step)
    slope = own.jacobian[:, 0]
    assert np.abs(own.value - readings(base, seen)).max() < 1e-14
    assert np.abs(slope - numeric).max() <= 1e-6 * np.abs(numeric).max() + floor

    if not CATALOGUE.effect_of(name).of_dial:
        machine = {k: v for k, v in base.items() if not CATALOGUE.effect_of(k).of_dial}
        out, by_name = model().sensitivities(machine, Conditions.from_readings(seen), [name])
        assert np.abs(out.values - outputs(machine, seen)).max() < 1e-14
        numeric = four_point(lambda h: outputs({**machine, name: start + h}, seen), step)
        for part in (TCP, ROTATION, LINES):
            scale = np.abs(numeric[:, part]).max()
            error = np.abs(by_name[:, part, 0] - numeric[:, part]).max()
            assert error <= 1e-6 * scale + floor


# -- labels ------------------------------------------------------------------------------------


@EVERY
def test_relabelling_the_legs_relabels_the_effect(name: str) -> None:
    seen = campaign(load=0.0)
    value = 10 * tolerance(name)
    if CATALOGUE.effect_of(name).of_dial:
        turned = name  # a setup keeps its name
    else:
        turned = relabelled(name)
        assert turned in CATALOGUE.parameters
        assert relabelled(relabelled(turned)) == name
    shown = readings({name: value}, seen)
    assert np.abs(readings({turned: value}, legs_renamed(seen)) - shown).max() < 1e-13
    p, q = (outputs({n: value}, c)[:, TCP] for n, c in ((name, seen), (turned, legs_renamed(seen))))
    assert np.abs(np.roll(p, 1, axis=1) - q).max() < 1e-13


# -- other machines ----------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "times"), in_turn(NAMES, [1, 10, -10], group=orbit))
def test_agrees_with_the_independent_machine(name: str, times: int) -> None:
    seen, values = campaign(), {name: times * tolerance(name)}
    pose, shown = rig_outputs(values, seen)
    found = outputs(values, seen)
    assert np.abs(found[:, TCP] - pose.p).max() < 1e-9
    assert np.abs(found[:, ROTATION].reshape(-1, 3, 3) - pose.R).max() < 1e-9
    assert np.abs(found[:, LINES].reshape(-1, 3, 2, 2, 3) - pose.lines).max() < 1e-9
    assert np.abs(readings(values, seen) - shown).max() < 1e-9


@pytest.mark.parametrize("seed", range(5))
def test_everything_at_once_agrees_with_the_independent_machine(seed: int) -> None:
    rng = np.random.default_rng(seed)
    names = [n for n in CATALOGUE.parameters + DIAL_PARAMETERS if "compliance" not in n]
    values = {n: tolerance(n) * float(rng.standard_normal()) for n in names}
    pose, shown = rig_outputs(values, campaign())
    found = outputs(values, campaign())
    # Growth is of the nominal bar here and of the longer one there: 1e-5 of 0.05 mm.
    assert np.abs(found[:, TCP] - pose.p).max() < 1e-8
    assert np.abs(found[:, ROTATION].reshape(-1, 3, 3) - pose.R).max() < 1e-8
    assert np.abs(readings(values, campaign()) - shown).max() < 1e-8
    assert np.abs(pose.p - reduction.forward(campaign().command)).max() > 1e-3


# -- structured members ------------------------------------------------------------------------

MEMBERS = [
    (name, member)
    for name, family in CATALOGUE.items()
    if not family.of_dial
    for member in CATALOGUE.structured_members(name)
]


@pytest.mark.parametrize(("family", "member"), MEMBERS)
def test_structured_members_sum_to_their_parts(family: str, member: str) -> None:
    weights = CATALOGUE.structured_members(family)[member]
    assert set(weights) <= set(CATALOGUE.parameters)
    assert set(weights.values()) <= {1.0, -1.0}
    conditions = Conditions.from_readings(campaign())
    value = tolerance(family)
    together = model().displacements({n: w * value for n, w in weights.items()}, conditions)
    parts = [w * model().displacements({n: value}, conditions) for n, w in weights.items()]
    assert np.abs(together).max() > 0
    assert np.abs(together - sum(parts)).max() < 1e-18
    slopes = linearised({}, campaign(), list(weights)).jacobian @ list(weights.values())
    four = four_point(
        lambda h: readings({n: h * w for n, w in weights.items()}, campaign()), value / 2
    )
    assert np.abs(slopes - four).max() <= 1e-6 * np.abs(four).max() + 2e-13 / value


def test_without_a_pitch_the_screw_has_no_error() -> None:
    plain = Model(GEOMETRY, None, compile=False)
    conditions = Conditions.from_readings(campaign())
    assert not plain.displacements({"screw_error.x.sin": 1e-3}, conditions).any()
