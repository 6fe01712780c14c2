"""Films: the lamp is seen to leave the floor, and faults of path and OpenGL are told in one sentence."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

from controller import load_controller, load_rig
from controller.errors import InputError, RunError
from sim_models.film import choose_poses, motion_of, moving_instants, write_strip, write_video
from sim_models.offscreen import Offscreen
from sim_models.simulation import simulate

PANEL = (300, 380)


@pytest.fixture(scope="module")
def motion(request):
    controller = load_controller(request.config.rootpath / "tests" / "golden" / "lamp-hop.controller.toml")
    return motion_of(simulate(controller, load_rig("lamp-xc330"), goal_dist=0.1, time_limit_s=1.2, timestep_s=0.002))


def red_rows(panel):
    """Return the rows of a panel that the red base covers, below the middle of the picture."""
    pixels = np.asarray(panel).astype(int)
    red = (pixels[..., 0] > 130) & (pixels[..., 1] < 90) & (pixels[..., 2] < 90)
    rows = np.flatnonzero(red[PANEL[1] // 2 :].sum(axis=1) > 20)
    return rows + PANEL[1] // 2


def test_strip_shows_the_lamp_in_the_air(motion, tmp_path):
    path = tmp_path / "strip.png"
    write_strip(motion, path, poses=8)
    with Image.open(path) as strip:
        assert strip.size == (8 * PANEL[0], PANEL[1])
        panels = [strip.crop((i * PANEL[0], 0, (i + 1) * PANEL[0], PANEL[1])) for i in range(8)]
    bottoms = [red_rows(panel).max() for panel in panels]
    chosen = [*choose_poses(motion.clearance_m[: moving_instants(motion)], 7), len(motion.time_s) - 1]
    highest = int(np.argmax(motion.clearance_m[chosen]))
    lift_m = motion.clearance_m[chosen[highest]]
    assert lift_m > 0.01
    # a panel shows 0.36 m in 380 pixels; the base may also pitch
    assert bottoms[0] - bottoms[highest] > 0.5 * lift_m * PANEL[1] / 0.36
    green = np.asarray(panels[-1]).astype(int)
    assert ((green[..., 1] > 100) & (green[..., 0] < 80)).sum() > 50  # the goal's flag


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


def test_a_context_is_freed(motion):
    from sim_models.body import build_model

    model = build_model(motion.rig)
    for _ in range(3):
        with Offscreen(model, 32, 32) as offscreen:
            offscreen.close()
            offscreen.close()
