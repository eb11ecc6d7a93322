"""Builds objects from a mission and puts them to work: plan, certify, compare, keep, draw."""
