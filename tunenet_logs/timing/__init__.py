"""Clocks of logs: a uniform clock behind jittered arrivals, and stamps that are wrong."""
