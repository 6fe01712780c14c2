"""A wheel that one virtual X servo turns, and the bits of its registers."""

from dataclasses import replace

from dynamixel_master import Master
from wheel_body import HINGE, wheel_body

from controller.products import PRODUCTS
from controller.rig_file import load_rig

INERTIA = 1e-3
ALL = ("xl330-m288", "xc330-m181", "xl430-w250", "xm430-w350")
MEASURES_CURRENT = ("xl330-m288", "xc330-m181", "xm430-w350")
CURRENT, VELOCITY, POSITION, EXTENDED, CURRENT_POSITION, PWM = 0, 1, 3, 4, 5, 16
REVERSE, TIME_BASED, TORQUE_ON_BY_GOAL = 1, 4, 8
CLEAR = bytes.fromhex("01 44584C22")
TICKS_S = 0.229 * 4096 / 60  # a velocity count


class Wheel(Master):
    """Ask one servo that turns a wheel about a vertical axis."""

    def __init__(self, product, folder):
        body = wheel_body(folder, INERTIA)
        self.product = PRODUCTS[product]
        lamp = load_rig("lamp-xc330")
        joint = replace(
            lamp.joints[0],
            mjcf_joint=HINGE,
            product=self.product,
            zero_tick=self.product.center_tick,
            neutral_rad=0.0,
            gains={},
            ceiling=885,
        )
        rig = replace(lamp, body=body, joints=(joint,), sensors=(), supply_v=self.product.voltage_v)
        super().__init__(rig, start="limp")
        self.servo = joint.id
        self.inertia = INERTIA + self.product.armature_kg_m2
        self.brake = self.product.stall_torque_nm / self.product.no_load_speed_rad_s + self.product.damping_nms_rad

    def __getitem__(self, name):
        return self.read(self.servo, name)

    def __call__(self, **values):
        self.set(self.servo, **values)

    def error(self, name, value):
        return self.write(self.servo, name, value)

    def jam(self):
        self.rig._plant.jam(0, True)
