"""Drive firmware images from the virtual rig in lock step, and read what they say on their console."""
