"""Single servos and their bus: ids, registers, gains, faults."""
