"""Report pages and figures of tunings; the only package with matplotlib and Jinja2."""
