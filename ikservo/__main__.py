"""``python -m ikservo``: the same as ``ikservo``."""

from ikservo.cli import console

if __name__ == "__main__":
    console()
