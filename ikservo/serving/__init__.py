"""Stops from outside: how programs of one user reach the program that has an arm open."""
