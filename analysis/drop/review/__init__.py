"""Review of a drop."""
