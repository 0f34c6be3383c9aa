"""Run the command line of ikservo as ``python -m ikservo``."""

from ikservo.cli import console

if __name__ == "__main__":
    console()
