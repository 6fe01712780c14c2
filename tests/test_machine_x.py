"""A random master against virtual X servos, judged by the rules in `manual_x.py`."""

import re

import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, rule, run_state_machine_as_test
from manual import Memory, load_items
from manual_x import (
    ACCESS,
    ACTION,
    ALERT,
    ALL,
    APART,
    BAUD,
    BOOT_S,
    BULK_READ,
    BULK_WRITE,
    CLEAR,
    CRC,
    FAIL,
    FAST_SYNC_READ,
    GOALS,
    LENGTH,
    MEASURED,
    MODES,
    MODES_X,
    PING,
    RANGE,
    READ,
    REBOOT,
    REG_WRITE,
    RESET,
    RESETS,
    SYNC_READ,
    SYNC_WRITE,
    TRIPPED,
    UNKNOWN,
    WRITE,
    Servo,
    fast_parts,
    frame,
    statuses,
    two,
)

from controller.rig_file import load_rig, parse_rig
from deploy.virtual.faults import parse_fault
from deploy.virtual.rig import VirtualRig


@pytest.mark.parametrize(
    ("servo", "instruction", "parameters", "told"),
    [
        (1, PING, "", "fffffd00010300 01 194e"),
        (ALL, PING, "", "fffffd00fe0300 01 3142"),
        (1, READ, "84000400", "fffffd00010700 02 84000400 1d15"),
        (1, WRITE, "740000020000", "fffffd00010900 03 740000020000 ca89"),
        (1, REG_WRITE, "6800c8000000", "fffffd00010900 04 6800c8000000 ae8e"),
        (1, RESET, "01", "fffffd00010400 06 01 a1e6"),
        (1, CLEAR, "0144584c22", "fffffd00010800 10 0144584c22 b1dc"),
        (ALL, SYNC_READ, "840004000102", "fffffd00fe0900 82 840004000102 cefa"),
        (ALL, BULK_READ, "01900002000292000100", "fffffd00fe0d00 92 01900002000292000100 1a05"),
    ],
)
def test_the_masters_packets_are_the_manuals(servo, instruction, parameters, told):
    assert frame(servo, instruction, bytes.fromhex(parameters)) == bytes.fromhex(told)


class XMachine(RuleBasedStateMachine):
    """Ask three servos of one line at random."""

    rig_name = "lamp-xc330"

    def __init__(self):
        super().__init__()
        rig = rig_of(self.rig_name)
        self.rig = VirtualRig(rig)
        self.baud = rig.bus.baud
        self.t = 0.0
        self.servos = []
        for joint in rig.joints:
            items = load_items("manual-x.csv", joint.product.name)
            memory = Memory(items, MEASURED)
            memory["id"] = joint.id
            memory["baud_rate"] = next(value for value, baud in BAUD.items() if baud == rig.bus.baud)
            memory["return_delay_time"] = rig.bus.return_delay_us // 2
            memory["pwm_limit"] = joint.pwm_limit
            self.servos.append(Servo(memory, MODES.get(joint.product.name, MODES_X)))
        self.items = list(items.values())
        self.writable = [item for item in self.items if item.writable and item.name not in APART]
        self.heard = [0.0] * len(self.servos)

    # the line

    def send(self, data):
        """Send bytes; return all that comes back."""
        self.t = self.rig.transmit(data, max(self.t, self.rig.now) + 1e-4)
        for index, servo in enumerate(self.servos):
            servo.waited(self.t - self.heard[index])
        replies = b""
        while (event := self.rig.next_event()) is not None:
            replies += b"".join(reply for _, reply in self.rig.replies_until(event))
            self.t = event
        return replies

    def ask(self, servo, instruction, parameters=b""):
        asked = self.send(frame(servo, instruction, parameters))
        for index, other in enumerate(self.servos):
            if other.baud == self.baud:
                self.heard[index] = self.t
        return statuses(asked)

    def hears(self, servo):
        return servo.baud == self.baud

    def judge(self, servo, replies, allowed, needed=2):
        """Hold a reply to what is allowed; return its error and data, or None for a silence that is right."""
        if not self.hears(servo) or servo.level < needed:
            assert replies == []
            return None
        [(identity, error, data)] = replies
        if error & ALERT:
            servo.alerted()
        assert identity == servo.id
        assert error & ~ALERT in allowed, f"error {error & ~ALERT}, the manual allows {sorted(allowed)}"
        return error & ~ALERT, data

    def look(self, *servos):
        """Ask who has tripped, before something is sent that nobody answers."""
        for servo in servos:
            if self.hears(servo):
                self.judge(servo, self.ask(servo.id, PING), {0}, 0)

    def allowed(self, servo, changes):
        each = [servo.errors(item, value) for item, value in changes]
        refused = [errors for errors in each if 0 not in errors]
        return set.union(*refused) if refused else set.union(*each)

    def settle(self, servo, changes, allowed, outcome):
        """Note what a write did: outcome is its error, or None where nobody said."""
        if outcome == 0 or (outcome is None and allowed == {0}):
            for item, value in changes:
                servo.take(item, value)
        elif outcome is None and 0 in allowed:
            for item, _ in changes:
                servo.memory.forget(item.name, *RESETS.get(item.name, ()))

    def write(self, servo, changes, instruction=WRITE):
        if servo.level < 2:
            self.look(servo)
        allowed = self.allowed(servo, changes)
        data = b"".join(item.encode(value) for item, value in changes)
        if servo.fuzzy:  # torque may be off since the last reply
            allowed = allowed | self.allowed(servo, changes)
        before = servo.fuzzy
        replies = self.ask(servo.id, instruction, two(changes[0][0].address) + data)
        if replies and replies[0][1] & ALERT and not before:
            servo.alerted()
            allowed = allowed | self.allowed(servo, changes)
        try:
            told = self.judge(servo, replies, allowed)
        except AssertionError as error:
            raise AssertionError(f"writing {[(item.name, value) for item, value in changes]}: {error}") from None
        if self.hears(servo):
            self.settle(servo, changes, allowed, told and told[0])

    # what a master does

    INDEX = st.integers(0, 2)
    KIND = st.sampled_from(["low", "high", "below", "above", "within", "within", "initial"])
    NUMBER = st.integers(0, 2**32 - 1)

    def pick(self, number):
        return self.writable[number % len(self.writable)]

    @staticmethod
    def value(item, kind, number):
        value = {
            "low": item.low,
            "high": item.high,
            "below": item.low - 1,
            "above": item.high + 1,
            "within": item.low + number % (item.high - item.low + 1),
            "initial": item.initial or 0,
        }[kind]
        return item.decode(item.encode(value))

    def changes(self, number, kind, value, count):
        first = self.writable.index(self.pick(number))
        run = [self.writable[first]]
        for item in self.writable[first + 1 : first + count]:
            if item.address != run[-1].end or item.eeprom != run[0].eeprom:
                break
            run.append(item)
        return [(item, self.value(item, kind, value >> 3 * place)) for place, item in enumerate(run)]

    @rule(index=INDEX, first=NUMBER, count=st.integers(1, 12))
    def read(self, index, first, count):
        servo = self.servos[index]
        run = [self.items[first % len(self.items)]]
        for item in self.items[self.items.index(run[0]) + 1 :][: count - 1]:
            if item.address != run[-1].end:
                break
            run.append(item)
        address, length = run[0].address, run[-1].end - run[0].address
        told = self.judge(servo, self.ask(servo.id, READ, two(address, length)), {0}, 1)
        if told:
            assert len(told[1]) == length
            servo.memory.check(address, told[1])

    @rule(index=INDEX, address=st.sampled_from([1000, 1022, 65535]), length=st.sampled_from([1, 4, 100]))
    def read_beyond_the_table(self, index, address, length):
        servo = self.servos[index]
        told = self.judge(servo, self.ask(servo.id, READ, two(address, length)), {ACCESS, RANGE}, 1)
        assert not told or told[1] == b""

    @rule(index=INDEX, number=NUMBER, kind=KIND, value=NUMBER, count=st.sampled_from([1, 1, 1, 2, 4]))
    def write_items(self, index, number, kind, value, count):
        self.write(self.servos[index], self.changes(number, kind, value, count))

    @rule(index=INDEX, number=NUMBER, kind=KIND, value=NUMBER)
    def write_a_goal(self, index, number, kind, value):
        names = [name for name in (*GOALS, "goal_position") if name in self.servos[index].memory.items]
        item = self.servos[index].memory.items[names[number % len(names)]]
        self.write(self.servos[index], [(item, self.value(item, kind, value))])

    @rule(index=INDEX, share=st.floats(0.0, 1.0))
    def write_a_goal_within_its_limits(self, index, share):
        memory = self.servos[index].memory
        low, high = memory["min_position_limit"], memory["max_position_limit"]
        if low is not None and high is not None and low <= high:
            self.write(self.servos[index], [(memory.items["goal_position"], round(low + share * (high - low)))])

    @rule(index=INDEX, on=st.booleans())
    def switch_torque(self, index, on):
        servo = self.servos[index]
        self.write(servo, [(servo.memory.items["torque_enable"], int(on))])

    @rule(index=INDEX, mode=st.sampled_from([0, 1, 2, 3, 3, 4, 5, 6, 16, 17]))
    def change_the_mode(self, index, mode):
        servo = self.servos[index]
        self.write(servo, [(servo.memory.items["operating_mode"], mode)])

    @rule(index=INDEX, number=NUMBER, value=NUMBER)
    def write_what_is_read_only(self, index, number, value):
        servo = self.servos[index]
        items = [item for item in self.items if not item.writable]
        item = items[number % len(items)]
        self.write(servo, [(item, item.decode(item.encode(value)))])

    @rule(index=INDEX, number=NUMBER)
    def write_half_an_item(self, index, number):
        servo = self.servos[index]
        items = [item for item in self.writable if item.size > 1 and not item.eeprom]
        item = items[number % len(items)]
        self.judge(servo, self.ask(servo.id, WRITE, two(item.address) + bytes(item.size - 1)), {LENGTH, RANGE})

    @rule(index=INDEX, number=NUMBER, kind=KIND, value=NUMBER)
    def register_a_write(self, index, number, kind, value):
        servo = self.servos[index]
        ram = [item for item in self.writable if not item.eeprom]
        item = ram[number % len(ram)]
        value = self.value(item, kind, value)
        now = servo.errors(item, value)
        # whether a write that would be refused is registered is left open
        replies = self.ask(servo.id, REG_WRITE, two(item.address) + item.encode(value))
        told = self.judge(servo, replies, now | {0})
        if not self.hears(servo):
            return
        if told and told[0]:
            return
        if told or now == {0}:
            servo.registered = (item, value)
            servo.memory["registered_instruction"] = 1
            self.read_item(servo, "registered_instruction")
        else:
            servo.registered = ("unknown",)
            servo.memory.forget("registered_instruction")

    @rule(index=INDEX, everybody=st.booleans())
    def act(self, index, everybody):
        servos = [servo for servo in self.servos if self.hears(servo)] if everybody else [self.servos[index]]
        self.look(*servos)
        before = {id(servo): self.registered_errors(servo) for servo in servos}
        replies = self.ask(ALL if everybody else servos[0].id, ACTION)
        if everybody:
            assert replies == []
        for servo in servos:
            allowed = before[id(servo)]
            told = None if everybody else self.judge(servo, replies, allowed)
            if not self.hears(servo):
                continue
            if servo.registered and len(servo.registered) == 2:
                self.settle(servo, [servo.registered], allowed, told and told[0])
            elif servo.registered:
                servo.memory.forget(*(item.name for item in self.writable if not item.eeprom))
            servo.registered = None
            servo.memory["registered_instruction"] = 0

    def registered_errors(self, servo):
        if not servo.registered:
            return {UNKNOWN}
        return servo.errors(*servo.registered) if len(servo.registered) == 2 else set(range(8))

    @rule(index=INDEX)
    def ping(self, index):
        servo = self.servos[index]
        told = self.judge(servo, self.ask(servo.id, PING), {0}, 0)
        if told:
            model = servo.memory["model_number"]
            assert (len(told[1]), int.from_bytes(told[1][:2], "little")) == (3, model)

    @rule()
    def ping_all(self):
        present = sorted(servo.id for servo in self.servos if self.hears(servo))
        assert [identity for identity, _, _ in self.ask(ALL, PING)] == present

    @rule(instruction=st.sampled_from([READ, WRITE, REG_WRITE]), number=NUMBER)
    def broadcasts_are_not_answered(self, instruction, number):
        item = self.items[number % len(self.items)]
        if instruction == READ:
            assert self.ask(ALL, READ, two(item.address, item.size)) == []
            return
        led = self.servos[0].memory.items["led"]
        self.look(*self.servos)
        value = number & 1
        if instruction == WRITE:
            assert self.ask(ALL, WRITE, two(led.address) + led.encode(value)) == []
            for servo in self.servos:
                if self.hears(servo):
                    servo.take(led, value)

    @rule(unused=st.integers(0, 252), instruction=st.sampled_from([PING, READ, WRITE, REBOOT, ACTION]))
    def nobody_answers_for_another(self, unused, instruction):
        ids = {servo.memory[name] for servo in self.servos for name in ("id", "secondary_id")}
        if unused not in ids:
            assert self.ask(unused, instruction, two(132, 4) if instruction in (READ, WRITE) else b"") == []

    @rule(index=INDEX, instruction=st.sampled_from([0, 7, 9, 0x42, 0x7F, 0xFF]))
    def an_unknown_instruction(self, index, instruction):
        servo = self.servos[index]
        replies = self.ask(servo.id, instruction, b"abc")
        if replies:
            [(identity, error, data)] = replies
            assert (identity, error & ~ALERT, data) == (servo.id, UNKNOWN, b"")

    # several at once

    @rule(order=st.permutations([0, 1, 2]), count=st.integers(1, 3), number=NUMBER, fast=st.booleans())
    def sync_read(self, order, count, number, fast):
        item = self.items[number % len(self.items)]
        asked = [self.servos[index] for index in order[:count]]
        ids = bytes(servo.id for servo in asked)
        parameters = two(item.address, item.size) + ids
        blocks = [(item.address, item.size)] * count
        self.read_several(asked, blocks, FAST_SYNC_READ if fast else SYNC_READ, parameters, fast)

    @rule(order=st.permutations([0, 1, 2]), count=st.integers(1, 3), numbers=st.tuples(NUMBER, NUMBER, NUMBER))
    def bulk_read(self, order, count, numbers):
        asked = [self.servos[index] for index in order[:count]]
        items = [self.items[number % len(self.items)] for number in numbers[:count]]
        blocks = [(item.address, item.size) for item in items]
        parameters = b"".join(bytes([servo.id]) + two(*block) for servo, block in zip(asked, blocks, strict=True))
        self.read_several(asked, blocks, BULK_READ, parameters, False)

    def read_several(self, asked, blocks, instruction, parameters, fast):
        answering = [self.hears(servo) and servo.level >= 1 for servo in asked]
        if fast:
            raw = self.send(frame(ALL, instruction, parameters))
            for index, other in enumerate(self.servos):
                if other.baud == self.baud:
                    self.heard[index] = self.t
            if not all(answering):
                assert raw == b""  # a part is missing: nobody can close the packet
                return
            replies = fast_parts(raw, [length for _, length in blocks])
        else:
            replies = self.ask(ALL, instruction, parameters)
            # who comes after a silent servo waits for it in vain
            asked = asked[: answering.index(False)] if False in answering else asked
        assert [reply[0] for reply in replies] == [servo.id for servo in asked]
        for servo, (_, error, data), (address, length) in zip(asked, replies, blocks, strict=False):
            if error & ALERT:
                servo.alerted()
            assert error & ~ALERT == 0 and len(data) == length
            servo.memory.check(address, data)

    @rule(order=st.permutations([0, 1, 2]), count=st.integers(1, 3), number=NUMBER, value=NUMBER, kind=KIND)
    def sync_write(self, order, count, number, value, kind):
        item = self.pick(number)
        asked = [self.servos[index] for index in order[:count]]
        changes = [[(item, self.value(item, kind, value >> 3 * place))] for place in range(count)]
        data = b"".join(bytes([s.id]) + item.encode(c[0][1]) for s, c in zip(asked, changes, strict=True))
        self.write_several(asked, changes, SYNC_WRITE, two(item.address, item.size) + data)

    @rule(order=st.permutations([0, 1, 2]), count=st.integers(1, 3), number=NUMBER, value=NUMBER, kind=KIND)
    def bulk_write(self, order, count, number, value, kind):
        asked = [self.servos[index] for index in order[:count]]
        items = [self.pick(number >> 5 * place) for place in range(count)]
        changes = [[(item, self.value(item, kind, value >> place))] for place, item in enumerate(items)]
        data = b"".join(
            bytes([servo.id]) + two(item.address, item.size) + item.encode(value)
            for servo, [(item, value)] in zip(asked, changes, strict=True)
        )
        self.write_several(asked, changes, BULK_WRITE, data)

    def write_several(self, asked, changes, instruction, parameters):
        self.look(*asked)
        allowed = [self.allowed(servo, change) for servo, change in zip(asked, changes, strict=True)]
        assert self.ask(ALL, instruction, parameters) == []
        for servo, change, errors in zip(asked, changes, allowed, strict=True):
            if self.hears(servo):
                self.settle(servo, change, errors, None)

    # identity

    def write_surely(self, servo, name, value):
        """Write what we must know of to find the servo again, unless what becomes of it is open."""
        item = servo.memory.items[name]
        self.look(servo)
        allowed = self.allowed(servo, [(item, value)])
        if servo.level == 2 or allowed == {0} or 0 not in allowed:
            self.write(servo, [(item, value)])

    @rule(index=INDEX, new=st.integers(0, 252))
    def change_the_id(self, index, new):
        servo = self.servos[index]
        taken = {other.memory[name] for other in self.servos for name in ("id", "secondary_id")}
        if new not in taken:
            self.write_surely(servo, "id", new)

    @rule(index=INDEX, new=st.integers(0, 255))
    def change_the_secondary_id(self, index, new):
        servo = self.servos[index]
        taken = {other.memory[name] for other in self.servos for name in ("id", "secondary_id")}
        if new not in taken:
            self.write_surely(servo, "secondary_id", new)

    @rule(index=INDEX, on=st.integers(0, 1))
    def write_to_the_secondary_id(self, index, on):
        servo = self.servos[index]
        second = servo.memory["secondary_id"]
        if second is None or second > 252 or not self.hears(servo):
            return
        led = servo.memory.items["led"]
        assert self.ask(second, WRITE, two(led.address) + led.encode(on)) == []
        servo.take(led, on)

    @rule(index=INDEX, rate=st.sampled_from([1, 2, 3, 3, 3, 4, 7, 8]))
    def change_the_bit_rate(self, index, rate):
        servo = self.servos[index]
        self.write_surely(servo, "baud_rate", rate)

    @rule(index=INDEX)
    def follow_the_bit_rate(self, index):
        self.baud = self.servos[index].baud
        self.rig.set_baud(self.baud)

    @rule(index=INDEX, level=st.sampled_from([0, 1, 2, 2, 2, 3]))
    def change_the_return_level(self, index, level):
        servo = self.servos[index]
        self.write(servo, [(servo.memory.items["status_return_level"], level)])
        if servo.level is None:
            servo.memory["status_return_level"] = 2

    # states

    @rule(index=INDEX)
    def reboot(self, index):
        servo = self.servos[index]
        self.judge(servo, self.ask(servo.id, REBOOT), {0})
        if self.hears(servo):
            servo.booted()
        self.pause(BOOT_S)

    @rule(index=INDEX, option=st.sampled_from([1, 2]))
    def reset_to_the_factorys(self, index, option):
        servo = self.servos[index]
        if servo.memory["torque_enable"] != 0:
            return
        kept = {"id": servo.id} | ({"baud_rate": servo.memory["baud_rate"]} if option == 2 else {})
        self.judge(servo, self.ask(servo.id, RESET, bytes([option])), {0})
        if self.hears(servo):
            servo.memory.start(eeprom=True)
            servo.registered = None
            for name, value in kept.items():
                servo.memory[name] = value
        self.pause(BOOT_S)

    @rule(index=INDEX)
    def clear_the_turns(self, index):
        servo = self.servos[index]
        self.judge(servo, self.ask(servo.id, CLEAR, b"\x01\x44\x58\x4c\x22"), {0, FAIL})
        servo.memory.forget("goal_position")

    @rule(index=INDEX, count=st.sampled_from([0, 1, 5, 50, 127, 128]))
    def arm_the_watchdog(self, index, count):
        servo = self.servos[index]
        self.look(servo)
        watchdog = servo.memory["bus_watchdog"]
        if watchdog is None or (watchdog == TRIPPED and count):
            return
        self.write(servo, [(servo.memory.items["bus_watchdog"], count)])

    @rule(seconds=st.sampled_from([0.004, 0.03, 0.2, 1.5, 3.0]))
    def pause(self, seconds):
        self.t = max(self.t, self.rig.now) + seconds
        self.rig.advance(self.t)

    @rule(index=INDEX, kind=st.sampled_from(["overload", "overheat"]))
    def a_hardware_error(self, index, kind):
        servo = self.servos[index]
        joint = self.rig.rig.joints[index]
        self.rig.set_faults([parse_fault(f"{kind}={joint.id}@{self.rig.now + 1e-3}-{self.rig.now + 2e-3}")])
        self.pause(0.02)
        self.rig.set_faults([])
        mask = servo.memory["shutdown"]
        servo.fuzzy = True
        servo.memory.forget("torque_enable")
        if self.hears(servo):
            [(_, error, _)] = self.ask(servo.id, PING)
            assert error & ALERT
            if mask is not None and mask & {"overload": 0x20, "overheat": 0x04}[kind]:
                servo.memory["torque_enable"] = 0
                self.read_item(servo, "torque_enable")
                servo.memory.forget("torque_enable")

    def read_item(self, servo, name):
        item = servo.memory.items[name]
        told = self.judge(servo, self.ask(servo.id, READ, two(item.address, item.size)), {0}, 1)
        if told:
            held = item.decode(told[1])
            assert held == servo.memory[name] or servo.memory[name] is None

    # a bad line

    @rule(junk=st.binary(max_size=40), cut=st.integers(1, 12), index=INDEX)
    def noise(self, junk, cut, index):
        whole = frame(self.servos[index].id, READ, two(0, 2))
        self.send(junk.replace(b"\xff\xff\xfd", b"\xff\xff\x00"))
        self.send(whole[:-cut])
        self.pause(0.2)
        self.look(*self.servos)

    @rule(index=INDEX, bit=st.integers(0, 15))
    def a_wrong_crc_changes_nothing(self, index, bit):
        servo = self.servos[index]
        led = servo.memory.items["led"]
        whole = bytearray(frame(servo.id, WRITE, two(led.address) + b"\x01"))
        whole[len(whole) - 2 + bit // 8] ^= 1 << bit % 8
        replies = statuses(self.send(bytes(whole)))
        assert all(error & ~ALERT == CRC for _, error, _ in replies)
        self.pause(0.2)


def rig_of(name):
    """Return a rig that is shipped, or the heavy lamp on XM430 servos."""
    if name != "xm430":
        return load_rig(name)
    rig = load_rig("lamp-xl430")
    text = re.sub(r"supply_v = [0-9.]+", "supply_v = 12.0", rig.text).replace('"xl430-w250"', '"xm430-w350"')
    return parse_rig(text, rig.path)


@pytest.mark.parametrize("rig_name", ["lamp-xc330", "lamp-xl430", "xm430"])
def test_servos_keep_the_manuals_rules(rig_name, machine_steps):
    machine = type("Machine", (XMachine,), {"rig_name": rig_name})
    run_state_machine_as_test(
        machine,
        settings=settings(
            max_examples=-(-machine_steps // 100),
            stateful_step_count=100,
            deadline=None,
            suppress_health_check=list(HealthCheck),
            database=None,
            phases=[Phase.generate],  # shrinking would take minutes; the steps are printed
        ),
    )
