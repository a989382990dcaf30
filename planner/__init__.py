"""Joint planning for UAVs and the UGVs that recharge them; knows nothing of vehicles or files on disk."""
