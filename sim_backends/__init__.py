"""Simulated vehicles behind the very interfaces of ``drivers``."""
