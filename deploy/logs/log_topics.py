"""What a log's topics carry: one table, from which the schemas in the file are written. `docs/log.md` explains it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final

FORMAT: Final = 1
"""Format number of `/meta`."""


@dataclass(frozen=True)
class Topic:
    """Describe one topic.

    Args:
        name: as in the file, "/cycle"
        schema: name of its schema
        summary: what it carries
        required: fields that every message has: name => JSON schema
        optional: fields that a message may have
    """

    name: str
    schema: str
    summary: str
    required: Mapping[str, Any]
    optional: Mapping[str, Any]

    def json_schema(self) -> bytes:
        """Return the JSON schema, as it stands in the file."""
        schema = {
            "title": self.schema,
            "description": self.summary,
            "type": "object",
            "properties": {**self.required, **self.optional},
            "required": list(self.required),
        }
        return json.dumps(schema, separators=(",", ":")).encode()


def _number(description: str) -> dict[str, Any]:
    return {"type": "number", "description": description}


def _integer(description: str) -> dict[str, Any]:
    return {"type": "integer", "description": description}


def _text(description: str) -> dict[str, Any]:
    return {"type": "string", "description": description}


def _object(of: str, description: str) -> dict[str, Any]:
    return {"type": "object", "additionalProperties": {"type": [of, "null"]}, "description": description}


def _array(of: str, description: str) -> dict[str, Any]:
    return {"type": "array", "items": {"type": of}, "description": description}


_T: Final = {"t": _number("since the start of the run [s]")}

_TOPICS: Final = (
    Topic(
        "/meta",
        "servolve.Meta",
        "Everything that is needed to replay the run; the first message",
        {
            "format": _integer("1"),
            "rig": _text("name of the rig"),
            "rig_text": _text("its rig.toml"),
            "controller": _text("name of the controller"),
            "controller_text": _text("its controller.toml"),
            "goal_dist": _number("goal distance at k = 0 [m]"),
            "goal_bearing": _number("goal direction from the heading at k = 0 [rad]"),
            "period_s": _number("control period [s]"),
        },
        {
            "port": _text("'virtual', or the port's path"),
            "seconds": _number("length of the run that was asked for [s]"),
            "derate": _number("part of the torque ceiling that was allowed"),
            "seed": _integer("seed of the virtual rig"),
            "twin": {"type": ["string", "null"], "description": "text of the twin file, or null"},
            "faults": _array("string", "faults injected into the virtual rig"),
            "versions": _object("string", "name => version"),
        },
    ),
    Topic(
        "/cycle",
        "servolve.Cycle",
        "One control period",
        _T
        | {
            "k": _integer("periods since the controller started"),
            "raw": _object("integer", "channel => counts that the cycle was given, held where nothing new had come"),
            "age_s": _object("number", "channel => age of those counts [s]; null: never read"),
            "terminals": _object("number", "terminal => value, float32; null if not finite"),
            "outputs": _object("number", "joint => clamped output in its own unit, float32"),
            "goal_counts": _object("integer", "joint => goal position that was written [counts]"),
            "terminal_bits": _text("the terminals' float32 bits in hexadecimal, in the program's order"),
            "output_bits": _text("the outputs' float32 bits in hexadecimal, in the program's order"),
            "missed": _array("integer", "ids of servos whose reply was missing or corrupt"),
            "t_write": {
                "type": ["number", "null"],
                "description": "when the goals were on the wire [s]; null: not sent",
            },
            "late_s": _number("start of the period behind its schedule [s]"),
            "read_s": _number("time taken by reading [s]"),
            "compute_s": _number("time taken by the control cycle [s]"),
            "write_s": _number("time taken by writing [s]"),
        },
        {},
    ),
    Topic(
        "/event",
        "servolve.Event",
        "A change of state, a fault, a warning",
        _T
        | {"kind": _text("'state', 'fault', 'stop', 'warning', 'finding' or 'torque'"), "text": _text("one sentence")},
        {"left": _text("state left"), "entered": _text("state entered"), "reason": _text("why")},
    ),
    Topic(
        "/health",
        "servolve.Health",
        "One block of one servo's health registers",
        _T | {"joint": _text("joint"), "id": _integer("servo id")},
        {
            "torque": _integer("torque enable register"),
            "hardware_error": _integer("hardware error status bits"),
            "voltage_v": _number("input voltage [V]"),
            "temperature_c": _number("temperature [degrees Celsius]"),
        },
    ),
    Topic(
        "/bus",
        "servolve.Bus",
        "One packet sent, all that one transaction received, or bytes that nobody asked for",
        _T | {"direction": _text("'tx', 'rx' or 'stray'"), "hex": _text("the bytes")},
        {},
    ),
    Topic(
        "/truth",
        "servolve.Truth",
        "The virtual rig's own state, for judges: the host loop never reads it",
        _T
        | {
            "base_pos": _array("number", "base position x, y, z [m]"),
            "base_rpy": _array("number", "base roll, pitch, yaw [rad]"),
            "feet_clearance_m": _number("clearance of the lowest foot [m]"),
            "joint_rad": _object("number", "joint => angle [rad]"),
            "joint_vel": _object("number", "joint => velocity [rad/s]"),
        },
        {},
    ),
    Topic(
        "/sim",
        "servolve.Sim",
        "A simulation's own trace, one message a period",
        _T | {"k": _integer("periods since the controller started")},
        {"channels": _object("number", "channel => value")},
    ),
)

TOPICS: Final[Mapping[str, Topic]] = MappingProxyType({topic.name: topic for topic in _TOPICS})
"""Topics by name."""
