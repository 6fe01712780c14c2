"""From a controller to C: names, source, header, selftest."""
