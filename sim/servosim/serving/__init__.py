"""The simulated bus as a program: pseudo-terminal, options, window and remote control."""
