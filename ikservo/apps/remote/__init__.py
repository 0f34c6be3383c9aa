"""Arms on other machines: addresses, sessions, messages, the server beside the arm, its clients."""
