"""What a random master asks of one X servo, or tells it."""

from hypothesis import strategies as st
from hypothesis.stateful import rule
from machine_x import INDEX, KIND, NUMBER, XMaster
from manual_x import (
    ACCESS,
    ACTION,
    ALERT,
    ALL,
    GOALS,
    LENGTH,
    PING,
    RANGE,
    READ,
    REBOOT,
    REG_WRITE,
    UNKNOWN,
    WRITE,
    two,
)


class AskOne(XMaster):
    """Read and write one servo, by each instruction that knows how."""

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
