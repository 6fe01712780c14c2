"""Films: the lamp is seen to leave the floor, and faults of path and OpenGL are told in one sentence."""

from __future__ import annotations

import dataclasses
import itertools
import os
import subprocess
import sys

import mujoco
import numpy as np
import pytest
from PIL import Image

from controller import load_controller, load_rig
from controller.errors import InputError, RunError
from sim_models.film import (
    choose_poses,
    motion_of,
    moving_instants,
    strip_instants,
    strip_layout,
    write_strip,
    write_video,
)
from sim_models.offscreen import Offscreen
from sim_models.simulation import simulate


@pytest.fixture(scope="module")
def motion(request):
    controller = load_controller(request.config.rootpath / "tests" / "golden" / "lamp-hop.controller.toml")
    return motion_of(simulate(controller, load_rig("lamp-xc330"), goal_dist=0.1, time_limit_s=1.2, timestep_s=0.002))


@pytest.fixture(scope="module")
def still(request):
    controller = load_controller(request.config.rootpath / "tests" / "golden" / "lamp-hop.controller.toml")
    return motion_of(simulate(controller, load_rig("lamp-xc330"), goal_dist=0.4, time_limit_s=0.1, timestep_s=0.002))


def panels_of(path, columns, rows):
    """Return the panels of a strip as arrays of integers."""
    with Image.open(path) as strip:
        width, height = strip.width // columns, strip.height // rows
        assert strip.size == (columns * width, rows * height)
        whole = np.asarray(strip.convert("RGB")).astype(int)
    corners = itertools.product(range(rows), range(columns))
    return [whole[row * height : (row + 1) * height, column * width : (column + 1) * width] for row, column in corners]


def seen(panel, colour):
    """Return where a colour is seen below the text of a panel: rows, columns."""
    red, green, blue = np.moveaxis(panel, -1, 0)
    kinds = {
        "red": (red > 130) & (green < 90) & (blue < 90),
        "green": (green > 90) & (red < 80) & (green > blue + 25),
    }
    rows, columns = np.nonzero(kinds[colour][40:])
    return rows + 40, columns


def test_strip_shows_the_lamp_in_the_air(motion, tmp_path):
    path = tmp_path / "strip.png"
    write_strip(motion, path, poses=8)
    chosen = strip_instants(motion, 8)
    highest = int(np.argmax(motion.clearance_m[chosen]))
    assert motion.clearance_m[chosen[highest]] > 0.01
    panels = panels_of(path, 4, 2)
    bottoms = [seen(panel, "red")[0].max() for panel in panels]
    # what is 0.3 m high fills the 300 pixels of a panel about; the base may also pitch
    assert bottoms[0] - bottoms[highest] > 0.5 * motion.clearance_m[chosen[highest]] * 300 / 0.35


@pytest.mark.parametrize("bearing", [0.0, 1.6, 3.1, -2.0])
@pytest.mark.parametrize("distance", [0.1, 0.4])
def test_goal_and_lamp_are_in_sight_wherever_the_goal_is(still, tmp_path, distance, bearing):
    direction = still.base[0, 3] + bearing
    goal = still.base[0, :2] + distance * np.array([np.cos(direction), np.sin(direction)])
    path = tmp_path / "strip.png"
    write_strip(dataclasses.replace(still, goal=(float(goal[0]), float(goal[1]))), path, poses=2)
    for panel in panels_of(path, 2, 1):
        for colour in ("green", "red"):
            rows, columns = seen(panel, colour)
            assert len(rows) > 100
            assert rows.max() < panel.shape[0] - 4 and columns.min() > 4 and columns.max() < panel.shape[1] - 4
        if distance > 0.1:
            assert seen(panel, "green")[1].min() > seen(panel, "red")[1].min() + panel.shape[1] / 4


def test_a_body_without_a_goal_of_its_own_is_filmed_with_one(still, tmp_path):
    rig = still.rig
    spec = mujoco.MjSpec.from_file(str(rig.body))
    spec.delete(spec.body("goal"))
    body = tmp_path / "plain.xml"
    body.write_text(spec.to_xml())
    path = tmp_path / "strip.png"
    write_strip(dataclasses.replace(still, rig=dataclasses.replace(rig, body=body)), path, poses=2)
    assert all(len(seen(panel, "green")[0]) > 50 for panel in panels_of(path, 2, 1))


def test_what_turns_or_swings_on_the_spot_moves(still):
    n, wave = 50, np.linspace(0, 0.5, 30)
    rest = dataclasses.replace(
        still,
        time_s=np.arange(n) * 0.02,
        base=np.repeat(still.base[:1], n, 0),
        joint_rad=np.repeat(still.joint_rad[:1], n, 0),
        clearance_m=np.zeros(n),
    )
    assert moving_instants(rest) == 1
    for name, column in (("base", 0), ("base", 3), ("base", 5), ("joint_rad", 1)):
        moved = getattr(rest, name).copy()
        moved[:30, column] += wave[::-1]
        assert 25 <= moving_instants(dataclasses.replace(rest, **{name: moved})) <= 30
    # from just under half a turn to just over it
    heading = rest.base.copy()
    heading[:, 3], heading[-1, 3] = np.pi - 0.01, -np.pi + 0.01
    assert moving_instants(dataclasses.replace(rest, base=heading)) == 1


@pytest.mark.parametrize(
    ("poses", "aspect", "layout"), [(10, 1.6, (2, 5)), (10, 3.2, (3, 3)), (3, 1.6, (1, 3)), (1, 3.2, (1, 1))]
)
def test_a_strip_fits_a_page(poses, aspect, layout):
    assert strip_layout(poses, aspect) == layout


def test_video_lasts_as_long_as_the_motion(motion, tmp_path):
    import imageio.v2 as imageio

    short = dataclasses.replace(motion, time_s=motion.time_s[:15])
    path = tmp_path / "film.mp4"
    write_video(short, path)
    with imageio.get_reader(path) as reader:
        facts = reader.get_meta_data()
        frames = list(reader.iter_data())
    assert facts["fps"] == 50 and len(frames) == 15
    assert frames[0].shape == (480, 1280, 3)
    assert np.abs(frames[0].astype(int) - frames[-1]).max() > 100


def test_poses_alternate_between_tops_and_landings():
    clearance = 0.03 * np.maximum(np.sin(np.arange(100) * 2 * np.pi / 12.5), 0)
    chosen = choose_poses(clearance, 10)
    assert chosen[0] == 0 and chosen[-1] == 99 and chosen == sorted(set(chosen)) and len(chosen) == 10
    heights = clearance[chosen[1:-1]]
    assert (heights[::2] > 0.025).all() and (heights[1::2] < 0.001).all()
    assert choose_poses(clearance[:5], 10) == [0, 1, 2, 3, 4]
    assert choose_poses(np.zeros(50), 4) == [0, 13, 37, 49]
    assert choose_poses(np.zeros(50), 2) == [0, 49] and choose_poses(np.zeros(50), 1) == [0]


@pytest.mark.parametrize(
    ("name", "fault"),
    [
        ("strip.jpg", "must end in .png"),
        ("nowhere/strip.png", "there is no folder"),
        ("folder.png", "this is a folder"),
    ],
)
def test_paths_that_cannot_be_written_are_refused(motion, tmp_path, name, fault):
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(InputError, match=fault):
        write_strip(motion, tmp_path / name)


def test_an_unknown_back_end_is_told(motion, tmp_path, monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "vulkan")
    with pytest.raises(RunError, match=r"MUJOCO_GL is 'vulkan'.*set MUJOCO_GL to egl, osmesa or glfw"):
        write_strip(motion, tmp_path / "strip.png")
    assert not list(tmp_path.iterdir())


def test_a_machine_without_opengl_is_told(tmp_path):
    # EGL that finds no driver at all, as on a machine without Mesa
    code = (
        "from controller.errors import RunError\n"
        "import mujoco\n"
        "from sim_models.offscreen import Offscreen\n"
        "model = mujoco.MjModel.from_xml_string('<mujoco/>')\n"
        "try:\n    Offscreen(model, 64, 64)\n"
        "except RunError as error:\n    print(error)\n"
    )
    environment = os.environ | {"MUJOCO_GL": "egl", "__EGL_VENDOR_LIBRARY_FILENAMES": str(tmp_path / "none.json")}
    told = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert told.stdout.startswith("pictures: there is no OpenGL for egl here (")
    assert told.stdout.count("\n") == 1 and "install libegl1" in told.stdout


def test_a_context_may_be_closed_again_and_made_anew(motion):
    from sim_models.body import build_model

    model = build_model(motion.rig)
    for _ in range(3):
        with Offscreen(model, 32, 32) as offscreen:
            offscreen.close()
            offscreen.close()
