# the compiler of this computer; CC chooses another
