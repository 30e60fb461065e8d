"""Values of parameters as a machine keeps them, and checks that refuse implausible ones."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from orthoglide.effects import Catalogue, Effect
from orthoglide.errors import InputError, check_mapping
from orthoglide.machine_file.model import MachineFile, ParameterValue
from orthoglide.numerals import compact

_MAX_TOLERANCES = 500.0  # beyond, a value must be in another unit, such as a thousandth of SI
_MAX_LENGTH_RATIO = 0.1  # largest error of a length over that of a bar


def largest_value(spec: MachineFile, effect: Effect) -> float:
    """Return the largest value of an effect's parameters that is plausible, SI."""
    length = _MAX_LENGTH_RATIO * spec.geometry.L if effect.unit.name == "mm" else np.inf
    return float(min(_MAX_TOLERANCES * spec.tolerance[effect.name], length))


def check_magnitudes(spec: MachineFile, values: Mapping[str, float]) -> None:
    """Refuse values of parameters, SI, that must be in another unit.

    Raises:
        InputError: naming the parameter.
    """
    check_mapping("parameters", values)
    for name, value in values.items():
        effect = spec.catalogue.effect_of(name)
        unit, tolerance = effect.unit, spec.tolerance[effect.name]
        if abs(value) > largest_value(spec, effect):
            raise InputError(
                f"{name} = {compact(value / unit.si, 6)}{unit.behind} is "
                f"{abs(value) / tolerance:.0f} times "
                f"its tolerance of {tolerance / unit.si:g}{unit.behind}: is it meant in another "
                f"unit? Python takes SI, files what the parameter's unit says"
            )


def check_sigmas(values: Mapping[str, float], sigmas: Mapping[str, float]) -> None:
    """Refuse standard deviations that are negative, no numbers, or of parameters without a value.

    Raises:
        InputError: naming the parameter.
    """
    check_mapping("parameters", values)
    check_mapping("standard deviations", sigmas)
    for name, sigma in sigmas.items():
        if name not in values:
            raise InputError(f"a standard deviation is given of {name}, which is not set: set both")
        if not (np.isfinite(sigma) and sigma >= 0):
            raise InputError(f"the standard deviation of {name} must be 0 or more, not {sigma}")


def parameter_entries(
    catalogue: Catalogue, values: Mapping[str, float], sigmas: Mapping[str, float]
) -> dict[str, ParameterValue]:
    """Return elementary parameters of a machine; structured members are expanded and summed. Values
    and standard deviations, 0 where not given, are SI.

    Raises:
        InputError: for a value that is no finite number, and a parameter of one campaign.
    """
    entries: dict[str, ParameterValue] = {}
    for name, value in values.items():
        if not np.isfinite(value):
            raise InputError(f"{name} must be a finite number, not {value}")
        sigma, unit = sigmas.get(name, 0.0), catalogue.effect_of(name).unit.name
        for part, weight in catalogue.elementary_weights(name).items():
            parameter = catalogue.parameter(part)
            if parameter.campaign:
                raise InputError(
                    f"{name} is what the campaign {parameter.campaign} has for itself: a machine "
                    f"has {parameter.plain}"
                )
            entry = entries.get(part, ParameterValue(0.0, 0.0, unit))
            combined_sd = float(np.hypot(entry.sigma, weight * sigma))
            entries[part] = ParameterValue(entry.value + weight * float(value), combined_sd, unit)
    return entries
