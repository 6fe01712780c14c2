"""`servolve simulate`: one closed-loop simulation of a controller, told, logged and filmed."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import numpy as np
from cyclopts import Parameter
from rich.console import Console
from rich.table import Table

from controller import Controller, Rig, controller_text, load_controller
from controller.errors import InputError, RunError
from controller.rig import Joint
from controller.rig_file import require_bus
from servolve.run_rig import rig_of

if TYPE_CHECKING:
    from deploy.virtual.twin import Twin
    from sim_models.body import Scene
    from sim_models.simulation import Simulation

RIG: Final = "lamp-xc330"
GOAL_M: Final = 0.4
SECONDS: Final = 6.0
TIMESTEP_S: Final = 0.001

VIRTUAL_ONLY: Final = (
    *("torque_constant_scale", "d_gain_scale", "backlash_scale", "voltage_slope_scale", "encoder_bias_rad"),
    *("com_x_m", "com_y_m", "stiction_scale", "supply_ohm"),
    *("force_bias_n", "position_bias_m", "angle_bias_rad", "sensor_latency_s"),
)
"""What a twin can say that acts on the virtual rig only."""


def simulate(
    controller: Path,
    /,
    *,
    rig: str | None = None,
    goal: float = GOAL_M,
    bearing: float = 0.0,
    seconds: float | None = None,
    timestep: float | None = None,
    twin: Path | None = None,
    log: Path | None = None,
    video: Path | None = None,
    strip: Path | None = None,
    json_: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> int:
    """Simulate a controller on a rig once, closed-loop, the base free; a run's best with what stood in its way.

    Args:
        controller: a controller file, or a run folder (its best)
        rig: name that `servolve rig list` prints, or path of a rig file; left out: the one it was evolved on
        goal: distance of the goal from the start [m]
        bearing: its direction, left of the heading at the start [rad]
        seconds: length of the simulation; left out: as long as a rollout of the controller's evolution, or 6 [s]
        timestep: MuJoCo's step; left out: 0.001, or the twin's [s]
        twin: twin file, which makes the physics differ from the rig's nominal ones
        log: MCAP file to record
        video: MP4 file to film
        strip: PNG file for a strip of poses
        json_: print one JSON object

    Returns:
        exit status; 0: simulated, wherever the base ended
    """
    program = load_controller(controller)
    about = rig_of(controller, program, rig, RIG)
    length = float(program.provenance.get("time_limit_s", SECONDS)) if seconds is None else seconds
    if not -100.0 <= goal <= 100.0:
        raise InputError(f"--goal {goal:g}: is no distance in reach; give metres")
    if not -7.0 <= bearing <= 7.0:
        raise InputError(f"--bearing {bearing:g}: is more than a turn; give radians, from -3.14 to 3.14")
    if not about.period_s <= length <= 600.0:
        raise InputError(f"--seconds {length:g}: is not between {about.period_s:g} and 600; give another length")
    console = Console(stderr=True)
    if twin is not None:
        require_bus(about, "a twin")
    other = _load_twin(twin)
    run = _run(program, about, (goal, bearing), length, timestep, other, _scene(controller), console)
    status = int(run.statistics["status"])
    if log is not None:
        write_log(run, log, length, other)
    if strip is not None or video is not None:
        from sim_models.film import motion_of, write_strip, write_video

        motion = motion_of(run)
        if strip is not None:
            write_strip(motion, strip)
        if video is not None:
            write_video(motion, video)
    told = summary(run) | {name: str(path) for name, path in (("log", log), ("video", video), ("strip", strip)) if path}
    if json_:
        print(json.dumps(told))
    else:
        _print(Console(), told)
    if status != 0:
        raise RunError(f"{program.name}: the simulation diverged at {told['seconds']:g} s; give a smaller --timestep")
    return 0


def summary(run: Simulation) -> dict[str, Any]:
    """Return what is worth telling of a simulation.

    Args:
        run: the simulation

    Returns:
        field => number, text or None
    """
    row = run.statistics
    told: dict[str, Any] = {
        "controller": run.controller.name,
        "rig": run.rig.name,
        "goal_m": run.goal_dist,
        "bearing_rad": run.goal_bearing,
        "seconds": round(int(row["alive_steps"]) * run.rig.period_s, 9),
        "diverged": bool(row["status"]),
    }
    for name, field in (
        ("final_error_m", "final_error"),
        ("final_px_m", "final_px"),
        ("min_error_m", "min_error"),
        ("end_speed_m_s", "end_speed"),
        ("final_tilt_rad", "end_tilt"),
        ("end_joint_error_rad", "end_joint_error"),
        ("max_clearance_m", "max_clearance"),
    ):
        told[name] = round(float(row[field]), 6) if np.isfinite(row[field]) else None
    told["hops"] = int(row["hops"])
    told["upright"] = bool(row["upright_end"])
    for name, field in (("first_hit_s", "first_hit_step"), ("arrived_s", "arrive_step")):
        told[name] = round(int(row[field]) * run.rig.period_s, 9) if row[field] >= 0 else None
    return told


def write_log(run: Simulation, path: Path, seconds: float, twin: Twin | None) -> None:
    """Record a simulation as a log that `servolve replay` can put through again.

    Args:
        run: the simulation
        path: the MCAP file
        seconds: length that was asked for [s]
        twin: its twin, or None
    """
    from deploy.logs.cycle_message import CycleWords, finite
    from deploy.logs.log import RunLog
    from deploy.logs.log_topics import FORMAT
    from deploy.rig_io import raw_channels

    rig, names = run.rig, raw_channels(run.rig)
    words = CycleWords(rig, run.controller)
    with RunLog(path) as record:
        meta = {
            "format": FORMAT,
            "rig": rig.name,
            "rig_text": rig.text,
            "controller": run.controller.name,
            "controller_text": controller_text(run.controller),
            "goal_dist": run.goal_dist,
            "goal_bearing": run.goal_bearing,
            "period_s": rig.period_s,
            "port": "simulation",
            "seconds": seconds,
            "twin": None if twin is None else twin.text,
            "versions": _versions(),
        }
        record.write("/meta", 0.0, meta)
        for k, t in enumerate(run.time_s.tolist()):
            cycle = {
                "k": k,
                "raw": dict(zip(names, run.raw[k].tolist(), strict=True)),
                "age_s": dict(zip(names, _ages(rig, t), strict=True)),
                **words.values(run.terminals[k], run.outputs[k], run.goal_counts[k]),
                "missed": [],
                "t_write": t,
                **dict.fromkeys(("late_s", "read_s", "compute_s", "write_s"), 0.0),
            }
            record.write("/cycle", t, cycle)
            values = map(finite, run.trace[k].tolist())
            record.write("/sim", t, {"k": k, "channels": dict(zip(run.channels, values, strict=True))})


def _load_twin(twin: Path | None) -> Twin | None:
    if twin is None:
        return None
    from deploy.virtual.twin import load_twin

    return load_twin(twin)


def _scene(controller: Path) -> Scene | None:
    """Return what stood in the way when a run was evolved; None for a controller that is no run's folder."""
    from evolve.runs.run_file import load_again, read_run_file
    from evolve.runs.run_folder import RUN

    if not (controller.is_dir() and (controller / RUN).is_file()):
        return None
    found = read_run_file(controller)
    return load_again(controller, found)[0].scene_with(found.settings)


def _run(
    program: Controller,
    rig: Rig,
    goal: tuple[float, float],
    seconds: float,
    timestep: float | None,
    twin: Twin | None,
    scene: Scene | None,
    console: Console,
) -> Simulation:
    """Simulate on the nominal rig or its twin."""
    from deploy.virtual.twin import check_twin
    from sim_models.body import build_model, substeps
    from sim_models.simulation import simulate as simulate_once

    distance, bearing = goal
    if timestep is not None:
        substeps(rig, timestep, "--timestep")
    if twin is None:
        return simulate_once(
            program,
            rig,
            goal_dist=distance,
            goal_bearing=bearing,
            timestep_s=TIMESTEP_S if timestep is None else timestep,
            time_limit_s=seconds,
            scene=scene,
        )
    step = (twin.timestep_s or TIMESTEP_S) if timestep is None else timestep
    left_out = [key for key in VIRTUAL_ONLY if twin.changes(key)]
    if left_out:
        act = "acts" if len(left_out) == 1 else "act"
        console.print(
            f"servolve: warning: twin {twin.name}: {', '.join(left_out)} {act} on the virtual rig only; left out here",
            highlight=False,
        )
    check_twin(twin, [joint.name for joint in rig.joints], rig.name)
    own = [twin.joint(joint.name) for joint in rig.joints]
    # the twin's servos: their stall torque and supply change with their perturbation, their gain with the rig
    joints = tuple(_with_gains(joint, each.p_gain_scale) for joint, each in zip(rig.joints, own, strict=True))
    other = replace(rig, joints=joints)
    model = build_model(other, timestep_s=step, lean=True, scene=scene)
    for joint, each in zip(rig.joints, own, strict=True):
        dof = model.joint(joint.mjcf_joint).dofadr[0]
        model.dof_frictionloss[dof] *= each.joint_friction_scale
        model.dof_damping[dof] *= each.joint_damping_scale
        model.dof_armature[dof] *= each.armature_scale
    return replace(
        simulate_once(
            program,
            other,
            goal_dist=distance,
            goal_bearing=bearing,
            timestep_s=step,
            time_limit_s=seconds,
            perturbations=twin_perturbations(twin, rig),
            model=model,
            scene=scene,
        ),
        rig=rig,
    )


def _with_gains(joint: Joint, scale: float) -> Joint:
    """Return a joint whose P gain, of position or velocity, is another."""
    own = joint.family.gains[joint.mode]
    scaled = {name for key in ("p_gain", "velocity_p_gain") for name in own.get(key, ())}
    return replace(
        joint, gains={name: round(count * scale) if name in scaled else count for name, count in joint.gains.items()}
    )


def twin_perturbations(twin: Twin, rig: Rig) -> Any:  # noqa: ANN401  sim_models is imported lazily
    """Return the part of a twin that rollouts know as a perturbation.

    Args:
        twin: the twin
        rig: the rig

    Returns:
        One row of `sim_models.perturbations.Perturbations`.
    """
    from sim_models.perturbations import nominal_perturbations

    one = np.ones(1)
    return replace(
        nominal_perturbations(1, len(rig.joints)),
        friction=one * twin.friction_scale,
        mass=one * twin.mass_scale,
        torque=np.array([[twin.joint(joint.name).torque_scale for joint in rig.joints]]),
        voltage=one * (twin.open_circuit_v(rig.supply_v) / rig.supply_v),
        latency_s=one * twin.command_latency_s,
        pose_noise_m=one * twin.position_noise_m,
        angle_noise_rad=one * twin.angle_noise_rad,
        force_noise_n=one * twin.force_noise_n,
    )


def _ages(rig: Rig, t: float) -> list[float]:
    """Return how old each raw channel is at a control instant: servos are read then, sensor lines are held."""
    slack = 1e-6
    ages = [0.0] * (3 * len(rig.joints))
    for sensor in rig.sensors:
        newest = np.floor((t - sensor.latency_s) * sensor.rate_hz + slack)
        ages.append(round(t - max(float(newest), 0.0) / sensor.rate_hz, 6))
    return ages


def _versions() -> dict[str, str]:
    from importlib.metadata import version

    return {package: version(package) for package in ("servolve", "mujoco-core", "numpy")}


def _print(console: Console, told: dict[str, Any]) -> None:
    """Print the summary as a table."""
    table = Table(show_header=False, box=None)
    for name, value in told.items():
        shown = "-" if value is None else ("yes" if value else "no") if isinstance(value, bool) else str(value)
        table.add_row(name.replace("_", " "), shown)
    console.print(table, highlight=False)
