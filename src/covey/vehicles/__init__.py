"""Vehicles: who flies where, in whatever world."""
