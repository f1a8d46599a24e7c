"""Pages and figures of tunings: the only room that knows matplotlib and Jinja2."""
