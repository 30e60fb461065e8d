"""An effect is one declaration: nobody else knows it by name; a user's own does all it should."""

import json
import math
import pickle
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import orthoglide as og
from orthoglide.effects import CATALOGUE, Effect, Motion, Words, cos, once, sin
from orthoglide.effects.custom import load_effects
from orthoglide.effects.dials import dial_free_forms
from orthoglide.effects.effect import Constant, sideways
from orthoglide.effects.wording import cause_words, confirm_words, value_words
from orthoglide.errors import InputError
from orthoglide.parameters import Parameter
from orthoglide.result import Explanation
from orthoglide.units import MM
from tests.test_cli import run

PACKAGE = Path(og.__file__).parent


# -- effects of a user's own --------------------------------------------------------------------


def _sine(c):
    return 0.0 if c.pitch is None else sin(4 * np.pi * c.nominal_travel / c.pitch)


def _cosine(c):
    return 0.0 if c.pitch is None else cos(4 * np.pi * c.nominal_travel / c.pitch)


(CARRIAGE_PLAY,) = load_effects(PACKAGE.parent / "examples" / "carriage_play.py")
SECOND_HARMONIC = Effect(
    "encoder_second",
    MM,
    0.02,
    because="an encoder disc sits a hundredth out of true",
    sentence="the encoder errs twice a turn of its screw",
    look_at="the encoder's disc",
    members=lambda leg: {"sin": (Motion("travel", _sine),), "cos": (Motion("travel", _cosine),)},
    paired=True,
    group="drive",
)


def sheet(machine: og.Machine) -> og.Campaign:
    return og.protocol("sweep", machine.geometry)


@pytest.fixture(scope="module")
def machine() -> og.Machine:
    rough = og.Machine.load(Path(__file__).parent / "data" / "rig" / "machine.toml")
    return rough.with_effects([CARRIAGE_PLAY, SECOND_HARMONIC])


def test_words_are_texts_with_blanks_or_functions() -> None:
    words = (
        Words("leg {leg} {toward} sags {more|less} by {size}, a tenth {mm:0.1}", "leg {leg} sags"),
        Words(lambda p, v: f"leg {p.leg} sags {v * 1e3:g} mm", lambda p: f"leg {p.leg} sags"),
    )
    parameter = Parameter("sag", "x", "z")
    blanks, functions = (replace(CARRIAGE_PLAY, name="sag", words=one) for one in words)
    said = value_words(blanks, parameter, -2e-3)
    assert said == "leg x −z sags less by 2 mm, a tenth 0.2 mm"
    assert value_words(functions, parameter, -2e-3) == "leg x sags -2 mm"
    with pytest.raises(InputError, match=r"the blank \{height\}: use size, mm"):
        Words("{height} too high")
    for text in ("100 % { x", "{mm:a} long", "{leg.foo}", "{} long"):
        with pytest.raises(InputError, match="are not a text with valid blanks"):
            Words(text)


@pytest.mark.parametrize(
    ("effect", "test"),
    [(SECOND_HARMONIC, "look at the encoder's disc: expect an amplitude of 0.05 mm"),
     (CATALOGUE["screw_error"], "set a dial on carriage y .* to span 0.1 mm")],
    ids=lambda e: getattr(e, "name", ""),
)  # fmt: skip
def test_a_pair_has_a_test_that_confirms_it(machine: og.Machine, effect: Effect, test: str) -> None:
    values = {f"{effect.name}.y.sin@one": 9.0} | {
        f"{effect.name}.y.{part}": v for part, v in (("sin", -3e-5), ("cos", 4e-5))
    }
    one = Explanation(f"{effect.name}.y", tuple(values), 1.0, values, values, machine.catalogue)
    assert re.fullmatch(test, one.confirm)


def test_mistakes_are_refused() -> None:
    with pytest.raises(InputError, match="two effects"):
        CATALOGUE.with_effects([Effect("backlash", MM, 1.0, "", "", "")])
    with pytest.raises(InputError, match="above 0"):
        Effect("play", MM, 0.0, "", "", "")
    wrong = Effect("play", MM, 1.0, "", "", "", members=once(Motion("nowhere", lambda _: 1.0)))
    with pytest.raises(InputError, match="must move a virtual joint"):
        og.Machine.nominal().with_effects([wrong]).with_parameters({"play.x": 1e-3}).forward(
            [0.31, 0.31, 0.31]
        )


@pytest.mark.parametrize(
    ("joint", "basis", "told"),
    [
        ("lateral_b", lambda c: math.sin(c.travel / 0.02), "no finite number: .* with sin and"),
        ("lateral_b", lambda c: 1.0 if c.travel > 0 else 0.0, "on symbols .* without math"),
        ("lateral_b", lambda c: c.travel / 0.0, "no finite number"),
        ("lateral_b", lambda c: None, "None"),
        ("lateral_b", lambda c: c.temperature, "no attribute 'temperature'"),
        ("lateral_b", lambda c: sin(c.travel / c.pitch), "c.pitch is None"),
        ("travel", lambda c: c.travel, "use c.command or c.nominal_travel"),
        ("travel", lambda c: c.u**2, "use c.command or c.nominal_travel"),
    ],
)
def test_bases_that_cannot_be_computed_are_refused(
    joint: str, basis: Callable[[Any], Any], told: str
) -> None:
    wrong = Effect("mine", MM, 1.0, "", "", "", members=once(Motion(joint, basis)))
    with pytest.raises(InputError, match=rf"^mine\.x: its basis .*{told}"):
        og.Machine.nominal().with_effects([wrong])


def test_a_dial_that_cannot_be_computed_is_refused() -> None:
    wrong = Effect("mine", MM, 1.0, "", "", "", dial=lambda r, v: math.sin(r.shown) * v)
    with pytest.raises(InputError, match=r"^mine: its basis gives no finite"):
        og.Machine.nominal().with_effects([wrong])
    for other in ({"unit": "mm"}, {"members": ()}):
        with pytest.raises(InputError, match="mine: unit is one like MM"):
            Effect(**{"name": "mine", "unit": MM, "tolerance": 1.0, "because": "", "sentence": "",
                      "look_at": ""} | other)  # fmt: skip


def test_machines_with_effects_of_a_module_travel() -> None:
    travels = [
        Effect("drive_twice", MM, 1.0, "", "", "", members=once(Motion("travel", _sine))),
        Effect("shift", MM, 1.0, "", "", "", members=once(Motion("lateral_b", Constant(1.0)))),
        Effect("wave", MM, 1.0, "", "", "",
               members=sideways(lambda axis, _: (Motion(f"lateral_{axis}", _cosine),))),
    ]  # fmt: skip
    own = og.Machine.nominal().with_effects(travels).with_parameters({"shift.y": 1e-4})
    again = pickle.loads(pickle.dumps(own))
    assert again == own
    command = [[0.31, 0.3, 0.32]]
    assert np.array_equal(again.forward(command), own.forward(command))


OWN_SAG = Effect(  # that of CONTRIBUTING, which has no words
    "own_sag", MM, 0.01, "", "the rail sags between its feet", "the rail's feet",
    members=sideways(lambda axis, _: (Motion(f"lateral_{axis}", lambda c: c.u**3 - c.u),)),
)  # fmt: skip
OWN_DIAL = Effect(
    "own_dial", MM, 0.01, "", "the dial sticks", "the dial's spindle",
    dial=lambda reading, value: reading.shown + value,
)  # fmt: skip
SAID = CATALOGUE.with_effects([OWN_SAG, SECOND_HARMONIC, OWN_DIAL])


@pytest.mark.parametrize("name", list(SAID))
@pytest.mark.parametrize("sign", [1, -1])
def test_words_say_sign_size_and_part(name: str, sign: int) -> None:
    """Opposite values are said in different words, but for an amplitude without a direction."""
    effect = SAID[name]
    for parameter in effect.parameters(("top",)):
        value = sign * effect.tolerance_si
        said, other = (cause_words(SAID, parameter, {parameter: v}) for v in (value, -value))
        assert (said != other) != (effect.paired and not effect.lobes)
        assert (parameter.setup or f" {parameter.leg} ") in f"{said} "
        assert any(c.isdigit() for c in said)
        assert confirm_words(effect, parameter, value) != confirm_words(
            effect, parameter, -value
        ) or (effect.paired)


@pytest.mark.thorough
def test_ones_own_effect_on_the_command_line(machine: og.Machine, tmp_path: Path) -> None:
    worn = machine.with_parameters({"carriage_play.y.b": 1.5e-4})
    campaign, out = tmp_path / "play.csv", tmp_path / "out"
    og.write_campaign(og.simulate(worn, sheet(machine), noise=5e-6, seed=4), campaign)
    effects = ["--effects-file", str(PACKAGE.parent / "examples" / "carriage_play.py")]
    given = ["--machine", str(Path(__file__).parent / "data" / "rig" / "machine.toml"), *effects]
    done = run("close-loop", campaign, "--out", out, "--quiet", *given)
    assert done.exit_code == 0, done.output
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    assert result["effects"][0]["name"].startswith("carriage_play")
    without = run("rerun", out / "result.json")
    assert without.exit_code == 2
    assert "--effects-file" in without.output
    again = run("rerun", out / "result.json", *effects)
    assert again.exit_code == 0, again.output


OWN_FILE = str(PACKAGE.parent / "examples" / "carriage_play.py")


def test_a_machine_with_ones_own_effect_is_read_by_every_command(
    machine: og.Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    machine.with_parameters({"carriage_play.y.b": 1.5e-4}).save("worn.toml")
    Path("path.csv").write_text("p_x_mm,p_y_mm,p_z_mm\n0,0,0\n", encoding="utf-8")
    given = ("--machine", "worn.toml")
    commands: list[tuple[str, ...]] = [
        ("forward", "310", "310", "310", *given),
        ("inverse", "0", "0", "0", *given),
        ("export", "--force", "--out", "numbers", *given),
        ("compensate", "path.csv", "--force", "--out", "commands.csv", *given),
        ("protocol", "--out", "sheet.csv", *given),
        ("simulate", "--error", "carriage_play.x.b=0.1", "--out", "shown.csv", *given),
        ("design", "--count", "6", *given),
        ("compare", "--effects", "carriage_play", "--no-figures", "--out", "compared", *given),
    ]
    for command in commands:
        without = run(*command)
        assert without.exit_code == 2, command
        assert "there is no parameter 'carriage_play.y.b'" in without.output
        assert "--effects-file FILE.py" in without.output
        done = run(*command, "--effects-file", OWN_FILE)
        assert done.exit_code == 0, done.output
    with pytest.raises(InputError, match=r"Machine\.load\(FILE, effects=\[\.\.\.\]\)"):
        og.Machine.load("worn.toml")


def test_a_place_in_a_dial_of_any_name_is_an_effect() -> None:
    """The sheets' own mountings have names such as ``xy-0.5``."""
    for setup in ("xy-0.5", "leg x, left"):
        for place in dial_free_forms(setup, 0, (0.0, 60.0), (0.0, 1e-3), True):
            assert place.effect.name.isidentifier()
            assert setup in place.words
