"""The review of a drop."""
