"""`servolve rig setup`: give a servo its id and its bit rate, as a rig needs them or as they are named."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path
from typing import Annotated, Any, Final

from cyclopts import Parameter
from rich.console import Console

from controller.errors import InputError, RunError
from controller.families import family_of
from controller.products import PRODUCTS, Product
from controller.rig_file import load_rig, require_bus
from deploy.buses.port import SerialPort
from deploy.commissioning.scan import Found
from deploy.commissioning.servo_backup import ServoBackup, save_backup
from deploy.commissioning.servo_setup import Place, changes, find_servo, move_servo, require_free
from servolve.rig_consent import agreed, backup_path

_SOCKET_BAUD: Final = 57_600
"""A socket has no bit rate; this one only says how long to wait."""


def setup(
    port: str,
    /,
    *,
    product: str | None = None,
    id_: Annotated[int | None, Parameter(name="--id")] = None,
    baud: int | None = None,
    new_id: int | None = None,
    new_baud: int | None = None,
    rig: str | None = None,
    joint: str | None = None,
    backup: Path | None = None,
    yes: Annotated[bool, Parameter(negative="")] = False,
    json_: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> int:
    """Give a servo another id and bit rate, for good: asks, backs up, switches torque off, writes, and pings it there.

    With --rig and --joint the rig file says product, id and bit rate: connect one new servo after the other.

    Args:
        port: serial device, or socket://HOST:PORT
        product: what the servo is, as xl330-m288
        id_: its id; left out: it is the only servo on the port
        baud: its bit rate; left out: it is looked for at all that it can be set to [bits/s]
        new_id: id that it shall have
        new_baud: bit rate that it shall have [bits/s]
        rig: name or file of the rig that it is for
        joint: name of the joint that it shall drive
        backup: where to keep what the servo held; left out: a new file in this folder
        yes: agree without being asked
        json_: print one JSON object

    Returns:
        exit status
    """
    about, wanted_id, wanted_baud = _wanted(product, new_id, new_baud, rig, joint)
    socket = port.startswith("socket://")
    if socket and (baud is not None or new_baud is not None):
        raise InputError("a socket has no bit rate of its own to follow a servo to; leave --baud and --new-baud out")
    if not yes and (json_ or not sys.stdin.isatty()):
        raise InputError("setup asks before it writes, and there is nobody to ask; add --yes to agree")
    console = Console(stderr=json_)
    rates = [_SOCKET_BAUD] if socket else list(family_of(about).bauds.values()) if baud is None else [baud]

    def open_port(rate: int) -> SerialPort:
        return SerialPort(port, rate)

    with console.status(f"looking for {'a servo' if id_ is None else f'servo {id_}'} on {port}", spinner="line"):
        found = find_servo(open_port, about, id_, rates)
        old = Place(found.id, found.baud)
        new = Place(
            old.id if wanted_id is None else wanted_id, old.baud if wanted_baud is None or socket else wanted_baud
        )
        fixes = changes(about, found, old, new)
        if fixes:
            require_free(open_port, about, old, new)
    kept: Path | None = None
    if not fixes:
        console.print(f"{about.name} {old.id} is there already, {_at(old, socket)}", highlight=False)
    elif not agreed(console, None, fixes, yes):
        raise RunError("nothing was written")
    else:
        kept = backup or backup_path(f"{about.name}-{old.id}")
        save_backup(kept, about.name, [ServoBackup(old.id, about.name, _held_baud(about, found), found.values)])
        move_servo(
            open_port(old.baud), about, old, new, lambda register: console.print(f"{register}: written, read back")
        )
        console.print(f"{about.name} answers to id {new.id} {_at(new, socket)}", highlight=False)
        console.print(f"back: {_undo(port, about, old, new, socket)}", highlight=False, soft_wrap=True)
    if json_:
        print(json.dumps(_told(port, about, old, new, socket, kept)))
    return 0


def _wanted(
    product: str | None, new_id: int | None, new_baud: int | None, rig: str | None, joint: str | None
) -> tuple[Product, int | None, int | None]:
    """Return product, id and bit rate that are wanted, from the flags or from a rig file."""
    if (rig is None) != (joint is None):
        raise InputError("--rig and --joint: name both, or neither")
    if rig is not None:
        if product is not None or new_id is not None or new_baud is not None:
            raise InputError("--rig and --joint say product, id and bit rate; leave --product and --new-… out")
        about = load_rig(rig)
        require_bus(about, "setup")
        found = next((one for one in about.joints if one.name == joint), None)
        if found is None:
            names = ", ".join(one.name for one in about.joints)
            raise InputError(f"--joint {joint}: rig {about.name} has no such joint; name one of {names}")
        return found.product, found.id, about.bus.baud
    if product is None or product not in PRODUCTS:
        said = "which servo is it?" if product is None else f"{product} is not known;"
        raise InputError(f"--product: {said} name one of {', '.join(PRODUCTS)}")
    if new_id is None and new_baud is None:
        raise InputError("--new-id, --new-baud: what shall the servo have? give one or both, or --rig and --joint")
    return PRODUCTS[product], new_id, new_baud


def _held_baud(product: Product, found: Found) -> int:
    """Return the bit rate that a servo holds, which behind a socket is not the port's."""
    family = family_of(product)
    return family.bauds.get(found.values[family.baud_rate], found.baud)


def _at(place: Place, socket: bool) -> str:
    return "behind the socket" if socket else f"at {place.baud} bit/s"


def _undo(port: str, product: Product, old: Place, new: Place, socket: bool) -> str:
    """Return the command that puts a servo back."""
    rates = [] if socket else ["--baud", str(new.baud), "--new-baud", str(old.baud)]
    words = ["servolve", "rig", "setup", port, "--product", product.name]
    return shlex.join([*words, "--id", str(new.id), "--new-id", str(old.id), *rates])


def _told(port: str, product: Product, old: Place, new: Place, socket: bool, kept: Path | None) -> dict[str, Any]:
    def place(of: Place) -> dict[str, int | None]:
        return {"id": of.id, "baud": None if socket else of.baud}

    return {
        "port": port,
        "product": product.name,
        "before": place(old),
        "after": place(new),
        "changed": old != new,
        "backup": None if kept is None else str(kept),
    }
