"""Drop by its impact times alone."""
