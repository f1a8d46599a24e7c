"""The paper's experiments: its tables and figures, beside ours."""
