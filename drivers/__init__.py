"""The interface to vehicles and motion capture, and one file per SDK behind it."""
