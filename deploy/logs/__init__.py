"""Logs of runs: written, read, replayed bit for bit, and laid over their simulation."""
