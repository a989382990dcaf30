"""CoPCS, the learned planner: graphs, tokens and masks, networks, training data, decoding."""
