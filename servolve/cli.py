"""The command line: one file a command, joined here."""

from __future__ import annotations

import os
import sys

from cyclopts import App

from controller.errors import InputError, RunError

app = App(
    name="servolve",
    help="Evolve controllers for small servo robots in MuJoCo, and run the same bits on a bench.",
    version_flags=["--version"],
)

for _name, _target in {
    "demo": "servolve.demo:demo",
    "evolve": "servolve.evolve:evolve",
    "show": "servolve.show:show",
    "eval": "servolve.evaluate:evaluate",
    "simulate": "servolve.simulate:simulate",
    "transpile": "servolve.transpile:transpile",
    "rig": "servolve.rig:app",
    "deploy": "servolve.deploy:deploy",
    "replay": "servolve.replay:replay",
    "compare": "servolve.compare:compare",
    "bench": "servolve.bench:bench",
}.items():
    app.command(_target, name=_name)


def main(arguments: list[str] | None = None) -> int:
    """Run a command; exit status 0: done, 1: it ran and failed, 2: the input was wrong."""
    try:
        status = app(arguments, exit_on_error=False, print_error=True)
    except InputError as error:
        print(f"servolve: {error}", file=sys.stderr)
        return 2
    except RunError as error:
        print(f"servolve: {error}", file=sys.stderr)
        return 1
    except BrokenPipeError:
        os.close(sys.stdout.fileno())
        return 1
    return status if isinstance(status, int) else 0
