"""Simulated vehicles and motion capture, each its own process, that speak the protocols of the real ones."""
