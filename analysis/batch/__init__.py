"""Many logs: found, tuned several at a time, and entered in a ledger as they end."""
