"""Apps built on the core; each folder is one app and can be deleted."""
