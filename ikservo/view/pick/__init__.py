"""What is under the pointer: boxes over links, shapes in link coordinates (lecture L16 to L18)."""
