"""The commands `steadytip identify TOPIC RECORDING...`; each imports what it needs.

A command is a function `command` in a module `harness/identify/TOPIC/command.py`, and is called
after its folder. A folder with a second command has it in `NAME_command.py`, called NAME.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator

import typer

from harness import identify

app = typer.Typer(help="Identify parameters of models from recordings.", no_args_is_help=True)


@app.callback()
def _topics() -> None:
    # Without a callback, typer would make the only command out of the only topic.
    """Identify parameters of models from recordings."""


def _commands() -> Iterator[tuple[str, str]]:
    """Yield name and module of each command, by name."""
    found = {}
    for topic in pkgutil.iter_modules(identify.__path__, f"{identify.__name__}."):
        if not topic.ispkg:
            continue
        package = importlib.import_module(topic.name)
        for module in pkgutil.iter_modules(package.__path__):
            own, _, kind = module.name.rpartition("_")
            if kind == "command":
                name = own or topic.name.rpartition(".")[2]
                found[name.replace("_", "-")] = f"{topic.name}.{module.name}"
    yield from sorted(found.items())


for _name, _module in _commands():
    app.command(_name)(importlib.import_module(_module).command)
