"""Tune MuJoCo models to logs of machines that no engine simulated."""
