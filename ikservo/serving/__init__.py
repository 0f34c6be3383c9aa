"""Communication with the program that has an arm open: stops, states and the control lease."""
