"""The conversation with a person who calibrates: on a screen, by single keys, or by a script."""
