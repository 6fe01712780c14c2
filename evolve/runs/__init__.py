"""Runs: a folder each, written so that a killed one goes on as if never stopped."""
