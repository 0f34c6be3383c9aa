"""Small text files: checked reading and atomic writing."""
