"""The commands `steadytip identify KIND RECORDING...`; each imports what it needs.

A kind is a module of `harness.identify.kinds` with a function `command`: put the file there and it
exists, under the name of the file.
"""

from __future__ import annotations

import importlib
import pkgutil

import typer

from harness.identify import kinds

app = typer.Typer(help="Parameters of models from recordings.", no_args_is_help=True)


@app.callback()
def _kinds() -> None:
    # Without a callback, typer would make the only command out of the only kind.
    """Parameters of models from recordings."""


for _module in pkgutil.iter_modules(kinds.__path__):
    _command = importlib.import_module(f"{kinds.__name__}.{_module.name}").command
    app.command(_module.name.replace("_", "-"))(_command)
