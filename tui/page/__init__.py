"""Pages of a survey for a browser: server, pages, pictures."""
