"""The door to the page: who may come in, what they may say, who has the wheel."""
