"""From gestures to goals: the grabbed point of a link follows the pointer (lecture L19)."""
