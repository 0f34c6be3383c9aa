"""Which vendor's SDK speaks: one driver a dialect, all with the same shape."""
