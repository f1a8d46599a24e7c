"""Command lines that tune, train, review, compare, plan, report and export; parsing only."""
