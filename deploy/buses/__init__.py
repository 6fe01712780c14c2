"""What comes and goes over the wires: servo buses of each protocol, their ports, the sensor node's line."""
