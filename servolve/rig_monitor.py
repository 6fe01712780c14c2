"""`servolve rig monitor`: a live table of what a rig's servos say; it writes nothing to them."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Annotated, Any, Final

from cyclopts import Parameter
from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from controller.errors import InputError, RunError
from controller.registers import registers
from controller.rig import Rig
from controller.rig_file import load_rig
from deploy.clock import RealClock
from deploy.commissioning.monitor import ServoView, View, watch
from deploy.stop_request import StopRequest
from servolve.rig_bus import rig_bus

HZ: Final = 20.0
HZ_MAX: Final = 1000.0
_LIVE_S: Final = 0.1
_LINES_S: Final = 1.0
_WIDE: Final = 110
_HOT: Final = 0.9
_SILENT: Final = 3


def monitor(
    rig: str,
    /,
    *,
    port: str,
    seconds: float | None = None,
    hz: float = HZ,
    every: float | None = None,
    json_: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> int:
    """Watch a rig's servos until Ctrl-C or q: positions, loads, temperatures, voltages, errors, missed replies.

    Nothing is written to a servo. In a terminal it is one table that stays in its place, else a line for each servo.

    Args:
        rig: name that `servolve rig list` prints, or path of a rig file
        port: serial device, or socket://HOST:PORT
        seconds: stop after this time; left out: go on [s]
        hz: how often to read, if the bus is fast enough
        every: time between two lines or tables; left out: 0.1 in a terminal, else 1 [s]
        json_: print one JSON object a line

    Returns:
        exit status
    """
    about = load_rig(rig)
    if seconds is not None and not 0.0 < seconds < math.inf:
        raise InputError(f"--seconds {seconds:g}: is no time to watch; give a number above 0")
    if not 0.0 < hz <= HZ_MAX:
        raise InputError(f"--hz {hz:g}: is out of range; give a number above 0, up to {HZ_MAX:g}")
    if every is not None and not 0.0 <= every < math.inf:
        raise InputError(f"--every {every:g}: is no time between lines; give a number from 0")
    console = Console()
    live = console.is_terminal and not json_
    pause = every if every is not None else _LIVE_S if live else _LINES_S
    with (
        StopRequest() as stop,
        rig_bus(about, port, "monitoring") as bus,
        _printer(about, console, live, json_) as show,
    ):
        view = _watch(watch(bus, about, RealClock(), 1.0 / hz), seconds, pause, stop, show)
    if not any(servo.values for servo in view.servos):
        raise RunError(
            f"{port}: no servo of rig {about.name} answers at {about.bus.baud} baud; check power and cable, or look "
            f"what is there with `servolve rig scan {port}`"
        )
    Console(stderr=True).print(_farewell(view), highlight=False, soft_wrap=True)
    return 0


def _watch(
    views: Iterator[View], seconds: float | None, pause: float, stop: StopRequest, show: Callable[[View, float], None]
) -> View:
    """Show views until time is up or somebody wants it; return the last one."""
    began: float | None = None
    due = 0.0
    for view in views:
        began = view.t if began is None else began
        t = view.t - began
        over = stop.reason() is not None or (seconds is not None and t >= seconds)
        if t >= due or over:
            show(view, t)
            due = max(due + pause, t)
        if over:
            break
    return view


@contextmanager
def _printer(rig: Rig, console: Console, live: bool, as_json: bool) -> Iterator[Callable[[View, float], None]]:
    if live:
        with Live(console=console, auto_refresh=False) as screen:
            yield lambda view, t: screen.update(_table(rig, view, t, console.width), refresh=True)
    elif as_json:
        yield lambda view, t: print(json.dumps(_sample(view, t)), flush=True)
    else:
        yield lambda view, t: print("\n".join(_line(servo, t) for servo in view.servos), flush=True)


def _table(rig: Rig, view: View, t: float, width: int) -> Table:
    wide = width >= _WIDE
    rate = "" if math.isnan(view.rate_hz) else f", {view.rate_hz:.1f} readings a second"
    table = Table(title=f"{rig.name}, {t:.1f} s{rate}", title_justify="left", caption="Ctrl-C or q ends it")
    table.add_column("joint")
    for name in ("servo", *(("count",) if wide else ()), "rad", "rad/s", "load", "°C", "V"):
        table.add_column(name, justify="right")
    if wide:
        table.add_column("torque")
    table.add_column("missed", justify="right")
    table.add_column("state", overflow="fold")
    for servo in view.servos:
        family = servo.family
        count = servo.values.get(family.position)
        row: list[str | Text] = [servo.joint.name, str(servo.joint.id)]
        row += [_shown(count, "{:d}")] if wide else []
        row += [_shown(servo.angle_rad, "{:+.3f}"), _shown(servo.velocity_rad_s, "{:+.2f}"), _load(servo)]
        row += [_temperature(rig, servo), _voltage(rig, servo)]
        row += [_torque(servo)] if wide else []
        row += [Text(f"{servo.missed}", style="yellow" if servo.missed else ""), _state(servo)]
        table.add_row(*row, style="dim" if _silent(servo) else None)
    return table


def _line(servo: ServoView, t: float) -> str:
    """Return one servo as a line that other programs can cut at blanks."""
    temperature = servo.scaled(servo.family.temperature)
    voltage = servo.scaled(servo.family.voltage)
    return (
        f"{t:.2f} {servo.joint.name} {servo.joint.id} {_shown(servo.angle_rad, '{:+.4f}')} rad "
        f"{_shown(servo.velocity_rad_s, '{:+.3f}')} rad/s load {_load(servo)} {_shown(temperature, '{:.0f}')} °C "
        f"{_shown(voltage, '{:.1f}')} V missed {servo.missed}/{servo.asked} {_state(servo).plain}"
    )


def _sample(view: View, t: float) -> dict[str, Any]:
    """Return a view as JSON."""
    return {
        "t": round(t, 6),
        "rate_hz": None if math.isnan(view.rate_hz) else round(view.rate_hz, 3),
        "servos": [
            {
                "joint": servo.joint.name,
                "id": servo.joint.id,
                "count": servo.values.get(servo.family.position),
                "angle_rad": servo.angle_rad,
                "velocity_rad_s": servo.velocity_rad_s,
                "load": servo.scaled(servo.family.load),
                "load_unit": registers(servo.joint.product)[servo.family.load].unit,
                "temperature_c": servo.scaled(servo.family.temperature),
                "voltage_v": servo.scaled(servo.family.voltage),
                "torque": servo.values.get(servo.family.torque_enable),
                "errors": list(servo.errors),
                "asked": servo.asked,
                "missed": servo.missed,
                "missed_in_a_row": servo.missed_in_a_row,
                "age_s": None if math.isinf(servo.read_at) else round(view.t - servo.read_at, 6),
            }
            for servo in view.servos
        ],
    }


def _farewell(view: View) -> str:
    missed = ", ".join(f"{servo.joint.name} {servo.missed}" for servo in view.servos if servo.missed)
    rate = "" if math.isnan(view.rate_hz) else f", {view.rate_hz:.1f} a second"
    return f"{view.cycles} readings{rate}; replies missed: {missed or 'none'}"


def _shown(value: float | None, pattern: str) -> str:
    if value is None:
        return "-"
    text = pattern.format(value)
    return text if text.strip("+-0.") else text.replace("-", "+")  # a zero has no sign worth showing


def _load(servo: ServoView) -> str:
    value = servo.scaled(servo.family.load)
    if value is None:
        return "-"
    value *= servo.joint.sign
    amperes = registers(servo.joint.product)[servo.family.load].unit == "A"
    return f"{_shown(value, '{:+.2f}')} A" if amperes else f"{_shown(100.0 * value, '{:+.0f}')} %"


def _temperature(rig: Rig, servo: ServoView) -> Text:
    value = servo.scaled(servo.family.temperature)
    limit = rig.safety.temperature_c_max
    style = "" if value is None or value < _HOT * limit else "red" if value > limit else "yellow"
    return Text(_shown(value, "{:.0f}"), style=style)


def _voltage(rig: Rig, servo: ServoView) -> Text:
    value = servo.scaled(servo.family.voltage)
    return Text(_shown(value, "{:.1f}"), style="red" if value is not None and value < rig.safety.voltage_low_v else "")


def _torque(servo: ServoView) -> str:
    value = servo.values.get(servo.family.torque_enable)
    return "-" if value is None else "on" if value else "off"


def _silent(servo: ServoView) -> bool:
    return servo.missed_in_a_row >= _SILENT or 0 < servo.missed == servo.asked


def _state(servo: ServoView) -> Text:
    if _silent(servo):
        return Text("corrupt" if servo.corrupt == servo.missed else "silent", style="red")
    if servo.errors:
        return Text(", ".join(servo.errors), style="red")
    return Text("ok")
