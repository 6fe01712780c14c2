"""A master of virtual X servos that knows what each must answer, by the rules in `manual_x.py`."""

import re

from hypothesis import strategies as st
from line_master import LineMaster
from manual import Memory, load_items
from manual_x import (
    ALERT,
    APART,
    BAUD,
    MEASURED,
    MODES,
    MODES_X,
    PING,
    READ,
    WRITE,
    Servo,
    frame,
    statuses,
    two,
)

from controller.rig_file import load_rig, parse_rig

INDEX = st.integers(0, 2)
KIND = st.sampled_from(["low", "high", "below", "above", "within", "within", "initial"])
NUMBER = st.integers(0, 2**32 - 1)


class XMaster(LineMaster):
    """A master of three servos on one line, with what it knows of each."""

    rig_name = "lamp-xc330"

    def __init__(self):
        rig = rig_of(self.rig_name)
        super().__init__(rig)
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

    def sent(self):
        for index, servo in enumerate(self.servos):
            servo.waited(self.t - self.heard[index])

    def ask(self, servo, instruction, parameters=b""):
        asked = self.send(frame(servo, instruction, parameters))
        for index, other in enumerate(self.servos):
            if other.baud == self.baud:
                self.heard[index] = self.t
        return statuses(asked)

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
                servo.take_perhaps(item)

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

    def pick(self, number):
        return self.writable[number % len(self.writable)]

    def changes(self, number, kind, value, count):
        first = self.writable.index(self.pick(number))
        run = [self.writable[first]]
        for item in self.writable[first + 1 : first + count]:
            if item.address != run[-1].end or item.eeprom != run[0].eeprom:
                break
            run.append(item)
        return [(item, self.value(item, kind, value >> 3 * place)) for place, item in enumerate(run)]

    def read_item(self, servo, name):
        item = servo.memory.items[name]
        told = self.judge(servo, self.ask(servo.id, READ, two(item.address, item.size)), {0}, 1)
        if told:
            held = item.decode(told[1])
            assert held == servo.memory[name] or servo.memory[name] is None


def rig_of(name):
    """Return a rig that is shipped, or the heavy lamp on XM430 servos."""
    if name != "xm430":
        return load_rig(name)
    rig = load_rig("lamp-xl430")
    text = re.sub(r"supply_v = [0-9.]+", "supply_v = 12.0", rig.text).replace('"xl430-w250"', '"xm430-w350"')
    return parse_rig(text, rig.path)
