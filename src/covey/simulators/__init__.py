"""Worlds to fly in, each a `covey.flight.simulator.Simulator`."""
