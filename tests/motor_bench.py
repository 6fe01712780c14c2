"""Servos with protocol 1 framing on motors of their own: a line, a clock, and a motor's closed form for each."""

import math

from deploy.virtual import protocol1 as p1
from deploy.virtual.ax_servo import AxServo
from deploy.virtual.bus import VirtualBus
from deploy.virtual.drive import Drive
from deploy.virtual.feetech_servo import FeetechServo
from deploy.virtual.protocol1_line import PROTOCOL1

STEP_S = 0.001
PROTECT_STEPS = 5


class Motor:
    """Turn as torque = stall * (duty - speed / no-load speed) says, at the nominal voltage unless told otherwise."""

    def __init__(self, product, ticks):
        self.product, self.volts, self.stuck = product, product.voltage_v, False
        self.rad_per_tick = 2.0 * math.pi / product.ticks_per_turn
        self.angle, self.omega, self.inertia = ticks * self.rad_per_tick, 0.0, product.armature_kg_m2
        self._drive, self._goal, self._more, self._sum = None, 0.0, 0.0, 0.0

    def ticks(self):
        return self.angle / self.rad_per_tick

    def speed(self):
        return self.omega

    def duty(self):
        drive = self._drive
        if drive is None or not drive.on:
            return 0.0
        law = drive.law
        if drive.mode == "position":
            error = self._goal * self.rad_per_tick - self.angle
            beyond = math.copysign(max(0.0, abs(error) - law.dead_zone_rad), error)
            duty = law.kp * beyond + (math.copysign(law.punch, beyond) if beyond else 0.0) - law.kd * self.omega
        elif drive.mode == "velocity":
            duty = law.kp * (self._goal - self.omega) + law.ki * self._sum
        else:
            duty = self._goal
        return min(max(duty + self._more, -law.duty_max), law.duty_max)

    def torque(self):
        if self._drive is None or not (self._drive.on or self._drive.brake):
            return 0.0
        product = self.product
        return product.stall_torque_nm * (
            self.duty() * self.volts / product.voltage_v - self.omega / product.no_load_speed_rad_s
        )

    def current(self):
        return self.product.stall_current_a * self.torque() / self.product.stall_torque_nm

    def supply(self):
        return self.volts

    def drive(self, drive):
        assert isinstance(drive, Drive)
        self._drive, self._sum = drive, 0.0

    def aim(self, value):
        self._goal = value

    def feedforward(self, duty):
        self._more = duty

    def step(self):
        if self.stuck:
            self.omega = 0.0
            return
        if self._drive is not None and self._drive.on and abs(self.duty()) < self._drive.law.duty_max:
            self._sum += STEP_S * (self._goal - self.omega)
        self.omega += STEP_S * self.torque() / self.inertia
        drag = STEP_S * self.product.friction_loss_nm / self.inertia
        self.omega = math.copysign(max(0.0, abs(self.omega) - drag), self.omega)
        self.angle += STEP_S * self.omega


class Bench:
    """Ask servos over a line, each question after the answers to the last."""

    def __init__(self, *kinds, baud=1_000_000):
        """Put servos on the line: (product, EEPROM, ticks) each."""
        self.motors = [Motor(product, ticks) for product, _, ticks in kinds]
        self.servos = [
            (AxServo if product.family == "dynamixel-ax" else FeetechServo)(product, motor, eeprom)
            for (product, eeprom, _), motor in zip(kinds, self.motors, strict=True)
        ]
        self.dead = set()
        self.line = VirtualBus(self.servos, baud, lambda index: index in self.dead, lambda frame: frame, PROTOCOL1)
        self.now_ns, self.steps = 0, 0

    def wait(self, seconds):
        """Let time pass."""
        end_ns = self.now_ns + round(seconds * 1e9)
        while (self.steps + 1) * STEP_S * 1e9 <= end_ns:
            for servo, motor in zip(self.servos, self.motors, strict=True):
                if servo.moving:
                    servo.step(STEP_S)
                motor.step()
                if self.steps % PROTECT_STEPS == 0:
                    servo.protect(PROTECT_STEPS * STEP_S)
            self.steps += 1
        self.now_ns = end_ns

    def frames(self, data):
        """Send bytes; return the answers as (start after the question [ns], bytes)."""
        asked_ns = self.now_ns + self.line.duration_ns(len(data))
        self.wait((asked_ns - self.now_ns) * 1e-9)
        self.line.feed(data, asked_ns)
        answers = []
        while (end_ns := self.line.next_ns()) is not None:
            for at_ns, frame in self.line.take_replies(end_ns):
                answers.append((at_ns - self.line.duration_ns(len(frame)) - asked_ns, frame))
            self.wait((end_ns - self.now_ns) * 1e-9)
        return answers

    def ask(self, servo, instruction, parameters=b""):
        """Send an instruction; return the status packets as (id, error, data)."""
        answers = self.frames(p1.encode(servo, instruction, parameters))
        packets = p1.PacketParser().feed(b"".join(frame for _, frame in answers))
        assert all(packet.sound for packet in packets)
        return [(packet.id, packet.instruction, packet.parameters) for packet in packets]

    def write(self, servo, address, *data):
        """Write bytes; return the error, or None for silence."""
        answers = self.ask(servo, p1.WRITE, bytes((address, *data)))
        return answers[0][1] if answers else None

    def read(self, servo, address, length=1):
        """Read bytes; return them as one little-endian number."""
        [(_, _, data)] = self.ask(servo, p1.READ, bytes((address, length)))
        return int.from_bytes(data, "little")


def low_high(value):
    """Return a 16-bit value as a servo takes it that has the low byte first."""
    return value & 0xFF, value >> 8 & 0xFF
