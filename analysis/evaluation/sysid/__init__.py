"""Logs of machines whose physics no engine computed, and what a MuJoCo model is tuned to by them."""
