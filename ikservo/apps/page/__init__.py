"""The web view: drag a link or click a target, and the arm follows."""
