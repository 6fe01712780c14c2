"""What a random master asks of several X servos at once, or tells them."""

from hypothesis import strategies as st
from hypothesis.stateful import rule
from machine_x import KIND, NUMBER, XMaster
from manual_x import (
    ALERT,
    ALL,
    BULK_READ,
    BULK_WRITE,
    FAST_SYNC_READ,
    SYNC_READ,
    SYNC_WRITE,
    fast_parts,
    frame,
    two,
)


class AskSeveral(XMaster):
    """Read and write with sync and bulk packets."""

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
