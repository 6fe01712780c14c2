"""The report of a comparison: one HTML file with everything in it, for the screen and for paper."""

from __future__ import annotations

import base64
import math
from dataclasses import dataclass
from pathlib import Path

from controller.controller import Controller
from controller.controller_file import parse_controller
from controller.errors import InputError
from controller.rig import Rig
from controller.text import format_source
from deploy.logs.comparison import Comparison, Outcome
from servolve.figures import RIG, SIM, force_figure, joint_figure, path_figure, timing_figure

_NOTHING = (("–", "not said"),)

NARROW = "\u202f"
"""Between a number and its unit."""


@dataclass(frozen=True)
class Rows:
    """Hold one table of the report.

    Args:
        head: titles of the columns, empty: none
        rows: cells, the first one of each names the row
        text_columns: how many columns from the left hold text; the others hold numbers, set to the right
    """

    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    text_columns: int = 1


def write_report(found: Comparison, path: str | Path, strip: str | Path | None = None) -> None:
    """Write the report of a comparison.

    Args:
        found: the comparison
        path: the HTML file, overwritten
        strip: a PNG film strip to embed, or None

    Raises:
        InputError: a file cannot be read or written
    """
    try:
        picture = None if strip is None else Path(strip).read_bytes()
    except OSError as error:
        raise InputError(f"{strip}: the film strip cannot be read ({error.strerror}); name a PNG file") from None
    page = report_html(found, None if picture is None else read_strip(picture, str(strip)))
    try:
        Path(path).write_text(page, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: the report cannot be written ({error.strerror}); name another file") from None


def read_strip(png: bytes, origin: str) -> str:
    """Prepare a film strip for the page.

    Args:
        png: the file's bytes
        origin: where they came from, as errors name it

    Returns:
        the picture as a data URL

    Raises:
        InputError: it is no PNG
    """
    if png[:8] != b"\x89PNG\r\n\x1a\n" or png[12:16] != b"IHDR":
        raise InputError(f"{origin}: is not a PNG picture; name the strip that `servolve simulate --strip` wrote")
    return f"data:image/png;base64,{base64.b64encode(png).decode()}"


def report_html(found: Comparison, strip: str | None = None) -> str:
    """Return the report as HTML; the same comparison gives the same bytes.

    Args:
        found: the comparison
        strip: a film strip as a data URL, or None
    """
    from markupsafe import Markup

    controller = parse_controller(found.controller_text, f"{found.log}: controller")
    figures = {
        "joints": joint_figure(found),
        "path": path_figure(found),
        "force": force_figure(found),
        "timing": timing_figure(found),
    }
    return render(
        "report.html.j2",
        title=f"{controller.name} on {found.rig.name}",
        lead=_lead(found),
        verdict=_verdict(found),
        colours={"rig": RIG, "sim": SIM},
        outcome=outcome_rows(found),
        errors=error_rows(found),
        pose_note=_POSE_NOTES[found.pose_source],
        lockstep=found.meta.get("port") == "virtual",
        timing=timing_rows(found),
        inputs=_input_rows(controller),
        outputs=_output_rows(controller),
        program=format_source(controller.source),
        servos=_servo_rows(found.rig),
        parameters=_parameter_rows(found, controller),
        provenance=_provenance_rows(controller),
        versions=_version_rows(found),
        events=_event_rows(found),
        controller_text=found.controller_text,
        rig_text=found.rig.text,
        figures={name: Markup(svg) for name, svg in figures.items()},
        strip=strip,
    )


def render(template: str, **values: object) -> str:
    """Return a page; the same values give the same bytes.

    Args:
        template: name of its file in this folder
        values: what it shows
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("servolve", "."), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    return environment.get_template(template).render(**values)


_POSE_NOTES = {
    "truth": "The rig's path is the virtual rig's own record, which the control loop never sees.",
    "sensors": "The rig's path is what its pose sensor reported; nothing on this rig measures the height of the feet.",
    "none": "This rig has no pose sensor: the path is the simulation's alone.",
}


def number(value: float | None, unit: str, scale: float = 1.0, digits: int = 1) -> str:
    """Return a number with its unit, or a dash where there is none.

    Args:
        value: in SI
        unit: as printed
        scale: unit per SI
        digits: decimals
    """
    if value is None or not math.isfinite(value):
        return "–"
    text = f"{value * scale:.{digits}f}".replace("-", "−")
    # degrees stand close to their number
    return f"{text}{unit}" if unit in ("", "°") else f"{text}{NARROW}{unit}"


def outcome_rows(found: Comparison) -> Rows:
    """Return how both sides ended.

    Args:
        found: the comparison
    """

    def row(title: str, name: str, unit: str, scale: float, digits: int) -> tuple[str, str, str]:
        sides: tuple[Outcome, Outcome] = (found.real_outcome, found.sim_outcome)
        real, sim = (number(getattr(side, name), unit, scale, digits) for side in sides)
        return title, real, sim

    return Rows(
        ("", "rig", "simulation"),
        (
            row("Distance to the goal", "distance_m", "cm", 100.0, 1),
            row("Hops (all feet 10 mm clear)", "hops", "", 1.0, 0),
            row("Highest hop", "clearance_m", "mm", 1000.0, 0),
            row("Distance travelled", "travel_m", "cm", 100.0, 1),
            row("Tilt at the end", "tilt_rad", "°", math.degrees(1.0), 1),
        ),
    )


def error_rows(found: Comparison) -> Rows:
    """Return how far rig and simulation differ.

    Args:
        found: the comparison
    """
    joints = [
        (f"Joint {joint.name}", number(joint.rmse_deg, "°", digits=2), number(joint.max_deg, "°", digits=2))
        for joint in found.joints
    ]
    base = ("Path of the base", number(found.base_rms_m, "cm", 100.0), "")
    return Rows(("", "RMS difference", "largest"), (*joints, base))


def timing_rows(found: Comparison) -> Rows:
    """Return how punctual the loop was.

    Args:
        found: the comparison
    """
    import numpy as np

    timing = found.timing
    series = {
        "Period": np.diff(timing.start_s),
        "Reading the servos": timing.read_s,
        "Control cycle": timing.compute_s,
        "Writing the goals": timing.write_s,
        **{f"Age of {name} when used": ages for name, ages in timing.ages_s.items()},
    }
    rows = []
    for title, values in series.items():
        seen = values[np.isfinite(values)]
        spread = np.percentile(seen, [50, 99, 100]) if len(seen) else [math.nan] * 3
        rows.append((title, *(number(float(value), "ms", 1000.0, 2) for value in spread)))
    return Rows(("", "median", "99 %", "largest"), tuple(rows))


def _lead(found: Comparison) -> str:
    goal = ""
    if found.goal_m is not None:
        bearing = number(math.degrees(found.goal_m[1]), "°")
        aside = "" if found.goal_m[1] == 0.0 else f", {bearing} to the left"
        goal = f" · goal {number(found.goal_m[0], 'cm', 100.0)} ahead{aside}"
    twin = " · with a twin" if found.meta.get("twin") else ""
    seconds = number(float(found.time_s[-1]), "s")
    end = "" if found.complete else " · the log ends abruptly"
    return f"{found.log.name}{goal} · {seconds} at {1 / found.timing.period_s:.0f}{NARROW}Hz{twin}{end}"


def _verdict(found: Comparison) -> str:
    worst = max(found.joints, key=lambda joint: joint.rmse_deg)
    agree = f"Rig and simulation differ by at most {number(worst.rmse_deg, '°', digits=2)} RMS on any joint"
    timing = found.timing
    cycles = (
        f"{len(timing.start_s)} control cycles, {timing.overruns} of them late, {timing.missed_replies} answers missed"
    )
    outcome = found.real_outcome
    if outcome.distance_m is None:
        return f"{agree}. {cycles}."
    hops = "" if outcome.hops is None else f" after {outcome.hops} hop{'s' * (outcome.hops != 1)}"
    end = f"The robot ended {number(outcome.distance_m, 'cm', 100.0)} from its goal{hops}"
    return f"{end}. {agree}. {cycles}."


def _input_rows(controller: Controller) -> Rows:
    return Rows(
        ("terminal", "unit", "low", "high"),
        tuple((i.name, i.unit, _plain(i.low), _plain(i.high)) for i in controller.inputs),
        text_columns=2,
    )


def _output_rows(controller: Controller) -> Rows:
    return Rows(
        ("joint", "kind", "unit", "low", "high", "neutral"),
        tuple((o.name, o.kind, o.unit, _plain(o.low), _plain(o.high), _plain(o.neutral)) for o in controller.outputs),
        text_columns=3,
    )


def _servo_rows(rig: Rig) -> Rows:
    return Rows(
        ("joint", "servo", "gains", "id", "torque ceiling"),
        tuple(
            (
                joint.name,
                joint.product.name,
                ", ".join(f"{key} {joint.gains[names[0]]}" for key, names in joint.family.gains[joint.mode].items()),
                str(joint.id),
                str(joint.ceiling),
            )
            for joint in rig.joints
        ),
        text_columns=3,
    )


def _parameter_rows(found: Comparison, controller: Controller) -> Rows:
    rows = [
        ("Control period", number(controller.period_s, "ms", 1000.0)),
        ("Command filter", _plain(controller.filter)),
        ("Slew limit", number(controller.slew_rad_s, "rad/s") if controller.slew_rad_s else "none"),
        ("Task", controller.task or "–"),
        ("Port", str(found.meta.get("port", "–"))),
        ("Supply", number(found.rig.supply_v, "V")),
        ("Bus", f"{found.rig.bus.protocol}, {found.rig.bus.baud / 1e6:g}{NARROW}Mbit/s"),
        ("Twin", "none" if not found.meta.get("twin") else " ".join(str(found.meta["twin"]).split())),
        ("Faults injected", ", ".join(map(str, found.meta.get("faults") or ())) or "none"),
    ]
    return Rows((), tuple(rows), text_columns=2)


def _version_rows(found: Comparison) -> Rows:
    versions = found.meta.get("versions") or {}
    return Rows((), tuple((name, str(version)) for name, version in versions.items()) or _NOTHING, text_columns=2)


def _provenance_rows(controller: Controller) -> Rows:
    rows = tuple(
        (key.replace("_", " "), f"{value:.4g}" if isinstance(value, float) else str(value))
        for key, value in controller.provenance.items()
    )
    return Rows((), rows or _NOTHING, text_columns=2)


def _event_rows(found: Comparison) -> Rows:
    rows = tuple((number(t, "s", digits=2), text) for t, text in found.events)
    return Rows(("time", "what"), rows or _NOTHING, text_columns=2)


def _plain(value: float) -> str:
    return f"{value:.9g}".replace("-", "−")
