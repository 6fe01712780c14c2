"""A random master against virtual AX-12A, STS3215 and SCS0009 servos, judged by the rules in `manual_protocol1.py`."""

import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import rule, run_state_machine_as_test
from line_master import LineMaster
from manual import Memory, load_items, scs_text
from manual_protocol1 import (
    ACTION,
    ALL,
    AX_BAUD,
    AX_STATES,
    CHECKSUM,
    FEETECH_BAUD,
    HOME,
    INSTRUCTION,
    MEASURED,
    MIDDLE,
    PING,
    READ,
    REG_WRITE,
    SYNC_READ,
    SYNC_WRITE,
    WRITE,
    Servo,
    frame,
    statuses,
)

from controller.rig_file import load_rig, parse_rig

# written by rules of their own, or fit to shut a servo up for good
APART = frozenset({"id", "baud_rate", "status_return_level", "response_level", "lock", "lock_scs", "phase"})
SHUTS_DOWN = frozenset(
    {
        *("temperature_limit", "max_temperature_limit", "min_voltage_limit", "max_voltage_limit"),
        *("unloading_condition", "shutdown", "overload_torque", "protection_time", "protection_current"),
        *("overcurrent_time", "protective_torque"),
    }
)


@pytest.mark.parametrize(
    ("servo", "instruction", "parameters", "told"),
    [
        (1, PING, "", "ffff 01 02 01 fb"),
        (1, READ, "2b01", "ffff 01 04 02 2b01 cc"),
        (ALL, SYNC_WRITE, "1e040010005001012002 6003", "ffff fe 0e 83 1e04 0010005001 0120026003 67"),
        (ALL, SYNC_READ, "1e020b0c", "ffff fe 06 82 1e020b0c 42"),
        (0xFE, WRITE, "0301", "ffff fe 04 03 0301 f6"),
    ],
)
def test_the_masters_packets_are_the_manuals(servo, instruction, parameters, told):
    assert frame(servo, instruction, bytes.fromhex(parameters)) == bytes.fromhex(told)


class Machine(LineMaster):
    """Ask the servos of one line at random."""

    family = "ax"

    def __init__(self):
        rig = rig_of(self.family)
        super().__init__(rig)
        self.rates = AX_BAUD if self.family == "ax" else FEETECH_BAUD
        file, column = (
            ("manual-ax.csv", "ax-12a") if self.family == "ax" else ("manual-feetech.csv", PRODUCT[self.family])
        )
        items = load_items(file, column, big=self.family == "scs")
        self.items = list(items.values())
        self.writable = [item for item in self.items if item.writable and item.name not in APART | SHUTS_DOWN]
        for joint in rig.joints:
            memory = Memory(items, MEASURED)
            for item in items.values():  # what a commissioned servo holds is the rig's affair
                if item.name not in ("model_number", "status_return_level", "response_level", "torque_enable"):
                    memory.forget(item.name)
            memory["id"] = joint.id
            memory["baud_rate"] = next(value for value, baud in self.rates.items() if baud == rig.bus.baud)
            servo = Servo(memory, self.family)
            self.servos.append(servo)
            if self.family != "ax":
                self.write(servo, items[servo.lock_name], 0)
        for servo in self.servos:
            self.read_all(servo)

    # the line

    def ask(self, servo, instruction, parameters=b""):
        return statuses(self.send(frame(servo, instruction, parameters)))

    def answer(self, servo, instruction, parameters=b"", expected=0):
        """Ask a servo; return the data, None for a silence that is right. Error bits None: whatever they are."""
        replies = self.ask(servo.id, instruction, parameters) if not isinstance(parameters, list) else parameters
        return self.judge(servo, replies, instruction, expected)

    def judge(self, servo, replies, instruction, expected):
        if not self.hears(servo) or not servo.answers(instruction):
            assert replies == []
            return None
        [(identity, error, data)] = replies
        assert identity == servo.id
        state = error & AX_STATES if self.family == "ax" else error
        if state:
            servo.doubtful()
        if expected is not None:
            assert error & ~state == expected, f"error {error:#x}, expected {expected:#x}"
        return error, data

    def read_all(self, servo):
        for item in self.items:
            told = self.answer(servo, READ, bytes([item.address, item.size]))
            if told:
                servo.memory.check(item.address, told[1])

    def write(self, servo, item, value):
        expected, done = servo.verdict(item, value)
        parameters = bytes([item.address]) + item.encode(value)
        replies = self.ask(servo.id, WRITE, parameters)
        # the answer to a change of level comes by the level that was
        told = self.judge(servo, replies, WRITE, expected)
        if not self.hears(servo):
            return
        if told and self.family == "ax" and done is None:
            done = not told[0] & ~AX_STATES
        self.settle(servo, item, value, done)

    def settle(self, servo, item, value, done):
        if done:
            servo.take(item, value)
        elif done is None:
            servo.take(item, value)
            servo.memory.forget(item.name)
            if item.name == "goal_position":
                servo.memory.forget("torque_enable")

    # what a master does

    INDEX = st.integers(0, 2)
    NUMBER = st.integers(0, 2**32 - 1)
    KIND = st.sampled_from(["low", "high", "below", "above", "within", "within", "within"])

    @rule(index=INDEX, first=NUMBER, count=st.integers(1, 10))
    def read(self, index, first, count):
        servo = self.servos[index]
        start = first % len(self.items)
        run = [self.items[start]]
        for item in self.items[start + 1 : start + count]:
            if item.address != run[-1].end:
                break
            run.append(item)
        length = run[-1].end - run[0].address
        told = self.answer(servo, READ, bytes([run[0].address, length]))
        if told:
            assert len(told[1]) == length
            servo.memory.check(run[0].address, told[1])

    @rule(index=INDEX, number=NUMBER, kind=KIND, value=NUMBER)
    def write_an_item(self, index, number, kind, value):
        item = self.writable[number % len(self.writable)]
        self.write(self.servos[index], item, self.value(item, kind, value))

    @rule(index=INDEX, number=NUMBER, value=NUMBER)
    def write_what_is_read_only(self, index, number, value):
        items = [item for item in self.items if not item.writable]
        item = items[number % len(items)]
        servo = self.servos[index]
        self.write(servo, item, item.decode(item.encode(value)))
        told = self.answer(servo, READ, bytes([item.address, item.size]))
        if told:
            servo.memory.check(item.address, told[1])

    @rule(index=INDEX, kind=KIND, value=NUMBER)
    def write_a_goal(self, index, kind, value):
        item = self.servos[index].memory.items["goal_position"]
        self.write(self.servos[index], item, self.value(item, kind, value))

    @rule(index=INDEX, on=st.integers(0, 1))
    def switch_torque(self, index, on):
        self.write(self.servos[index], self.servos[index].memory.items["torque_enable"], on)

    @rule(index=INDEX, share=st.floats(0.1, 0.9))
    def register_a_goal_and_act(self, index, share):
        servo = self.servos[index]
        item = servo.memory.items["goal_position"]
        top = 1023 if self.family != "sts" else 4095
        value = round(share * top)
        expected, done = servo.verdict(item, value)
        before = servo.memory["goal_position"]
        told = self.answer(servo, REG_WRITE, bytes([item.address]) + item.encode(value), expected)
        if not self.hears(servo):
            return
        if told and done and before is not None:
            held = self.answer(servo, READ, bytes([item.address, item.size]))
            assert held is None or item.decode(held[1]) == before, "it acts before it is told to"
        assert self.ask(ALL, ACTION) == []
        self.settle(servo, item, value, None if done is None or (told and told[0] & AX_STATES) else done)

    @rule(index=INDEX)
    def act_on_nothing(self, index):
        self.ask(ALL, ACTION)
        self.answer(self.servos[index], ACTION, expected=INSTRUCTION if self.family == "ax" else 0)

    @rule(index=INDEX)
    def ping(self, index):
        self.answer(self.servos[index], PING)

    @rule(unused=st.integers(0, 253), instruction=st.sampled_from([PING, READ, WRITE, ACTION]))
    def nobody_answers_for_another(self, unused, instruction):
        if unused not in {servo.id for servo in self.servos}:
            assert self.ask(unused, instruction, b"\x1e\x02") == []

    @rule(value=st.integers(0, 1))
    def a_broadcast_write_is_not_answered(self, value):
        item = self.servos[0].memory.items["led" if self.family == "ax" else "torque_enable"]
        assert self.ask(ALL, WRITE, bytes([item.address]) + item.encode(value)) == []
        for servo in self.servos:
            if self.hears(servo):
                self.settle(servo, item, value, servo.verdict(item, value)[1])

    @rule(order=st.permutations([0, 1, 2]), count=st.integers(1, 3), number=NUMBER, kind=KIND, value=NUMBER)
    def sync_write(self, order, count, number, kind, value):
        item = self.writable[number % len(self.writable)]
        asked = [self.servos[index] for index in order[:count]]
        values = [self.value(item, kind, value >> place) for place in range(count)]
        verdicts = [servo.verdict(item, v)[1] for servo, v in zip(asked, values, strict=True)]
        data = b"".join(bytes([servo.id]) + item.encode(v) for servo, v in zip(asked, values, strict=True))
        for servo in asked:
            if self.hears(servo):
                self.answer(servo, PING)
        assert self.ask(ALL, SYNC_WRITE, bytes([item.address, item.size]) + data) == []
        for servo, v, done in zip(asked, values, verdicts, strict=True):
            if self.hears(servo):
                self.settle(servo, item, v, done)

    @rule(order=st.permutations([0, 1, 2]), count=st.integers(1, 3), number=NUMBER)
    def sync_read(self, order, count, number):
        item = self.items[number % len(self.items)]
        asked = [self.servos[index] for index in order[:count]]
        replies = self.ask(ALL, SYNC_READ, bytes([item.address, item.size]) + bytes(s.id for s in asked))
        if self.family != "sts":
            assert replies == [], "it has no sync read"
            return
        answering = [servo for servo in asked if self.hears(servo)]
        assert [reply[0] for reply in replies] == [servo.id for servo in answering]
        for servo, (_, error, data) in zip(answering, replies, strict=True):
            if error:
                servo.doubtful()
            servo.memory.check(item.address, data)

    @rule(index=INDEX, new=st.integers(0, 253))
    def change_the_id(self, index, new):
        servo = self.servos[index]
        if new not in {other.id for other in self.servos}:
            item = servo.memory.items["id"]
            expected, done = servo.verdict(item, new)
            if done is None:
                return
            replies = self.ask(servo.id, WRITE, bytes([item.address]) + item.encode(new))
            self.judge(servo, replies, WRITE, expected)
            if self.hears(servo):
                self.settle(servo, item, new, done)

    @rule(index=INDEX, number=NUMBER)
    def change_the_bit_rate(self, index, number):
        servo = self.servos[index]
        item = servo.memory.items["baud_rate"]
        value = sorted(self.rates)[number % len(self.rates)]
        expected, done = servo.verdict(item, value)
        if done is None:
            return
        self.judge(servo, self.ask(servo.id, WRITE, bytes([item.address, value])), WRITE, expected)
        if self.hears(servo):
            self.settle(servo, item, value, done)

    @rule(index=INDEX)
    def follow_the_bit_rate(self, index):
        self.baud = self.servos[index].baud
        self.rig.set_baud(self.baud)

    @rule(index=INDEX, level=st.sampled_from([0, 1, 2]))
    def change_the_return_level(self, index, level):
        servo = self.servos[index]
        item = servo.memory.items["status_return_level" if self.family == "ax" else "response_level"]
        expected, done = servo.verdict(item, level)
        if done is None:
            return
        self.judge(servo, self.ask(servo.id, WRITE, bytes([item.address, level])), WRITE, expected)
        if self.hears(servo):
            self.settle(servo, item, level, done)

    @rule(index=INDEX)
    def make_here_the_middle(self, index):
        servo = self.servos[index]
        if self.family != "sts" or not self.hears(servo) or servo.memory["phase"] is None:
            return
        self.write(servo, servo.memory.items["torque_enable"], 0)
        mode = servo.memory["operating_mode"]
        self.answer(servo, WRITE, bytes([40, HOME]))
        told = self.answer(servo, READ, bytes([56, 2]))
        if mode == 0 and not servo.memory["phase"] & 0x10 and servo.memory["angular_resolution"] == 1:
            # the shaft may still turn a little
            assert abs(servo.memory.items["present_position"].decode(told[1]) - MIDDLE) <= 40
        servo.memory.forget("homing_offset", "goal_position", "torque_enable")

    @rule(seconds=st.sampled_from([0.004, 0.03, 0.2, 1.0]))
    def pause(self, seconds):
        self.t = max(self.t, self.rig.now) + seconds
        self.rig.advance(self.t)

    @rule(junk=st.binary(max_size=40), cut=st.integers(1, 6), index=INDEX)
    def noise(self, junk, cut, index):
        self.send(junk.replace(b"\xff\xff", b"\xff\x00"))
        self.send(frame(self.servos[index].id, READ, bytes([0, 2]))[:-cut])
        self.pause(0.2)
        self.answer(self.servos[index], PING)

    @rule(index=INDEX, wrong=st.integers(1, 255))
    def a_wrong_checksum_changes_nothing(self, index, wrong):
        servo = self.servos[index]
        item = servo.memory.items["goal_position"]
        whole = bytearray(frame(servo.id, WRITE, bytes([item.address, 1, 1])))
        whole[-1] ^= wrong
        for _, error, data in statuses(self.send(bytes(whole))):
            assert self.family == "ax" and error & CHECKSUM and data == b""
        self.pause(0.2)


PRODUCT = {"sts": "sts3215", "scs": "scs0009"}


def rig_of(family):
    """Return a lamp on servos of a family; no SCS one is shipped."""
    if family != "scs":
        return load_rig({"ax": "lamp-ax12", "sts": "lamp-sts3215"}[family])
    return parse_rig(scs_text(), load_rig("lamp-xl330").path)


@pytest.mark.parametrize("family", ["ax", "sts", "scs"])
def test_servos_keep_the_manuals_rules(family, machine_steps):
    machine = type("FamilyMachine", (Machine,), {"family": family})
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
