"""Small text files: checked reading, atomic writing."""
