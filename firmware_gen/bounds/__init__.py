"""What a controller can cost and give at most, from its machine code and its program."""
