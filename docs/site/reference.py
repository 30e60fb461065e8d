"""Reference pages: what is public in Python, and the commands; made from the package itself."""

from __future__ import annotations

import inspect
import itertools
import re
from collections.abc import Iterator
from functools import cache
from importlib import import_module

import click

import orthoglide as og
from orthoglide.cli import cli

_HEAD = """# Python reference

`import orthoglide as og` gives the names below. SI units in and out: metres, radians, seconds,
newtons, kelvin. Arrays carry batch axes first: commands `rho` are `(..., 3)`, points `p` are
`(..., 3)`. Every error is an [`OrthoglideError`](#orthoglide.OrthoglideError).
"""
_COMMANDS = """# Commands

What `orthoglide COMMAND --help` prints.
"""


def pages() -> dict[str, str]:
    """Markdown by the path of each page."""
    names = "".join(f"\n{_group(module)}" for module in modules())
    found = {f"docs/python-{module}": _module(module) for module in modules()}
    tree = "\n".join(f"python-{module}" for module in modules())
    overview = f"{_HEAD}{names}\n```{{toctree}}\n:hidden:\n\n{tree}\n```\n"
    return {"docs/commands": commands(), "docs/python": overview, **found}


def modules() -> dict[str, list[str]]:
    """Public names by the module of the package that has them."""
    found: dict[str, list[str]] = {}
    for name in og.__all__:
        module = getattr(og, name).__module__.split(".")[1]
        found.setdefault(module, []).append(name)
    return dict(sorted(found.items()))


def _title(module: str) -> str:
    return first(import_module(f"orthoglide.{module}")).partition(":")[0].replace("`", "")


def _group(module: str) -> str:
    rows = (f"| [`{n}`](#orthoglide.{n}) | {first(getattr(og, n))} |" for n in modules()[module])
    return f"## {_title(module)}\n\n| name | |\n|---|---|\n" + "\n".join(rows) + "\n"


def first(public: object) -> str:
    """First sentence of a docstring, as Markdown."""
    said = re.sub(r":\w+:`~?(?:[\w.]*\.)?(\w+)`", r"`\1`", inspect.getdoc(public) or "")
    sentence = re.split(r"\.(?:\s|$)|\n\n", said)[0]
    return " ".join(sentence.split()).replace("``", "`").replace("|", "\\|")


def _module(module: str) -> str:
    said = first(import_module(f"orthoglide.{module}"))
    return f"# {_title(module)}\n\n{said}.\n\n" + "\n".join(map(_name, modules()[module]))


def _name(name: str) -> str:
    if not inspect.isclass(public := getattr(og, name)):
        return _directive("function" if callable(public) else "data", f"orthoglide.{name}")
    kind = "exception" if issubclass(public, Exception) else "class"
    options = "\n   :members:\n   :inherited-members: object, Exception"
    return _directive(kind, f"orthoglide.{name}", options) + "".join(
        _directive("class", f"{c.__module__}.{c.__name__}")
        for c, owner in _behind().items()
        if owner == name
    )


@cache
def _behind() -> dict[type, str]:
    """Classes that public ones are made of, each with the first of these: described once."""
    found: dict[type, str] = {}
    for name in itertools.chain(*modules().values()):
        public = getattr(og, name)
        for c in public.__mro__[1:] if inspect.isclass(public) else ():
            if c.__module__.startswith("orthoglide.") and c.__name__ not in og.__all__:
                found.setdefault(c, name)
    return found


def _directive(kind: str, path: str, options: str = "") -> str:
    return f"```{{eval-rst}}\n.. auto{kind}:: {path}{options}\n```\n"


def commands() -> str:
    """The page of the commands."""
    sections = (
        f"\n## {name.removeprefix('orthoglide ')}\n\n```text\n{text}\n```\n"
        for name, text in _helps(cli, click.Context(cli, info_name="orthoglide"))
    )
    return _COMMANDS + "".join(sections)


def _helps(command: click.Command, context: click.Context) -> Iterator[tuple[str, str]]:
    yield context.command_path, command.get_help(context)
    if isinstance(command, click.Group):
        for name, one in command.commands.items():
            yield from _helps(one, click.Context(one, parent=context, info_name=name))
