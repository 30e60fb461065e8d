"""Options that would have no effect beside others, or without them, are refused."""

from __future__ import annotations

import click
from click.core import ParameterSource

from orthoglide.errors import InputError


def exclude(one: str, *others: str, because: str) -> None:
    """Refuse options that have no effect beside another, by the names that they have in Python;
    ``because`` says why, as a clause.

    Raises:
        InputError: where it is given explicitly, and one of the others too.
    """
    for other in filter(_given, others if _given(one) else ()):
        raise InputError(f"{_shown(one)} and {_shown(other)} exclude each other: {because}")


def need(one: str, *others: str) -> None:
    """Refuse an option that has no effect without one of others, by the names that they have in
    Python.

    Raises:
        InputError: where it is given explicitly, and none of the others.
    """
    if _given(one) and not any(map(_given, others)):
        wanted = " or ".join(map(_shown, others))
        raise InputError(f"{_shown(one)} has no effect without {wanted}: add it, or leave this out")


def _given(name: str) -> bool:
    """Whether a parameter of the running command was given explicitly, and not as nothing."""
    context = click.get_current_context()
    source = context.get_parameter_source(name)
    if source in (None, ParameterSource.DEFAULT, ParameterSource.DEFAULT_MAP):
        return False
    return context.params[name] not in (None, ())


def _shown(name: str) -> str:
    """A parameter as it is written on the command line."""
    known = click.get_current_context().command.params
    (one,) = (p for p in known if p.name == name)
    if isinstance(one, click.Argument):
        return (one.metavar or one.human_readable_name).strip("[] .")
    return max(one.opts, key=len)
