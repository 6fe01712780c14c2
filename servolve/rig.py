"""`servolve rig`: what rigs there are, and virtual ones to talk to."""

from __future__ import annotations

import json
import signal
import sys
from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

from controller.errors import InputError
from controller.rig import Rig
from controller.rig_file import load_rig, rig_names
from servolve.rig_calibrate import calibrate
from servolve.rig_check import check
from servolve.rig_monitor import monitor
from servolve.rig_scan import scan_port
from servolve.rig_setup import setup

app = App(name="rig", help="List rigs, look after real ones, and serve virtual ones to other programs.")
app.command(scan_port, name="scan")
app.command(check)
app.command(calibrate)
app.command(monitor)
app.command(setup)


@app.command(name="list")
def list_rigs(*, as_json: Annotated[bool, Parameter(name="--json", negative=())] = False) -> int:
    """List the rigs that come with servolve.

    Args:
        as_json: print one JSON object instead of a table

    Returns:
        exit status
    """
    rigs = [load_rig(name) for name in rig_names()]
    if as_json:
        print(json.dumps({"rigs": [_describe(rig) for rig in rigs]}))
        return 0
    width = max(len(rig.name) for rig in rigs)
    for rig in rigs:
        servos = "simulation only" if rig.simulated_only else f"{len(rig.joints)} x {', '.join(_servos(rig))}"
        print(f"{rig.name:{width}}  {_title(rig)}: {servos}; {rig.path}")
    return 0


@app.command
def serve(
    rig: str,
    *,
    link: Path | None = None,
    sensor_link: Path | None = None,
    tcp: int | None = None,
    host: str | None = None,
    control: Path | None = None,
    twin: str | None = None,
    fault: Annotated[tuple[str, ...], Parameter(negative=(), show_default=False)] = (),
    seed: int = 0,
    eeprom: Path | None = None,
    wire_time: bool = True,
    echo: Annotated[bool, Parameter(negative=())] = False,
) -> int:
    """Serve a virtual rig in real time: a servo bus and a sensor node, with MuJoCo behind them, until Ctrl-C.

    Args:
        rig: name that `servolve rig list` prints, or path of a rig file
        link: symbolic link to make to the bus's device
        sensor_link: symbolic link to make to the sensor node's device
        tcp: port on which the bus is served too, 0 for any
        host: address of this machine on which that port is open; left out: 127.0.0.1, for this machine alone
        control: path of a local socket on which other programs change faults and see the state
        twin: how the rig's physics differ from the simulation's: a twin file, or one of those in docs/twins.md
        fault: what goes wrong, as drop=0.01, corrupt=0.01 or dead=2@3.0, or a file of faults; may be repeated
        seed: seed of faults and noise
        eeprom: file in which the servos keep their EEPROM between runs
        wire_time: bytes take their time on the bus; without, as fast as the machine goes
        echo: the bus returns the master's own bytes, as some adapters do

    Returns:
        exit status
    """
    from deploy.virtual.faults import read_faults
    from deploy.virtual.rig import VirtualRig
    from deploy.virtual.server import LOOPBACK, RigServer
    from deploy.virtual.twin import load_twin

    if host is not None and tcp is None:
        raise InputError("--host: says where a TCP port is open; give --tcp too")

    virtual = VirtualRig(
        load_rig(rig),
        seed=seed,
        twin=load_twin(twin) if twin else None,
        faults=read_faults(fault),
        eeprom_path=eeprom,
        wire_time=wire_time,
        echo=echo,
    )
    lines = RigServer(virtual, link=link, sensor_link=sensor_link, tcp_port=tcp, host=host or LOOPBACK, control=control)
    with lines as server:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: server.stop())
        about = virtual.rig
        print(f"{about.name}: {len(about.joints)} servos at {about.bus.baud} bit/s, twin {virtual.twin.name}")
        print(f"bus      {server.bus_path}{f' as {link}' if link else ''}")
        print(f"sensors  {server.sensor_path}{f' as {sensor_link}' if sensor_link else ''}")
        if server.tcp_port is not None:
            address = f"[{host}]" if host and ":" in host else host or LOOPBACK
            print(f"bus too  socket://{address}:{server.tcp_port}")
        if control is not None:
            print(f"control  {control}")
        sys.stdout.flush()
        server.run()
        if server.slipped_s > 0.0:
            print(f"the machine stalled for {server.slipped_s:.2f} s; the rig's time stood still", file=sys.stderr)
    return 0


def _title(rig: Rig) -> str:
    """Return what the file's first comment calls the rig."""
    first = rig.text.partition("\n")[0]
    return first.removeprefix("#").strip().removeprefix("Rig:").strip() if first.startswith("#") else rig.name


def _servos(rig: Rig) -> list[str]:
    return sorted({joint.product.name for joint in rig.joints})


def _describe(rig: Rig) -> dict[str, object]:
    return {
        "name": rig.name,
        "title": _title(rig),
        "path": str(rig.path),
        "servos": _servos(rig),
        "joints": [joint.name for joint in rig.joints],
        "sensors": [sensor.name for sensor in rig.sensors],
        "period_s": rig.period_s,
        "simulated_only": rig.simulated_only,
        "baud": rig.bus.baud,
    }
