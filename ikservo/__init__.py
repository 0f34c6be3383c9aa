"""A box of bus servos becomes an arm that goes where you point."""
