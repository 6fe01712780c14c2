"""A wheel on a vertical axis, on a base that nothing moves: what a motor does to it has a closed form."""

_TEXT = """
<mujoco>
  <option integrator="implicitfast"/>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1"/>
    <body name="base" pos="0 0 0.1">
      <freejoint name="root"/>
      <geom name="foot" type="sphere" size="0.1" mass="10000"/>
      <body name="wheel" pos="0 0 0.2">
        <joint name="{hinge}" type="hinge" axis="0 0 1"/>
        <inertial pos="0 0 0" mass="0.1" diaginertia="{inertia} {inertia} {inertia}"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
HINGE = "k"


def wheel_body(folder, inertia):
    """Write the wheel's MJCF; return its path. The inertia is in kg m^2."""
    body = folder / "wheel.xml"
    body.write_text(_TEXT.format(hinge=HINGE, inertia=inertia))
    return body
