"""Compare a rig's log with its simulation: what agrees, what must not, and that the figures mean what they say."""

from __future__ import annotations

import dataclasses
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from controller.errors import InputError
from deploy.logs.compare import compare
from deploy.logs.log import RunLog, read_log
from servolve.cli import main
from servolve.report import read_strip, report_html, write_report

HOPPER = Path(__file__).parent / "golden" / "lamp-hop.controller.toml"
TWIN = 'format = 1\n[twin]\nname = "weak"\ntorque_scale = 0.8\n'
JOINTS = ("a0", "a1", "a2")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("compare")


def deploy(log, *more):
    arguments = ["deploy", str(HOPPER), "--rig", "lamp-xc330", "--goal", "0.3", "--seconds", "3", "--log", str(log)]
    assert main([*arguments, *more]) == 0
    return log


@pytest.fixture(scope="module")
def log(folder):
    return deploy(folder / "rig.mcap")


@pytest.fixture(scope="module")
def found(log):
    return compare(log)


def rewrite(log, target, change):
    """Copy a log, each message as change(topic, message) gives it, None: left out."""
    with RunLog(target) as copy:
        for topic, messages in read_log(log).messages.items():
            for message in messages:
                changed = change(topic, dict(message))
                if changed is not None:
                    copy.write(topic, changed.pop("t"), changed)
    return target


def without(*topics):
    return lambda topic, message: None if topic in topics else message


# what must agree, and what must not


def test_without_a_twin_rig_and_simulation_agree_while_the_lamp_hops(found):
    assert [joint.name for joint in found.joints] == list(JOINTS)
    assert all(joint.samples == 150 and joint.rmse_deg <= 1.0 for joint in found.joints), found.joints
    assert found.real_outcome.hops == found.sim_outcome.hops >= 2
    assert found.base_rms_m < 0.005
    # both sides have really moved, and by more than they differ
    assert np.ptp(np.degrees(found.real.joint_rad), axis=0).min() > 10.0
    assert found.real_outcome.travel_m > 0.2
    # an encoder tick is 0.088 degrees: less than its quantisation noise would be too good to be true
    assert all(joint.rmse_deg > 0.01 for joint in found.joints)


def test_weaker_servos_differ_clearly_more(folder, found):
    twin = folder / "weak.toml"
    twin.write_text(TWIN)
    weak = compare(deploy(folder / "weak.mcap", "--twin", str(twin)))
    assert weak.rmse_deg_max > 1.0
    assert weak.rmse_deg_max > 4.0 * found.rmse_deg_max


def test_the_times_of_goals_on_the_wire_matter(log, folder, found):
    def late(topic, message):
        if topic == "/cycle":
            message["t_write"] += 0.01
        return None if topic == "/bus" else message

    shifted = compare(rewrite(log, folder / "late.mcap", late))
    assert shifted.rmse_deg_max > 1.0
    assert shifted.rmse_deg_max > 4.0 * found.rmse_deg_max


def test_without_the_bus_the_cycles_own_times_stand_in(log, folder, found):
    other = compare(rewrite(log, folder / "no-bus.mcap", without("/bus")))
    np.testing.assert_allclose(other.time_s, found.time_s, atol=2e-5)
    np.testing.assert_allclose(other.goal_time_s, found.goal_time_s, atol=2e-5)


def test_goals_arrive_after_the_encoders_are_read_in_the_same_period(found):
    wire = found.goal_time_s - found.time_s
    assert np.all((wire > 0.0002) & (wire < 0.01))
    np.testing.assert_allclose(np.diff(found.time_s), 0.02, atol=1e-4)


def test_the_simulation_sees_nothing_of_the_rig_but_its_start_and_goals(log, folder, found):
    first = read_log(log).cycles[0]["t"]

    def blind(topic, message):
        if topic == "/cycle":
            message["raw"] = dict.fromkeys(message["raw"], 2000)
        if topic == "/truth" and message["t"] > first:
            message["base_pos"] = [9.0, 9.0, 9.0]
            message["joint_rad"] = dict.fromkeys(JOINTS, 1.0)
        return message

    other = compare(rewrite(log, folder / "blind.mcap", blind))
    np.testing.assert_array_equal(other.sim.joint_rad, found.sim.joint_rad)
    np.testing.assert_array_equal(other.sim.position_m, found.sim.position_m)
    assert other.rmse_deg_max > 5.0


def test_a_rig_without_a_judge_is_placed_by_its_encoders_and_pose_sensor(log, folder, found):
    # the run up to the second landing: later, what the encoders cannot resolve has grown
    real = compare(rewrite(log, folder / "real.mcap", without("/truth")))
    assert real.pose_source == "sensors"
    assert real.real_outcome.hops is None and real.real_outcome.clearance_m is None
    assert real.real_outcome.distance_m == pytest.approx(found.real_outcome.distance_m, abs=0.002)
    early = real.time_s < 0.3
    assert np.degrees(np.abs(real.real.joint_rad - real.sim.joint_rad))[early].max() < 0.5


def test_answers_that_were_missed_are_not_compared(log, folder, found):
    def lossy(topic, message):
        if topic == "/cycle" and message["k"] % 3 == 1:
            message["missed"] = [2]
            message["raw"]["a1"] = 0
        return message

    other = compare(rewrite(log, folder / "lossy.mcap", lossy))
    assert [joint.samples for joint in other.joints] == [150, 100, 150]
    assert other.timing.missed_replies == 50
    assert other.joints[1].rmse_deg == pytest.approx(found.joints[1].rmse_deg, rel=0.5)


def test_the_timing_of_the_loop_is_the_logs(log, folder):
    def slow(topic, message):
        if topic == "/cycle" and message["k"] in (10, 11):
            message["read_s"] = 0.025
        return message

    timing = compare(rewrite(log, folder / "slow.mcap", slow)).timing
    assert timing.overruns == 2
    assert sorted(timing.ages_s) == ["force", "pose"]
    assert np.all((timing.ages_s["pose"] >= 0.005) & (timing.ages_s["pose"] < 0.016))


def test_a_derated_run_is_simulated_derated(folder):
    found = compare(deploy(folder / "derated.mcap", "--derate", "0.5"))
    assert [joint.pwm_limit for joint in found.rig.joints] == [442, 442, 442]
    assert all(joint.rmse_deg <= 1.0 for joint in found.joints), found.joints


# report and command


class Outline(HTMLParser):
    """Collect what a page refers to and what it says."""

    def __init__(self):
        super().__init__()
        self.references = []
        self.tags = []
        self.text = []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.references += [value for name, value in attrs if name in ("src", "href", "xlink:href", "action")]

    def handle_data(self, data):
        self.text.append(data)


def outline(page):
    found = Outline()
    found.feed(page)
    return found


def test_the_report_is_one_page_that_needs_nothing_else(found):
    page = report_html(found)
    seen = outline(page)
    assert seen.tags.count("svg") == 4
    assert not {"script", "link", "iframe", "img"} & set(seen.tags)
    assert all(reference.startswith("#") for reference in seen.references)
    assert "@import" not in page and not re.search(r"url\((?!#)", page)


def test_the_report_says_what_was_found(found):
    words = " ".join(" ".join(outline(report_html(found)).text).split())
    for joint in found.joints:
        assert f"{joint.rmse_deg:.2f}°" in words
    for label in ("angle [°]", "height [cm]", "lowest foot [mm]", "force [N]", "duration [ms]", "age when used [ms]"):
        assert label in words
    assert "lamp-hop on lamp-xc330" in words
    assert "(* drive (+ -2.588" in words
    assert "homing -> running" in words
    assert "xc330-m181" in words and "mujoco-core" in words
    assert f"{found.real_outcome.hops} hops on the rig" in words


def test_the_same_comparison_gives_the_same_report(log, found):
    assert report_html(compare(log)) == report_html(found)


def test_the_report_escapes_what_it_quotes(found):
    events = ((0.0, "<script>alert(1)</script>"),)
    page = report_html(dataclasses.replace(found, events=events))
    assert "<script>" not in page and "&lt;script&gt;" in page


def test_a_film_strip_is_embedded(found, folder):
    from PIL import Image

    strip = folder / "strip.png"
    Image.new("RGB", (40, 10), "red").save(strip)
    write_report(found, folder / "with-strip.html", strip)
    references = outline((folder / "with-strip.html").read_text("utf-8")).references
    assert sum(reference.startswith("data:image/png;base64,") for reference in references) == 1


def test_what_is_no_strip_is_refused():
    with pytest.raises(InputError, match=r"odd\.jpg"):
        read_strip(b"\xff\xd8\xff" * 20, "odd.jpg")


def test_a_rig_without_pose_gives_a_report_too(log, folder):
    def poseless(topic, message):
        if topic == "/meta":
            message["rig_text"] = message["rig_text"][: message["rig_text"].index("# Sensor lines")]
            message["controller_text"] = message["controller_text"].replace("px", "t")
        return None if topic == "/truth" else message

    found = compare(rewrite(log, folder / "poseless.mcap", poseless))
    assert found.pose_source == "none" and found.base_rms_m is None and found.real_outcome.distance_m is None
    assert outline(report_html(found)).tags.count("svg") == 4


def test_the_command_prints_one_json_object_last(log, folder, capsys):
    page = folder / "report.html"
    assert main(["compare", str(log), "--report", str(page), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert [joint["name"] for joint in told["joints"]] == list(JOINTS)
    assert told["real"]["hops"] >= 2 and told["loop"]["cycles"] == 150 and told["complete"]
    assert page.read_text("utf-8").startswith("<!DOCTYPE html>")


def test_the_command_prints_tables(log, capsys):
    assert main(["compare", str(log)]) == 0
    printed = capsys.readouterr().out
    assert "Joint a2" in printed and "Distance to the goal" in printed and "150 control cycles" in printed


def test_a_log_that_ends_abruptly_is_compared_as_far_as_it_goes(log, folder, capsys):
    cut = folder / "cut.mcap"
    cut.write_bytes(log.read_bytes()[: log.stat().st_size * 2 // 3])
    assert main(["compare", str(cut)]) == 0
    printed = capsys.readouterr()
    assert "ends abruptly" in printed.err and "150 control cycles" not in printed.out


def test_what_is_no_log_of_a_run_is_refused(log, folder):
    empty = folder / "empty.mcap"
    RunLog(empty).close()
    never_ran = rewrite(log, folder / "never-ran.mcap", without("/cycle"))
    stump = folder / "stump.mcap"
    stump.write_bytes(log.read_bytes()[:600])
    text = folder / "text.mcap"
    text.write_text("not a log")

    def without_raw(topic, message):
        if topic == "/cycle":
            del message["raw"]
        return message

    poor = rewrite(log, folder / "poor.mcap", without_raw)
    for path, place in (
        (empty, "/meta"),
        (never_ran, "/cycle"),
        (stump, "/meta"),
        (text, "MCAP"),
        (poor, "raw"),
        (folder, "folder|directory"),
        (folder / "missing.mcap", "No such file"),
    ):
        with pytest.raises(InputError, match=place) as refused:
            compare(path)
        assert str(path) in str(refused.value) and ";" in str(refused.value)
