"""`servolve deploy` on the virtual rig: what it prints, what it returns, and what it says of wrong arguments."""

import gc
import json
import os
import subprocess
import sys

import pytest
from lamp_controllers import NOD

from deploy.logs.log import read_log
from deploy.realtime import realtime
from servolve.cli import main


@pytest.fixture
def deploy(tmp_path, capsys):
    """Return a function that runs the command and gives status, standard output and standard error."""
    path = tmp_path / "nod.controller.toml"
    path.write_text(NOD)

    def run(*arguments, controller=str(path)):
        status = main(["deploy", controller, "--rig", "lamp-xc330", *arguments])
        told = capsys.readouterr()
        return status, told.out, told.err

    return run


def test_json_is_one_object_on_stdout(deploy, tmp_path):
    status, out, _ = deploy("--json", "--goal", "0.25", "--log", str(tmp_path / "run.mcap"))
    assert status == 0
    assert out.count("\n") == 1
    said = json.loads(out)
    assert (said["controller"], said["rig"], said["port"]) == ("nod", "lamp-xc330", "virtual")
    assert (said["state"], said["done"], said["fault"], said["cycles"]) == ("off", True, None, 25)
    assert (said["missed_deadlines"], said["missed_replies"], said["torque_unsure"]) == (0, 0, [])
    assert said["log"] == str(tmp_path / "run.mcap")
    assert said["final_px_m"] == pytest.approx(0.25, abs=0.05)
    assert said["final_error_m"] == pytest.approx(said["wire_error_m"], abs=1e-3)  # the judge's view and the wire's
    assert said["upright"] is True and said["hops"] >= 0
    frames = read_log(tmp_path / "run.mcap").messages["/bus"]
    assert said["bus_bytes"] == sum(len(frame["hex"]) // 2 for frame in frames)


def test_the_table_goes_to_stderr(deploy):
    status, out, err = deploy()
    assert (status, out) == (0, "")
    assert "final px" in err and "missed deadlines" in err


def test_a_fault_is_one_sentence_and_status_1(deploy):
    status, out, err = deploy("--seconds", "3", "--fault", "dead=2@1.0", "--json")
    assert status == 1
    said = json.loads(out)
    assert said["state"] == "fault" and said["fault"].startswith("joint a1 (servo 2) gave no reply")
    assert said["torque_unsure"] == ["a1"]
    lines = [line for line in err.splitlines() if line]
    assert len(lines) == 1
    assert lines[0].startswith("servolve: joint a1 (servo 2) gave no reply for 4 periods")
    assert "torque could not be switched off for certain on a1 (servo 2); cut the power" in lines[0]


def test_meta_says_how_it_was_run(deploy, tmp_path):
    twin = tmp_path / "weak.twin.toml"
    twin.write_text('format = 1\n[twin]\nname = "weak"\ntorque_scale = 0.8\n')
    arguments = ("--twin", str(twin), "--fault", "drop=0.01", "--seed", "5", "--derate", "0.5", "--seconds", "0.3")
    assert deploy(*arguments, "--log", str(tmp_path / "twin.mcap"))[0] == 0
    meta = read_log(tmp_path / "twin.mcap").meta
    assert (meta["seed"], meta["faults"], meta["derate"], meta["seconds"]) == (5, ["drop=0.01"], 0.5, 0.3)
    assert meta["twin"] == twin.read_text()
    assert {"servolve", "dynamixel-sdk", "mujoco-core"} <= meta["versions"].keys()
    assert str(tmp_path) not in json.dumps(meta)


def test_a_twin_moves_otherwise(deploy, tmp_path):
    twin = tmp_path / "weak.twin.toml"
    twin.write_text('format = 1\n[twin]\nname = "weak"\ntorque_scale = 0.5\n')
    hashes = {json.loads(deploy("--json", *more)[1])["bus_sha256"] for more in ((), (), ("--twin", str(twin)))}
    assert len(hashes) == 2


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--goal", "1e9"), "--goal 1e+09: is no distance in reach"),
        (("--goal", "nan"), "--goal nan: is no distance in reach"),
        (("--seconds", "0"), "--seconds 0: is not between"),
        (("--seconds", "0.001"), "--seconds 0.001: is less than a control period of 0.02 s"),
        (("--port", "socket://localhost", "--sensor-port", "x"), "write socket://HOST:PORT"),
        (("--port", "socket://127.0.0.1:1", "--sensor-port", "x"), "serial port (Connection refused); check"),
        (("--port", "/dev/null", "--sensor-port", "x"), "serial port (Inappropriate ioctl for device); check"),
        (("--seconds", "nan"), "--seconds nan: is not between"),
        (("--derate", "0"), "--derate 0: is not above 0"),
        (("--derate", "1.5"), "--derate 1.5: is not above 0"),
        (("--sensor-port", "/dev/null"), "--sensor-port: the virtual rig brings its own"),
        (("--realtime",), "--realtime: the virtual rig runs in lock step"),
        (("--fault", "dead=9"), "fault dead=9: lamp-xc330 has no such servo"),
        (("--fault", "lost=1"), "fault 'lost=1': kind 'lost' is not known"),
        (("--twin", "/nowhere/t.toml"), "/nowhere/t.toml"),
        (("--log", "/nowhere/run.mcap"), "/nowhere/run.mcap: the log cannot be written there"),
        (("--port", "/dev/ttyNONE", "--sensor-port", "/dev/ttyNONE"), "/dev/ttyNONE: cannot be opened"),
        (("--port", "/dev/null", "--sensor-port", "/dev/null"), "/dev/null: cannot be opened as a serial port"),
        (("--port", "/dev/ttyNONE"), "name its port with --sensor-port"),
        (("--port", "/dev/ttyNONE", "--fault", "dead=1"), "act on the virtual rig only"),
        (("--port", "socket://127.0.0.1:1", "--sensor-port", "x"), "socket://127.0.0.1:1: cannot be opened"),
        (("--port", "socket://nonsense", "--sensor-port", "x"), "socket://nonsense: cannot be opened"),
    ],
)
def test_wrong_arguments_are_one_sentence_and_status_2(deploy, arguments, sentence):
    status, out, err = deploy(*arguments)
    assert (status, out) == (2, "")
    assert sentence in err and err.count("\n") == 1 and "Traceback" not in err


def test_a_controller_without_a_slew_limit_is_warned_of(deploy, tmp_path):
    path = tmp_path / "quick.controller.toml"
    path.write_text(NOD.replace("slew_rad_s = 5.0\n", "filter = 0.5\n"))
    status, out, err = deploy("--json", controller=str(path))
    text = "controller nod: has no slew limit (slew_rad_s); its goals may jump by 1 rad a period"
    assert status == 0 and json.loads(out)["findings"] == [text]  # half of -60 to 60 degrees
    assert err.splitlines() == [f"servolve: warning: {text}"]


def test_every_finding_is_told(deploy):
    status, _, err = deploy("--fault", "dead=2", "--fault", "dead=3", "--fault", "sensor-dead=F")
    assert status == 1
    lines = err.splitlines()
    assert [line for line in lines if line.startswith("servolve: error: joint a2 (servo 3): does not answer")]
    assert [line for line in lines if line.startswith("servolve: warning: sensor force: $F lines should come")]
    assert lines[-1].startswith("servolve: joint a1 (servo 2): does not answer")
    assert lines[-1].endswith("(and 1 more findings)")


def test_servos_can_be_driven_without_mujoco():
    code = "import servolve.deploy, servolve.replay, sys; print(sorted({'mujoco', 'sim_models'} & set(sys.modules)))"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout == "[]\n"


def test_realtime_is_given_back():
    policy, collecting = os.sched_getscheduler(0), gc.isenabled()
    with realtime() as refused:
        assert not gc.isenabled()
        assert all("; run" in sentence for sentence in refused)
    assert (os.sched_getscheduler(0), gc.isenabled()) == (policy, collecting)


def test_a_controller_that_does_not_fit_the_rig_is_refused(deploy, tmp_path):
    path = tmp_path / "other.controller.toml"
    path.write_text(NOD.replace('name = "t"', 'name = "s7"'))
    status, _, err = deploy(controller=str(path))
    assert status == 2
    assert "can not supply 's7'" in err and err.count("\n") == 1


def test_another_rig_is_recommended_to_a_controller_that_fits_it(request, tmp_path, capsys):
    text = (request.config.rootpath / "tests" / "golden" / "lamp-hop.controller.toml").read_text()
    for name, changed, told in (
        ("px", text, "choose a rig that can be built, as lamp-xc330"),
        ("vx", text.replace("px", "vx"), "lamp-hop fits no rig that can be built; evolve a controller on one"),
    ):
        path = tmp_path / f"{name}.controller.toml"
        path.write_text(changed)
        assert main(["deploy", str(path), "--rig", "paper-lamp"]) == 2
        err = capsys.readouterr().err
        assert told in err and err.count("\n") == 1
