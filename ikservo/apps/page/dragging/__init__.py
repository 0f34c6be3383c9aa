"""Targets that are dragged, typed or stepped, and the plans to them."""
