"""Looking after servos: check-ups, EEPROM, recovery, commissioning, the measured bus."""
