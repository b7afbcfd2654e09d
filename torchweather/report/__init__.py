"""HTML pages and figures; the only part of the library that uses matplotlib and jinja2."""
