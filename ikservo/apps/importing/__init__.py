"""Foreign descriptions of arms, converted once: what `ikservo arms new` writes, `model` reads."""
