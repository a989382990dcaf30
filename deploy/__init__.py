"""The ground station: missions, checks, the supervisor and its loop, recordings and reports."""
