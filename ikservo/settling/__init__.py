"""The end of a motion: joints are corrected by their measured positions until they rest."""
