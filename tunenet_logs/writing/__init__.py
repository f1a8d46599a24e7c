"""Write logs to disk so that nothing that was counted as written is lost."""
