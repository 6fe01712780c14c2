"""Whole folders of firmware for a board: a rig as C data, build files, the page for a person."""
