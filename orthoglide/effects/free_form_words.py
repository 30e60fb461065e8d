"""Sentences about a free-form error: where it is and what it does, its size, and its test."""

from __future__ import annotations

from orthoglide.effects.free_form_place import FreeFormPlace
from orthoglide.effects.words import Words, filled, quantity, toward
from orthoglide.numerals import MINUS, compact
from orthoglide.parameters import Parameter


def effect_words(form: FreeFormPlace) -> Words:
    """Return the texts of the effect of an error, whose value is its size."""
    words, sign = clause(form), f"{{+|{MINUS}}}" * form.is_signed
    text = words.replace("{", "{{").replace("}", "}}")  # a setup may be called anything
    return Words(
        one=f"{text}, by {sign}{{size}}{size_place(form.part)}",
        short=text,
        many=words,
        size=f"{{{_unit(form)}}}{_measure(form)}",
        confirm=_test(form),
        noun=f"error that {words}",
    )


def size_place(part: str) -> str:
    """Return the travel at which the size of an error that grows with it is stated, a clause."""
    return " half a stroke from mechanical zero" * (part == "screw")


def clause(form: FreeFormPlace) -> str:
    """Return the location and the kind of an error, without its size; the positive direction is the
    one that is named, or that of growing travel.
    """
    if form.leg < 0 and not form.of_dial:
        scales = form.part == "screw"
        fault = "change their scales equally" if scales else "deviate equally along their axes"
        return f"all drives {fault} {_time_words(form)}"
    if form.of_dial:
        if not form.setup:
            return "all dials read more or less, depending on the way that their plungers came"
        fault = {
            "time": "creeps with time",
            "reading": "is not true over its range",
            "approach": "reads more or less, depending on the way that its plunger came",
        }[form.against]
        if form.bump is not None:
            fault = "is wrong at one place of its range and nowhere else"
        return f"the dial of {form.setup} {fault}"
    leg = form.names.legs[form.leg]
    depending = "in proportion to" if form.is_line else "depending on"
    side = "smaller" if form.side > 0 else "larger"
    dependence = {
        "travel": _travel_words(form),
        "approach": f"{_travel_words(form)} where it comes from {side} travel"
        if form.side
        else "depending on the side it is approached from",
        "reversal": "depending on the distance since it reversed",
        "command": f"{depending} the command of drive {form.names.legs[form.command_drive]}",
        "time": _time_words(form),
    }[form.against]
    fault = {
        "drive": f"drive {leg} {'steps' if form.is_step else 'deviates'} along its axis",
        "screw": f"drive {leg} changes its scale",
        "rail": f"the path of the {leg} carriage leaves its line toward "
        f"{toward(form.direction, 1.0)}",
        "carriage": f"the {leg} carriage turns about {form.direction}",
        "bar": f"bar {form.direction} of leg {leg} changes its length"
        if form.direction
        else f"both bars of leg {leg} change their length",
        "platform": f"the end of leg {leg} moves on the platform toward "
        f"{toward(form.direction, 1.0)}",
    }[form.part]
    return form.names.in_layout_words(f"{fault} {dependence}")


def _time_words(form: FreeFormPlace) -> str:
    if form.jump is not None:
        return f"suddenly {'at' if form.timed else 'after'} {form.spot}"
    return "in proportion to time" if form.is_line else "with time"


def _travel_words(form: FreeFormPlace) -> str:
    if form.bump is not None:
        reach = f"within {2e3 * form.wide:.0f} mm of" if form.wide else "at"
        return f"{reach} travel {compact(form.bump * 1e3, 3)} mm and nowhere else"
    if form.jump is not None:
        return "between travel {} and {} mm".format(*form.travels_of_step)
    if form.period is not None:
        return f"in waves of {compact(form.period * 1e3, 3)} mm along its travel"
    if form.short_waves:
        return "in short waves along its travel"
    return f"{'in proportion to' if form.is_line else 'depending on'} its travel"


def look_at(form: FreeFormPlace) -> str:
    """Return what to look at on the machine."""
    if form.of_dial:
        return "the dial against gauge blocks, and its stand"
    if form.leg < 0:
        return "what warms all drives alike: the room, the motors, the machine's frame"
    leg = form.names.legs[form.leg]
    part = {
        "drive": f"the drive of axis {leg}: screw or belt, coupling, encoder",
        "screw": f"what warms the screw or belt of axis {leg}: its motor, its nut",
        "rail": f"the rail of axis {leg}, straight edge and dial along its travel",
        "carriage": f"the carriage of axis {leg}: its bearings and preload",
        "bar": f"the bars of leg {leg}, their pivots and their warmth",
        "platform": f"the joint of leg {leg} at the platform: its pins and their fit",
    }[form.part]
    return form.names.in_layout_words(part)


def _unit(form: FreeFormPlace) -> str:
    return "mrad" if form.is_rotation else "mm"


def _measure(form: FreeFormPlace) -> str:
    """Return what the size is, if it is a root mean square about a mean that zeros absorb."""
    return "" if form.has_level else " rms"


def size_words(form: FreeFormPlace, size: float) -> str:
    """Return the absolute value of a size, SI, with its unit and measure."""
    return quantity(size, _unit(form)) + _measure(form)


def signed_size_words(form: FreeFormPlace, size: float) -> str:
    """Return a size, SI, as `size_words`, with the sign of those that have one."""
    sign = ("+" if size >= 0 else MINUS) * form.is_signed
    return f"{sign}{size_words(form, size)}"


_DIAL_REVERSAL_TEST = (
    "read one gauge block twice, first after a shorter block and then after a longer one: the two "
    "readings should differ by {size}"
)


def confirming_test(form: FreeFormPlace, size: float) -> str:
    """Return the test that shows lost motion or a step of a size, SI, at a drive, a rail, the
    platform or a dial; empty for other errors.
    """
    return filled(_test(form), Parameter("effect"), size, size_words(form, size))


def _test(form: FreeFormPlace) -> str:
    """Return that test with blanks for the size and the sign."""
    if form.of_dial:
        return _DIAL_REVERSAL_TEST if form.depends_on_approach else ""
    leg = form.names.legs[form.leg]
    spot = {
        "drive": f"carriage {leg} along its travel",
        "rail": f"carriage {leg} along {form.direction}",
        "platform": f"the end of leg {leg} at the platform along {form.direction}",
    }.get(form.part)
    if spot is None or not (form.depends_on_approach or form.is_step):
        return ""
    spot = form.names.in_layout_words(spot)
    if form.is_step:
        low, high = form.travels_of_step
        way = f"{high} to {low}" if form.side < 0 else f"{low} to {high}"
        inward, outward = (words[1] for words in form.names.slide_end_words)
        return (
            f"read a dial on {spot} every millimetre from {way} mm: expect a step of {{size}} "
            f"{{{outward}|{inward}}} as travel grows"
        )
    if form.against == "approach":
        return (
            f"set a dial on {spot} and come to one place from smaller and from larger travel of "
            f"{leg}: expect {{size}} between the two"
        )
    return (
        f"set a dial on {spot}, approach one place after a long way in one direction, then again "
        f"with a reversal just before it: the two readings should differ by up to {{size}}"
    )
