"""How a log reaches the disk so that nothing that was counted as written is lost."""
