"""Stopping from outside: how programs of one user reach the one that has an arm open."""
