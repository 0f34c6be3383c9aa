"""Goals at a steady beat: the servos as one body, watched, throttled and stopped."""
