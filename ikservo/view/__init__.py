"""The view: click a target, grab any link and pull, and the arm follows."""
