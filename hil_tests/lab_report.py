"""The report of a session: which rig, what was tested, what was measured; as text, JSON or HTML."""

from __future__ import annotations

import html
import json
from dataclasses import asdict, dataclass, field
from pathlib import Path

FORMAT = 1
_STYLE = "body{font:15px/1.5 sans-serif;max-width:60em;margin:2em auto;padding:0 1em}table{border-collapse:collapse}"
_CELLS = "td,th{border-bottom:1px solid #ccc;padding:.2em .8em;text-align:left}.failed,.error{color:#b00020}"


@dataclass
class Measurement:
    """Hold what one test measured."""

    test: str
    what: str
    unit: str
    values: dict[str, float]
    limit: str = ""

    def numbers(self) -> str:
        return ", ".join(f"{name} {value:.4g}" for name, value in self.values.items())

    def line(self) -> str:
        return f"{self.what} [{self.unit}]: {self.numbers()}{f'; {self.limit}' if self.limit else ''}"


@dataclass
class LabReport:
    """Gather what a session finds out."""

    rig: dict[str, object] = field(default_factory=dict)
    servos: list[dict[str, object]] = field(default_factory=list)
    findings: list[str] = field(default_factory=list)
    tests: dict[str, str] = field(default_factory=dict)
    measured: list[Measurement] = field(default_factory=list)
    torque_off: bool | None = None

    def lines(self) -> list[str]:
        """Return the report as text."""
        if not self.rig:
            return []
        told = [", ".join(f"{name} {value}" for name, value in self.rig.items())]
        told += [", ".join(f"{name} {value}" for name, value in servo.items()) for servo in self.servos]
        told += self.findings + [measurement.line() for measurement in self.measured]
        if self.torque_off is not None:
            told.append(f"torque at the end: {'off, as read back' if self.torque_off else 'NOT KNOWN TO BE OFF'}")
        return told

    def save(self, path: Path) -> None:
        """Write the report, as HTML if the file's name says so, else as JSON."""
        text = (
            self.html()
            if path.suffix in (".html", ".htm")
            else json.dumps({"format": FORMAT, **asdict(self)}, indent=1)
        )
        path.write_text(text + "\n", encoding="utf-8")

    def html(self) -> str:
        title = html.escape(f"Rig {self.rig.get('rig', '')}")
        rows = [(m.what, m.unit, m.numbers(), m.limit) for m in self.measured]
        torque = "off, as read back" if self.torque_off else "<b>not known to be off</b>"
        parts = [
            f"<!doctype html><html lang=en><meta charset=utf-8><title>{title}</title><style>{_STYLE}{_CELLS}</style>",
            f"<h1>{title}</h1><p>{html.escape(', '.join(f'{k} {v}' for k, v in self.rig.items()))}</p>",
            _table("Servos", [tuple(s) for s in self.servos[:1]] + [tuple(s.values()) for s in self.servos], True),
            _table("Measured", [("what", "unit", "values", "limit"), *rows], True),
            "<h2>Findings</h2><ul>" + "".join(f"<li>{html.escape(f)}</li>" for f in self.findings) + "</ul>",
            _table("Tests", list(self.tests.items()), False),
            f"<p>Torque at the end: {torque}.</p></html>",
        ]
        return "\n".join(parts)


def _table(title: str, rows: list[tuple[object, ...]], head: bool) -> str:
    told = [f"<h2>{html.escape(title)}</h2><table>"]
    for number, row in enumerate(rows):
        cell = "th" if head and number == 0 else "td"
        told.append("<tr>" + "".join(f"<{cell}>{html.escape(str(value))}</{cell}>" for value in row) + "</tr>")
    return "".join(told) + "</table>"
