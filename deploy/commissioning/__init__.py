"""What gets a rig ready: find its servos, set them up, calibrate, watch, and undo."""
