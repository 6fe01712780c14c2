"""The virtual rig: servos, body and sensor node behind real bytes, in lock step or in real time."""
