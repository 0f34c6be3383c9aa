"""Cameras: where one stands, what it says of the arm's joints, boards, and pictures."""
