"""Batch tuning: find logs, tune them in parallel, and keep a ledger of the results."""
