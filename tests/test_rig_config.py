"""A rig as data in C says what the host loop makes of the same rig file, read back out of a compiled library."""

import ctypes
import math
import random
import subprocess
from dataclasses import replace

import pytest
from rig_in_c import rig_in_c

from controller import load_rig, parse_controller, registers
from controller.cycle import resolve_cycle
from controller.errors import InputError
from controller.families import family_of
from controller.library import SvCycle, SvGuard, SvOutput, SvSchedule, SvTerminal
from controller.native import lay_out_cycle
from controller.needed_sensors import needed_sensors
from controller.register import decode_register, encode_register
from controller.rig_file import rig_names
from controller.schedule import schedule_of
from deploy import checks
from deploy.joint_counts import goal_limits, joint_angle, joint_count, joint_speed, speed_count
from deploy.safety import judge_hardware_error
from deploy.servo_findings import setting_findings, state_findings
from deploy.torque import settings_in_ram
from firmware_gen.projects.plain import plain
from firmware_gen.projects.rig_config import require_speakable, rig_source
from firmware_gen.transpiler.literals import literal

RIGS = [name for name in rig_names() if load_rig(name).bus.protocol in ("dynamixel-2.0", "feetech-sts")]
KINDS = {6: "setting", 7: "low limit", 8: "high limit", 9: "voltage", 10: "temperature", 11: "position"}
KINDS |= {12: "hardware", 32: "torque"}
ENCODINGS = {0: "unsigned", 1: "twos", 10: "sign10", 11: "sign11", 15: "sign15"}


def controller_for(rig, **changes):
    """Return a controller that uses all a rig can tell it about the pose, and commands every joint."""
    names = {sensor.name for sensor in rig.sensors}
    inputs = [("t", "s")] + ([("px", "m")] if {"x", "y", "heading"} <= names else [])
    mode = rig.joints[0].mode
    unit = "deg" if mode == "position" else "rad/s"
    low = 60 if mode == "position" else 2
    text = f'program = "(list {" ".join([inputs[-1][0]] * len(rig.joints))})"\n[controller]\nname = "all"\n'
    text += f"period_s = {rig.period_s}\nslew_rad_s = 1.25\nfilter = 0.5\n"
    for name, of in inputs[-1:]:
        text += f'[[input]]\nname = "{name}"\nunit = "{of}"\nlow = -9\nhigh = 9\n'
    for joint in rig.joints:
        text += f'[[output]]\nname = "{joint.name}"\nkind = "{mode}"\nunit = "{unit}"\n'
        text += f"low = -{low}\nhigh = {low}\nneutral = 0\n"
    return replace(parse_controller(text, "all"), **changes)


@pytest.fixture(scope="module", params=RIGS)
def built(request, tmp_path_factory):
    rig = load_rig(request.param)
    controller = controller_for(rig)
    data, library = rig_in_c(tmp_path_factory.mktemp(request.param), rig, controller)
    return rig, controller, data, library


def single(value):
    return ctypes.c_float(value).value


def register_of(line):
    return (line.address, line.size, ENCODINGS[line.encoding]) if line.size else None


def servos_of(data):
    """Return each joint with its servo."""
    return [(joint, data.servos[joint.servo]) for joint in data.joints[: data.njoint]]


def named(joint, name):
    if name is None:
        return None
    line = registers(joint.product)[name]
    return line.address, line.size, line.encoding


def test_there_are_rigs_of_both_protocols():
    assert {load_rig(name).bus.protocol for name in RIGS} == {"dynamixel-2.0", "feetech-sts"}
    assert {load_rig(name).joints[0].mode for name in RIGS} == {"position", "velocity"}


def test_the_line_the_schedule_and_the_limits_are_the_rigs(built):
    rig, _, data, library = built
    assert data.protocol == ("dynamixel-2.0", "feetech-sts").index(rig.bus.protocol)
    assert (data.baud, data.return_delay_us) == (rig.bus.baud, rig.bus.return_delay_us)
    assert data.period_us == round(1e6 * rig.period_s)
    assert data.velocity_mode == (rig.joints[0].mode == "velocity") and not data.fast_sync_read
    assert data.homing_periods_max == math.ceil(10.0 / rig.period_s)

    schedule = schedule_of(rig)
    told = SvSchedule.in_dll(library, "servolve_schedule")
    assert (told.state.address, told.state.size) == schedule.state
    assert (told.goal.address, told.goal.size) == schedule.goal
    assert tuple((b.address, b.size) for b in told.health[: told.nhealth]) == schedule.health
    assert (told.nservo, told.health_every) == (len(rig.joints), schedule.health_every)

    safety, limits = data.safety, rig.safety
    assert safety.stop_holds == (limits.stop == "hold") and safety.homing_rad_s == single(limits.homing_rad_s)
    assert safety.tracking_rad_max == single(limits.tracking_rad_max)
    assert safety.tracking_us_max == round(1e6 * limits.tracking_s_max)
    assert (safety.missed_max, safety.overrun_max) == (limits.missed_cycles_max, limits.overrun_cycles_max)
    assert safety.temperature_max <= limits.temperature_c_max < safety.temperature_max + 1
    assert safety.tilt_cosine_min == single(math.cos(limits.tilt_rad_max))
    assert safety.watchdog_us == round(1e6 * limits.watchdog_s) and safety.watchdog_count * 20_000 == safety.watchdog_us


def test_every_joint_is_the_rigs(built):
    rig, _, data, _ = built
    assert data.njoint == len(rig.joints)
    velocity = rig.joints[0].mode == "velocity"
    for number, (joint, (told, servo)) in enumerate(zip(rig.joints, servos_of(data), strict=True)):
        family = family_of(joint.product)
        assert (told.id, servo.model, told.zero) == (joint.id, joint.product.model_number, joint.zero_tick)
        assert told.angle_scale == single(joint_angle(joint, joint.zero_tick + 1))
        assert (told.goal_low, told.goal_high) == goal_limits(joint)
        if not joint.unlimited:
            assert told.neutral == joint_count(joint, joint.neutral_rad)
        if velocity:
            assert told.goal_high == abs(speed_count(joint, joint.speed_rad_s_max))
            the_axis_is_the_joints(data.axes[number], joint)
        assert servo.rest_count == max(1, round(0.06 / joint.product.velocity_unit_rad_s))
        assert servo.ceiling_count == joint.ceiling
        roles = {
            "position": family.position,
            "velocity": family.velocity,
            "load": family.load,
            "goal": family.goal(joint.mode),
            "torque": family.torque_enable,
            "ceiling": family.torque_ceiling,
            "watchdog": family.watchdog,
            "hardware_error": family.hardware_error,
            "shutdown": family.shutdown,
            "voltage": family.voltage,
            "temperature": family.temperature,
        }
        assert {role: register_of(getattr(servo, role)) for role in roles} == {
            role: named(joint, name) for role, name in roles.items()
        }
        volts = registers(joint.product)[family.voltage].scale
        least, less = (round(count * volts, 6) for count in (servo.voltage_low, servo.voltage_low - 1))
        assert less < rig.safety.voltage_low_v <= least
        assert [bit for bit in range(8) if servo.error_bits >> bit & 1] == sorted(family.error_bits)
    assert bool(data.axes) == velocity


def the_axis_is_the_joints(axis, joint):
    assert (axis.zero, axis.unlimited) == (joint.zero_tick, joint.unlimited)
    assert axis.angle_scale == single(joint_angle(joint, joint.zero_tick + 1))
    assert axis.speed_scale == single(joint_speed(joint, 1))
    assert axis.neutral_rad == single(joint.neutral_rad)
    assert axis.speed_max == single(joint.speed_rad_s_max)
    if joint.unlimited:
        assert axis.low_rad < -3e38 and axis.high_rad > 3e38
    else:
        assert (axis.low_rad, axis.high_rad) == (single(joint.low_rad), single(joint.high_rad))


def test_what_a_joint_may_do_is_the_host_loops_in_counts(built):
    rig, controller, data, _ = built
    for joint, (_, told) in zip(rig.joints, servos_of(data), strict=True):
        angle = abs(joint_angle(joint, joint.zero_tick + 1))
        assert told.jump_counts * angle == pytest.approx(0.2)
        assert 1e6 * told.counts_per_us * angle == pytest.approx(1.2 * joint.product.no_load_speed_rad_s)
        assert told.tracking_counts * angle <= rig.safety.tracking_rad_max < (told.tracking_counts + 1) * angle
        unit = angle if joint.mode == "position" else abs(joint_speed(joint, 1))
        slewed = 1.001 * (controller.slew_rad_s * rig.period_s + unit)
        assert told.slew_counts * unit <= slewed < (told.slew_counts + 1) * unit
        homed = 1.001 * (rig.safety.homing_rad_s * rig.period_s + unit)
        if joint.mode == "velocity":
            assert told.homing_counts == 2**32 - 1  # any: nothing bounds its rate then
        else:
            assert told.homing_counts * unit <= homed < (told.homing_counts + 1) * unit


def test_the_blocks_of_the_check_are_the_host_loops(built):
    rig, _, data, _ = built
    for joint, (_, told) in zip(rig.joints, servos_of(data), strict=True):
        blocks = [(b[0].address, b[-1].address + b[-1].size - b[0].address) for b in checks._blocks(joint)]
        assert [(b.address, b.size) for b in told.tables] == blocks


def test_settings_are_written_in_the_host_loops_order(built):
    rig, _, data, _ = built
    for joint, (_, told) in zip(rig.joints, servos_of(data), strict=True):
        rows = [(register_of(row.reg), row.value) for row in told.settings[: told.nsetting]]
        rows += [(register_of(told.ceiling), told.ceiling_count)] if told.ceiling.size else []
        assert rows == [(named(joint, line.name), count) for line, count in settings_in_ram(joint, 1.0)]


def test_sensors_are_the_rigs_and_those_that_are_needed_are_known(built):
    rig, controller, data, _ = built
    messages = data.messages[: data.nmessage]
    told = [
        (m.letter.decode(), s.field, s.zero, s.scale, m.latency_us, s.age_us_max)
        for s in data.sensors[: data.nsensor]
        for m in (messages[s.message],)
    ]
    assert told == [
        (s.message, s.field, s.zero, single(s.scale), round(1e6 * s.latency_s), round(1e6 * s.age_s_max))
        for s in rig.sensors
    ]
    widths = {m.letter.decode(): m.width for m in messages}
    assert widths == {
        letter: 1 + max(s.field for s in rig.sensors if s.message == letter)
        for letter in {s.message for s in rig.sensors}
    }
    needed = {number for number, sensor in enumerate(data.sensors[: data.nsensor]) if sensor.needed}
    assert needed == needed_sensors(rig, controller)
    names = [sensor.name for sensor in rig.sensors]
    assert [names.index(name) if name in names else -1 for name in ("roll", "pitch")] == [data.roll, data.pitch]


def test_the_cycle_is_the_host_loops_number_for_number(built):
    rig, controller, _, library = built
    mine, packed = SvCycle.in_dll(library, "servolve_cycle"), lay_out_cycle(resolve_cycle(controller, rig))
    ninput, noutput = len(controller.inputs), len(controller.outputs)
    program = mine.program.contents
    assert (program.ninput, program.noutput, program.nstate) == (ninput, noutput, controller.program.nstate)
    assert bytes((SvTerminal * ninput)(*mine.terminals[:ninput])) == bytes(
        (SvTerminal * ninput)(*packed.terminals[:ninput])
    )
    assert bytes((SvOutput * noutput)(*mine.outputs[:noutput])) == bytes(
        (SvOutput * noutput)(*packed.outputs[:noutput])
    )
    unguarded = all(guard.angle.channel < 0 for guard in packed.guards[:noutput])
    assert bool(mine.guards) != unguarded
    if not unguarded:
        assert bytes((SvGuard * noutput)(*mine.guards[:noutput])) == bytes(
            (SvGuard * noutput)(*packed.guards[:noutput])
        )
    for name in ("period_s", "filter", "slew_step", "nraw"):
        assert getattr(mine, name) == getattr(packed, name), name
    for name in ("x", "y", "heading", "facing"):
        assert bytes(getattr(mine, name)) == bytes(getattr(packed, name)), name


def bounds(row, told):
    """Return what a row allows, as the firmware's check judges it."""
    if KINDS[row.kind] == "position":
        return told.place_low, told.place_high
    if KINDS[row.kind] == "low limit":
        return row.low, told.goal_low
    return (told.goal_high, 2**31 - 1) if KINDS[row.kind] == "high limit" else (row.low, row.high)


def found(joint, told, servo, values):
    """Return what the rows in C find in a servo's registers: level, kind, address."""
    lines = registers(joint.product).values()
    at = {(line.address, line.size): values[line.name] for line in lines}
    findings = []
    for row in servo.checks[: servo.ncheck]:
        count = at[row.reg.address, row.reg.size]
        low, high = bounds(row, told)
        if not low <= (count & row.mask if row.mask else count) <= high:
            kind = KINDS[row.kind].replace("low limit", "setting").replace("high limit", "setting")
            findings.append(("warning" if kind == "torque" else "error", kind, row.reg.address))
    return findings


def told_by_host(rig, joint, values):
    """Return what the host loop finds, in the same form."""
    family, table = joint.family, registers(joint.product)
    words = {
        "supply is": ("voltage", family.voltage),
        "Celsius": ("temperature", family.temperature),
        "stands at": ("position", family.position),
        "its position": ("position", family.position),
        "torque was on": ("torque", family.torque_enable),
        "hardware error": ("hardware", family.hardware_error),
    }
    findings = [*setting_findings(rig, joint, values), *state_findings(rig, joint, values)]
    error = judge_hardware_error(joint, values[family.hardware_error], values[family.shutdown])
    findings += [checks.Finding("error", error)] if error else []
    listed = []
    for finding in sorted(findings, key=lambda finding: finding.level):
        if finding.fix is not None:
            kind, name = "setting", finding.fix.register
        else:
            kind, name = next(found for word, found in words.items() if word in finding.text)
        listed.append((finding.level, kind, table[name].address))
    return listed


def test_checks_find_what_the_host_loop_finds_whatever_a_servo_holds(built):
    rig, _, data, _ = built
    rng = random.Random(7)
    seen = set()
    for joint, (told, servo) in zip(rig.joints, servos_of(data), strict=True):
        table = registers(joint.product)
        rows = servo.checks[: servo.ncheck]
        by_place = {(line.address, line.size): line for line in table.values()}
        checked = [(row, by_place[row.reg.address, row.reg.size]) for row in rows]
        good = {line.name: line.initial for line in table.values()}
        allowed = {line.name: bounds(row, told) for row, line in checked if row.mask == 0}
        good |= {name: min(max(good[name], low), high) for name, (low, high) in allowed.items()}
        good["shutdown" if "shutdown" in table else "unloading_condition"] = 53
        if "phase" in good:
            good["phase"] &= ~0x10
        assert found(joint, told, servo, good) == told_by_host(rig, joint, good) == []
        for _ in range(1500):
            values = dict(good)
            for row, line in rng.sample(checked, rng.choice((1, 1, 2, len(checked)))):
                values[line.name] = rng.choice(counts_near(*bounds(row, told), line))
            findings = found(joint, told, servo, values)
            assert findings == told_by_host(rig, joint, values), values
            seen |= {(kind, address) for _, kind, address in findings}
    assert len(seen) == len({(KINDS[row.kind], row.reg.address) for row in rows}), "every row has found something"


def counts_near(low, high, line):
    """Return counts at the edges of what is allowed, and at those of what the register can hold."""
    ends = decode_register(line, b"\xff" * line.size), decode_register(line, b"\x00" * line.size)
    counts = [low - 1, low, high, high + 1, line.initial, line.high, *ends]
    # what needs all 32 bits without a sign is no setting that a servo takes; the firmware's counts have a sign
    return [count for count in counts if fits(line, count) and -(2**31) <= count < 2**31]


def fits(line, count):
    try:
        return decode_register(line, encode_register(line, count)) == count
    except (ValueError, OverflowError):
        return False


def test_registers_are_coded_as_the_host_loop_codes_them(built):
    rig, _, data, library = built
    rng = random.Random(3)
    for joint, (_, told) in zip(rig.joints, servos_of(data), strict=True):
        for role in ("position", "velocity", "load", "goal", "torque", "voltage", "temperature"):
            line = next(
                one
                for one in registers(joint.product).values()
                if (one.address, one.size) == (getattr(told, role).address, getattr(told, role).size)
            )
            for _ in range(50):
                data_bytes = rng.randbytes(line.size)
                got = library.sv_register_decode(ctypes.byref(getattr(told, role)), data_bytes)
                assert got == ctypes.c_int32(decode_register(line, data_bytes)).value
                written = ctypes.create_string_buffer(line.size)
                library.sv_register_encode(ctypes.byref(getattr(told, role)), got, written)
                assert decode_register(line, written.raw) == got


HOSTILE = ("a */ int x; /*", "b\nint x;", "c\\", 'd"', "e??/", "f" * 500, "großer", "`rm`", "</table>")


@pytest.mark.parametrize("name", HOSTILE)
def test_no_name_gets_out_of_its_comment(name, tmp_path):
    rig = load_rig("lamp-xc330")
    controller = controller_for(rig)
    plain_lines = rig_source(rig, controller).splitlines()
    evil = replace(rig, name=name, sensors=tuple(replace(s, terminal=s.terminal) for s in rig.sensors))
    text = rig_source(evil, replace(controller, name=name))
    differing = [pair for pair in zip(plain_lines, text.splitlines(), strict=True) if pair[0] != pair[1]]
    # the comment in the first line, and nothing else: the fingerprint is of the files' texts
    assert all(new.startswith("// Rig ") or ".fingerprint" in new for _, new in differing)
    path = tmp_path / "comment.c"
    path.write_text(f"// {plain(name)}\nint ok;\n")
    command = ["gcc", "-E", "-trigraphs", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "int ok" in done.stdout


@pytest.mark.parametrize("name", ["lamp-ax12", "paper-lamp", "paper-jumper"])
def test_rigs_that_firmware_does_not_speak_with_are_refused_with_a_remedy(name):
    with pytest.raises(InputError, match=r"; choose a rig"):
        require_speakable(load_rig(name))


def test_a_controller_that_does_not_fit_is_refused():
    with pytest.raises(InputError, match="joints of rig"):
        rig_source(load_rig("jumper-xc330"), controller_for(load_rig("lamp-xc330")))


def test_floats_survive_their_decimals():
    rig = load_rig("lamp-xc330")
    for joint in rig.joints:
        scale = ctypes.c_float(joint_angle(joint, joint.zero_tick + 1))
        assert single(float(literal(scale.value).strip("()F"))) == scale.value
