"""The serial line: ports by name, who holds them, bytes in and out, and until when to wait."""
