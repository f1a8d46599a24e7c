"""Logs of machines that no engine simulated, and what MuJoCo models are tuned to by them."""
