"""The pictures of arm and scene that the page draws."""
