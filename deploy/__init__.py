"""Drive a rig: buses over the vendor's SDK, the virtual rig that stands in for one, host loop, safety, logs, compare.

Nothing here imports MuJoCo until a virtual rig or a simulation is asked for: a small computer drives servos without it.
"""
