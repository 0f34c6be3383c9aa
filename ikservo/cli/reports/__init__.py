"""What an answer looks like on the terminal and as JSON."""
