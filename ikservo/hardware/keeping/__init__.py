"""What survives loss of power: EEPROM, its copies, new ids."""
