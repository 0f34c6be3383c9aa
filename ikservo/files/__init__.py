"""Small text files: read with suspicion, written whole or not at all."""
