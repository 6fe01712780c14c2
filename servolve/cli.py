"""The command line: one file a command, joined here."""

from __future__ import annotations

import errno
import os
import re
import sys

from cyclopts import App, CycloptsError

from controller.errors import InputError, RunError

# module:function of each command, imported when it is asked for, and what it does
_COMMANDS = {
    "demo": ("servolve.demo:demo", "The whole road once: evolve, transpile, deploy on a virtual rig, compare."),
    "evolve": ("servolve.evolve:evolve", "Evolve a controller for a task."),
    "show": ("servolve.show:show", "Show a run, or a controller as text, tree or C."),
    "eval": ("servolve.evaluate:evaluate", "Run a controller's program over the rows of a CSV file, bit by bit."),
    "simulate": ("servolve.simulate:simulate", "Simulate a controller, and log or film it."),
    "transpile": ("servolve.transpile:transpile", "Write a controller as C99."),
    "firmware": ("servolve.firmware:firmware", "Write a controller as a firmware project for a board."),
    "study": ("servolve.study:study", "Rerun a convergence experiment of the founding papers."),
    "rig": ("servolve.rig:app", "List the rigs, and serve virtual ones to other programs."),
    "deploy": ("servolve.deploy:deploy", "Run a controller on a virtual or a real rig."),
    "log": ("servolve.log:log", "Turn a recorded console of firmware into the log of a run."),
    "replay": ("servolve.replay:replay", "Check a log against its own controller, bit by bit."),
    "compare": ("servolve.compare:compare", "Lay a rig's log over its simulation."),
    "bench": ("servolve.bench:bench", "Measure speed, as ratios."),
}
# what a package that is not installed is part of
_EXTRAS = {
    **dict.fromkeys(("mujoco", "PIL"), "sim"),
    **dict.fromkeys(("imageio", "jinja2", "matplotlib", "scipy"), "report"),
    "deap": "dev",
}


def _app(summaries: bool) -> App:
    """Make the command line; `summaries` lists the commands without importing them all for their docstrings."""
    app = App(
        name="servolve",
        help="Evolve controllers for small servo robots in MuJoCo, and run the same bits on a bench.",
        version_flags=["--version"],
        result_action="return_value",
        exit_on_error=False,
        print_error=False,
        suppress_keyboard_interrupt=False,
    )
    for order, (name, (target, summary)) in enumerate(_COMMANDS.items()):
        app.command(target, name=name, help=summary if summaries else None, sort_key=order)
    return app


def main(arguments: list[str] | None = None) -> int:
    """Run a command.

    Args:
        arguments: what follows the program's name; None: those of this process

    Returns:
        exit status; 0: done, 1: it ran and failed, 2: the input was wrong
    """
    arguments = sys.argv[1:] if arguments is None else arguments
    try:
        status = _app(summaries=arguments[:1] in ([], ["--help"], ["-h"]))(arguments)
        sys.stdout.flush()
    except CycloptsError as error:
        return _fail(2, _usage_sentence(error))
    except InputError as error:
        return _fail(2, str(error))
    except RunError as error:
        return _fail(1, str(error))
    except KeyboardInterrupt:
        return _fail(1, "interrupted from the keyboard; what was complete by then is on the disk")
    except ImportError as error:
        missing = _missing_package(error)
        if missing is None:
            raise
        return _fail(2, f"this command needs {missing}; install it with: pip install 'servolve[{_EXTRAS[missing]}]'")
    except BrokenPipeError:
        # the reader of a pipe has gone
        _drop_output()
        return 1
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EFBIG) or error.filename is not None:
            raise
        _drop_output()
        return _fail(1, f"the output can not be written ({error.strerror}); make room, or write it elsewhere")
    return status if isinstance(status, int) else 0


def _drop_output() -> None:
    """Keep the interpreter from flushing at exit into an output that takes nothing."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _fail(status: int, sentence: str) -> int:
    print(f"servolve: {' '.join(sentence.split())}", file=sys.stderr)
    return status


def _missing_package(error: BaseException | None) -> str | None:
    """Name the optional package whose absence is behind an import error, or None."""
    while error is not None:
        package = (error.name or "").partition(".")[0] if isinstance(error, ModuleNotFoundError) else ""
        if package in _EXTRAS:
            return package
        error = error.__cause__
    return None


def _usage_sentence(error: CycloptsError) -> str:
    """Say in one sentence what is wrong with the arguments, and where the right ones are listed."""
    error.verbose = False
    try:
        told = str(error).strip().rstrip(".?")
    except ImportError:
        # it looks into every command for the one that was meant, and an optional package is not installed
        told = f"Unknown command: {' '.join(error.unused_tokens or ())}"
    told = re.sub(r"[.?] (?=[A-Z])", "; ", told)
    told = re.sub(r'^Command "(.+)" parameter (\S+) requires an argument$', r"\1: give a value for \2", told)
    told = re.sub(r",\s*$", " and others", told)
    command = " ".join(("servolve", *(error.command_chain or ())))
    return f"{told}; `{command} --help` lists what it takes"
