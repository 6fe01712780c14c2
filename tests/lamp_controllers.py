"""Controllers of the three-servo lamp that several tests run, as texts of controller files."""

OUTPUTS = "".join(
    f'[[output]]\nname = "{name}"\nkind = "position"\nunit = "deg"\nlow = -60\nhigh = 60\nneutral = 0\n'
    for name in ("a0", "a1", "a2")
)

SWAY = f"""
program = "(list (* 8 (osc-wave 0.5 0)) (* 0.1 px) 0)"
[controller]
name = "sway"
period_s = 0.02
[[input]]
name = "px"
unit = "m"
low = -2
high = 2
{OUTPUTS}"""
"""Sways for as long as one likes, and listens to the sensor node."""

NOD = f"""
program = "(list (* 8 (osc-wave 1 0)) (* 5 (osc-wave 1 0.25)) 0)"
[controller]
name = "nod"
period_s = 0.02
slew_rad_s = 5.0
[provenance]
time_limit_s = 0.5
[[input]]
name = "t"
unit = "s"
low = 0
high = 10
{OUTPUTS}"""
"""Nods, says for how long, and needs no sensor."""
