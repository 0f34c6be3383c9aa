"""The thread that owns an arm, and the jobs that it runs for the page."""
